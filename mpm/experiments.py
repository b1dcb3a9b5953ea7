"""Small experiments with known answers, for `verify` and the tests. All in SI units."""

import dataclasses
import math

import numba
import numpy as np

from mpm import bodies, columns, packing, solver, stability
from mpm.constitutive import Soil, make_soil, update_stress
from mpm.grid_update import update_grid
from mpm.scenes import CORNER, EARTH_GRAVITY, Bin, Scene
from mpm.transfers import particles_to_grid


def coarse(scene: Scene) -> Scene:
    """Returns the scene on cells twice as long, with as many particles per cell."""
    box = scene.bin
    cells = [round(box.size[0] / box.dx) // 2, round(box.size[2] / box.dx) // 2]
    dx = box.size[0] / cells[0]
    size = (box.size[0], box.size[1], cells[1] * dx)
    lattice = tuple(max(2, n // 2) for n in box.lattice)
    return dataclasses.replace(
        scene, bin=dataclasses.replace(box, dx=dx, size=size, lattice=lattice)
    )


def energy(particles, soil: Soil, volume: float, dx: float, gravity: float) -> float:
    """Returns kinetic, elastic and potential energy of soil in J, heights from the floor.

    The affine part of a particle's motion carries 1/2 m |C|2 dx2 / 4 (the inertia of quadratic
    B-splines). The pressure K (1 / J - 1) is the derivative of K (J - 1 - ln J).

    Args:
        particles: float64 [N, COLUMNS].
        soil: their soil.
        volume: m3 of packed soil per particle.
        dx: cell size, m.
        gravity: m/s2.
    """
    q = particles
    ratio, s = q[:, columns.VOLUME_RATIO], q[:, columns.S : columns.S + 6]
    motion = (q[:, columns.V : columns.V + 3] ** 2).sum()
    motion += dx**2 / 4 * (q[:, columns.C : columns.C + 9] ** 2).sum()
    pressed = np.minimum(ratio, 1.0)
    bulk = soil.bulk_modulus * (pressed - 1.0 - np.log(pressed)).sum()
    shear = (s[:, :3] ** 2).sum(axis=1) + 2.0 * (s[:, 3:] ** 2).sum(axis=1)
    elastic = bulk + (ratio * shear).sum() / (4.0 * soil.shear_modulus)
    height = (q[:, 1] - CORNER).sum()
    mass = volume * soil.bulk_density
    return float(mass * (0.5 * motion + gravity * height) + volume * elastic)


class Experiment:
    """A block of soil in a box, stepped by hand.

    Attributes:
        particles: float64 [N, COLUMNS], free of stress and at rest at first.
        grid: `packing.Grid`.
        dt: time step, s (the CFL limit unless `steps_per_second` says otherwise).
        impulse: float64 [6], N s and N m s given to the body so far, the second about its
            reference point.
    """

    def __init__(self, room: Bin, block: Bin, soil: Soil, lift: float = 0.0, smooth_sides=False):
        """Fills the lower corner of `room` with `block`, raised by `lift` m."""
        self.soil = soil
        grid = packing.make_grid(room)
        walls = grid.walls[:5] + (int(smooth_sides),)
        self.grid = packing.Grid(grid.shape, grid.origin, grid.dx, walls)
        self.volume = packing.particle_volume(block)
        self.particles = packing.lattice(block, seed=0)
        self.particles[:, 1] += lift
        self.dt = stability.max_time_step(soil, room.dx)
        self.impulse = np.zeros(6)
        self._work = np.zeros(4 * grid.nodes)
        self._status = np.zeros(3, dtype=np.int64)

    @property
    def mass(self) -> float:
        """Mass of one particle, kg."""
        return self.volume * self.soil.bulk_density

    def momentum(self) -> np.ndarray:
        """Returns the momentum [3] of the soil, N s."""
        return self.mass * self.particles[:, columns.V : columns.V + 3].sum(axis=0)

    def energy(self, gravity: float = EARTH_GRAVITY) -> float:
        """Returns the `energy` of the soil, J."""
        return energy(self.particles, self.soil, self.volume, self.grid.dx, gravity)

    def advance(
        self,
        steps: int,
        gravity: float = EARTH_GRAVITY,
        body: bodies.Body | None = None,
        path: np.ndarray | None = None,
    ) -> None:
        """Takes `steps` steps, with a body on a prescribed `path` [steps + 1, 3] if given.

        A path holds x, y (m) of the body's reference point and its angle (rad).

        Raises:
            ValueError: if a particle leaves the grid.
        """
        self.particles = packing.sort_by_cell(self.particles, self.grid)
        solver.advance(
            self.particles,
            self._work,
            None,
            self.grid.shape,
            self.grid.origin,
            self.grid.dx,
            self.dt,
            self.grid.walls,
            self.soil,
            self.volume,
            gravity,
            1.0,
            body,
            np.zeros((steps + 1, 3)) if path is None else path,
            np.zeros(0),
            np.zeros(3),
            self.impulse,
            self._status,
        )
        if self._status[0] != columns.OK:
            raise ValueError(f'particle {self._status[1]} left the grid')


def free_fall(steps: int = 400) -> dict:
    """Drops a block; returns the relative error of its fall and its largest change of shape.

    The fall is compared with the parabola g t2 / 2 sampled as the semi-implicit scheme does,
    g dt2 n (n + 1) / 2; the scheme's own distance from the parabola is 1 / n.
    """
    room = Bin((0.2, 0.1, 0.2), 0.02, (0, 0, 0), 1, 0.6, ())
    block = Bin((0.2, 0.1, 0.2), 0.02, (10, 5, 10), 1, 0.6, ())
    experiment = Experiment(room, block, make_soil(1.5e6, 0.76), lift=0.4)
    # Away from the sticky walls.
    particles = experiment.particles
    inside = np.abs(particles[:, [0, 2]] - CORNER - 0.1).max(axis=1) < 0.06
    experiment.particles = particles[inside]
    experiment.particles[:, columns.IDENTITY] = np.arange(inside.sum())
    start = experiment.particles[:, :3].copy()
    experiment.advance(steps)
    fall = start - packing.in_identity_order(experiment.particles)[:, :3]
    exact = EARTH_GRAVITY * experiment.dt**2 * steps * (steps + 1) / 2
    return {
        'fall_m': exact,
        'error': float(abs(fall[:, 1].mean() / exact - 1.0)),
        'deformation': float(np.abs(fall - [0.0, exact, 0.0]).max() / exact),
    }


def settled_soil(box: Bin, particles: np.ndarray, soil: Soil) -> dict:
    """Returns the reaction of walls and floor over the weight, and the stress over rho g h.

    Args:
        box: the bin of the packing.
        particles: the settled packing.
        soil: of the packing.
    """
    grid = packing.make_grid(box)
    volume = packing.particle_volume(box)
    mass = volume * soil.bulk_density
    work = np.zeros(4 * grid.nodes)
    dt = stability.max_time_step(soil, box.dx)
    status = np.zeros(3, dtype=np.int64)
    top = particles_to_grid(
        particles,
        work,
        grid.shape,
        grid.origin,
        box.dx,
        dt,
        mass,
        volume,
        soil.bulk_modulus,
        status,
    )
    before = work.reshape(-1, 4).copy()
    update_grid(work, grid.shape, top, dt, 0.0, grid.walls, 1.0)
    after = work.reshape(-1, 4)
    held = (before[:, 3] > 0.0) & (after[:, :3] == 0.0).all(axis=1)
    # What the walls take, and the weight of the soil that sits on their own nodes.
    reaction = -before[held, 1].sum() / dt + before[held, 3].sum() * EARTH_GRAVITY
    middle = np.abs(particles[:, [0, 2]] - CORNER - np.array(box.size)[[0, 2]] / 2)
    chosen = (middle < np.array(box.size)[[0, 2]] / 2 - box.size[1]).all(axis=1)
    depth = box.surface - particles[chosen, 1]
    ratio = particles[chosen, columns.VOLUME_RATIO]
    pressure = soil.bulk_modulus * np.maximum(1.0 / ratio - 1.0, 0.0)
    stress = pressure - particles[chosen, columns.S + 1]
    overburden = soil.bulk_density * EARTH_GRAVITY * depth
    return {
        'reaction_over_weight': float(reaction / (len(particles) * mass * EARTH_GRAVITY)),
        'stress_over_rho_g_h': float((stress * overburden).sum() / (overburden**2).sum()),
    }


def contact_momentum(steps: int = 200) -> dict:
    """Shoots a blade through weightless soil; returns the momentum that is not accounted for."""
    room = Bin((0.4, 0.1, 0.4), 0.02, (0, 0, 0), 1, 0.5, ())
    block = Bin((0.4, 0.1, 0.4), 0.02, (30, 8, 30), 1, 0.5, ())
    experiment = Experiment(room, block, make_soil(1.5e6, 0.76), lift=0.15)
    particles = experiment.particles
    inside = np.abs(particles[:, [0, 2]] - CORNER - 0.2).max(axis=1) < 0.1
    experiment.particles = particles[inside]
    experiment.particles[:, columns.IDENTITY] = np.arange(inside.sum())
    blade = bodies.make_blade(CORNER + 0.2)
    path = np.full((steps + 1, 3), -math.radians(20.0))
    path[:, 0] = CORNER + 0.35 - 2.0 * experiment.dt * np.arange(steps + 1)
    path[:, 1] = CORNER + 0.15
    experiment.advance(steps, gravity=0.0, body=blade, path=path)
    impulse = experiment.impulse[:3]
    given = np.linalg.norm(impulse)
    lost = np.linalg.norm(experiment.momentum() + impulse)
    return {'impulse_N_s': float(given), 'unbalanced': float(lost / given)}


@numba.njit
def _shear_row(row, steps, dt, rate, soil, fluidity):
    for _ in range(steps):
        row[columns.C + 1] = rate
        update_stress(row, dt, soil, fluidity, row[columns.FLUIDITY])


def homogeneous_shear(
    inertial_number: float, pressure: float = 1000.0, is_nonlocal: bool = False
) -> dict:
    """Shears one particle at constant volume; returns tau / p and mu(I) of the paper.

    The nonlocal law has no gradient here. Its steady state is mu_s + (mu_2 - mu_s) I / I0.
    """
    soil = make_soil(1.5e6, 0.76)
    rate = inertial_number * math.sqrt(pressure / soil.grain_density) / soil.grain_diameter
    row = np.zeros(columns.COLUMNS)
    row[columns.VOLUME_RATIO] = 1.0 / (1.0 + pressure / soil.bulk_modulus)
    # Steps of a tenth of a per mille of shear, to a strain of one half.
    _shear_row(row, 5000, 1.0e-4 / rate, rate, soil, np.zeros(1) if is_nonlocal else None)
    s = row[columns.S : columns.S + 6]
    tau = math.sqrt(0.5 * (s[:3] ** 2).sum() + (s[3:] ** 2).sum())
    rise = inertial_number / soil.inertial_number_0
    mu = soil.mu_s + (soil.mu_2 - soil.mu_s) * (rise if is_nonlocal else rise / (1.0 + rise))
    return {'tau_over_p': tau / pressure, 'mu': mu}


def column_collapse(aspect: float, length: float = 0.2, seconds: float = 1.5) -> dict:
    """Lets a column of soil collapse in a smooth channel; returns its run-out over its length.

    Friction as of sand with an angle of repose of 30 degrees: mu_s = sin(30 deg), the plane
    strain value. Expected (Lube, Huppert, Sparks, Freundt 2005, Phys. Rev. E 72, 041301): 1.2 a for
    aspect ratios a < 1.8, 1.9 a^(2/3) for a > 2.8.
    """
    dx = length / 15
    reach = length * (1.0 + 2.5 * 1.2 * aspect)
    room = Bin((dx * math.ceil(reach / dx), 0.0, 4 * dx), dx, (0, 0, 0), 1, length * aspect, ())
    count = round(1.5 * 15)
    block = Bin(
        (length, length * aspect, 4 * dx), dx, (count, round(count * aspect), 6), 1, 0.0, ()
    )
    experiment = Experiment(room, block, make_soil(1.5e6, 0.5), smooth_sides=True)
    steps = math.ceil(seconds / experiment.dt / 50)
    for _ in range(50):
        experiment.advance(steps)
    # The farthest half per cent are single grains.
    front = np.quantile(experiment.particles[:, 0], 0.995) - CORNER
    expected = 1.2 * aspect if aspect < 1.8 else 1.9 * aspect ** (2.0 / 3.0)
    speed = np.linalg.norm(experiment.particles[:, columns.V : columns.V + 3], axis=1)
    return {
        'runout': float(front / length - 1.0),
        'expected': expected,
        'speed_at_end_m_s': float(np.quantile(speed, 0.99)),
    }
