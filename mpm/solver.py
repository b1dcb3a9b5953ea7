"""The material point kernels: one explicit step after another.

A step is: particles to grid, grid update (gravity, walls, contact with the body), grid
to particles with the stress update. Quadratic B-splines, float64, serial: a run takes one
core, runs go side by side. The interface is plain arrays and a `Soil`, nothing else, so that
another backend can take the place of `advance`.
"""

import numba

from mpm.columns import OK
from mpm.fluidity import diffuse_fluidity
from mpm.grid_update import contact, update_grid
from mpm.transfers import grid_to_particles, particles_to_grid


@numba.njit(cache=True)
def advance(
    particles,
    grid,
    fluidity,
    shape,
    origin,
    dx,
    dt,
    walls,
    soil,
    particle_volume,
    gravity,
    keep,
    body,
    path,
    load,
    rider,
    impulse,
    status,
):
    """Advances the soil (and the wheel's height) by len(path) - 1 steps. Works in place.

    Args:
        particles: float64 [N, COLUMNS].
        grid: float64 [4 nodes], work space: momentum or velocity, and mass, of each node.
        fluidity: float64 [nodes, 3], work space of the nonlocal law; None: local mu(I).
        shape, origin, dx: the grid: nodes per axis, position of node 0 (m), cell size (m).
        dt: time step, s. The caller has checked it (`stability`).
        walls: int [6], see `update_grid`.
        soil: `Soil`.
        particle_volume: m3 of packed soil per particle.
        gravity: m/s2, along -y.
        keep: factor on all grid velocities per step: 1, or less to settle a packing.
        body: `bodies.Body`, or None: no body.
        path: float64 [steps + 1, 3], the body's pose at each step's ends: x and y of its reference
            point (m), angle about z (rad); its y is not used if the body rides freely.
        load: float64 [steps + 1], N on a body that rides freely.
        rider: float64 [3]: height y (m), vertical speed (m/s), mass (kg). A positive mass makes
            the vertical motion free under the load.
        impulse: float64 [6], N s and N m s given to the body by the soil, the second about its
            reference point (added to).
        status: int64 [3]: error code, particle, steps done.
    """
    mass = particle_volume * soil.bulk_density
    before = 0.0
    for step in range(path.shape[0] - 1):
        top = particles_to_grid(
            particles,
            grid,
            shape,
            origin,
            dx,
            dt,
            mass,
            particle_volume,
            soil.bulk_modulus,
            status,
        )
        if status[0] != OK:
            return
        update_grid(grid, shape, top, dt, gravity, walls, keep)
        if body is not None:
            free = rider[2] > 0.0
            vx = (path[step + 1, 0] - path[step, 0]) / dt
            y, vy = path[step, 1], (path[step + 1, 1] - path[step, 1]) / dt
            if free:
                y, vy = rider[0], rider[1]
            spin = (path[step + 1, 2] - path[step, 2]) / dt
            before = impulse[1]
            contact(
                grid,
                shape,
                top,
                origin,
                dx,
                walls,
                body,
                (path[step, 0], y, path[step, 2]),
                (vx, vy, spin),
                impulse,
            )
            if free:
                rider[1] += (impulse[1] - before - load[step] * dt) / rider[2]
                rider[0] += dt * rider[1]
        if fluidity is not None:
            diffuse_fluidity(particles, fluidity, shape, top, origin, dx, dt, soil)
        grid_to_particles(particles, grid, shape, origin, dx, dt, soil, fluidity)
        status[2] += 1
