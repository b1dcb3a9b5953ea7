"""The material point kernels: one explicit step after another.

A step is: particles to grid, grid update (gravity, walls, contact with the body), grid
to particles with the stress update. Quadratic B-splines, float64, serial: a run takes one
core, runs go side by side. The interface is plain arrays and a `Soil`, nothing else, so that
another backend can take the place of `advance`.
"""

import numba
import numpy as np

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
    dims,
    friction,
    outset,
    path,
    spin,
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
        dims, friction, outset: the body, see `bodies` and `contact`; dims None: no body.
        path: float64 [steps + 1, 2], position of the body's reference point at each step's ends;
            its y is not used if the body rides freely.
        spin: rad/s about z, prescribed.
        rider: float64 [4]: height y (m), vertical speed (m/s), mass (kg), load (N). A positive
            mass makes the vertical motion free under the load.
        impulse: float64 [3], N s given to the body by the soil (added to).
        status: int64 [3]: error code, particle, steps done.
    """
    mass = particle_volume * soil.bulk_density
    before = np.empty(3)
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
        if dims is not None:
            free = rider[2] > 0.0
            vx = (path[step + 1, 0] - path[step, 0]) / dt
            y, vy = path[step, 1], (path[step + 1, 1] - path[step, 1]) / dt
            if free:
                y, vy = rider[0], rider[1]
            before[:] = impulse
            contact(
                grid,
                shape,
                top,
                origin,
                dx,
                walls,
                dims,
                friction,
                outset,
                (path[step, 0], y),
                (vx, vy, spin),
                impulse,
            )
            if free:
                rider[1] += (impulse[1] - before[1] - rider[3] * dt) / rider[2]
                rider[0] += dt * rider[1]
        if fluidity is not None:
            diffuse_fluidity(particles, fluidity, shape, top, origin, dx, dt, soil)
        grid_to_particles(particles, grid, shape, origin, dx, dt, soil, fluidity)
        status[2] += 1
