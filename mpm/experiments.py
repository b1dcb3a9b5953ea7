"""Small experiments with known answers, for `verify` and the tests. All in SI units."""

import dataclasses
import math

import numba
import numpy as np

from mpm import bodies, columns, packing
from mpm.columns import CHUNK
from mpm.constitutive import Soil, make_soil, update_stress
from mpm.grid import Grid, make_grid, start_nodes
from mpm.scenes import CORNER, EARTH_GRAVITY, Bin, Scene, sampled
from mpm.solver import EXCHANGE, Solver, make_block, make_nodes
from mpm.transfers import keep_elastic, particles_to_grid, return_elastic


def coarse(scene: Scene) -> Scene:
    """Returns the scene on cubic cells of 4 cm (wheel: 2 cm), with as many particles per cell."""
    box = scene.bin
    dx = 0.04 if scene.name == 'excavation' else 0.02
    size = (box.size[0], box.size[1], math.ceil(box.size[2] / dx) * dx)
    return dataclasses.replace(scene, bin=sampled(size, dx, dx, 1, box.height, box.bounds))


def energy(particles, soil: Soil, volume: float, cell, gravity: float) -> float:
    """Returns kinetic, elastic and potential energy of soil in J, heights from the floor.

    The affine part of a particle's motion carries 1/2 m C D C^T with the inertia D of quadratic
    B-splines. The pressure K (1 / J - 1) is the derivative of K (J - 1 - ln J).

    Args:
        particles: float64 [N, COLUMNS].
        soil: their soil.
        volume: m3 of packed soil per particle.
        cell: its sides [3], m.
        gravity: m/s2.
    """
    q = particles
    ratio, s = q[:, columns.VOLUME_RATIO], q[:, columns.S : columns.S + 6]
    motion = (q[:, columns.V : columns.V + 3] ** 2).sum()
    inertia = np.tile(np.asarray(cell) ** 2 / 4, 3)
    motion += (inertia * q[:, columns.C : columns.C + 9] ** 2).sum()
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
        solver: `solver.Solver`; its `steps` and `dt` are those of the CFL limit.
        impulse: float64 [6], given to the body so far: N s, and N m s about its reference point.
    """

    def __init__(
        self,
        room: Bin,
        block: Bin,
        soil: Soil,
        lift: float = 0.0,
        smooth_sides: bool = False,
        steps: int = 0,
    ):
        """Fills the lower corner of `room` with `block`, raised by `lift` m.

        Args:
            room: the box.
            block: the soil in it.
            soil: what it is.
            lift: m.
            smooth_sides: whether the walls across z are smooth.
            steps: per exchange interval; 0: from the CFL limit.
        """
        grid = make_grid(room)
        grid = grid._replace(walls=grid.walls[:5] + (int(smooth_sides),))
        self.particles = packing.lattice(block, seed=0)
        self.particles[:, 1] += lift
        self.solver = Solver(grid, soil, packing.particle_volume(block), steps)
        self.impulse = np.zeros(6)

    @property
    def grid(self) -> Grid:
        """The background grid."""
        return self.solver.grid

    @property
    def mass(self) -> float:
        """Mass of one particle, kg."""
        return self.solver.volume * self.solver.soil.bulk_density

    def momentum(self) -> np.ndarray:
        """Returns the momentum [3] of the soil, N s."""
        return self.mass * self.particles[:, columns.V : columns.V + 3].sum(axis=0)

    def energy(self, gravity: float = EARTH_GRAVITY) -> float:
        """Returns the `energy` of the soil, J."""
        s = self.solver
        return energy(self.particles, s.soil, s.volume, s.grid.cell, gravity)

    def keep(self, rows: np.ndarray) -> None:
        """Leaves only the particles of a mask or a list of rows."""
        self.particles = self.particles[rows]

    def advance(
        self,
        seconds: float,
        gravity: float = EARTH_GRAVITY,
        body: bodies.Body | None = None,
        pose=None,
    ) -> float:
        """Advances by whole exchange intervals, at least `seconds`; returns how far, s.

        Args:
            seconds: s.
            gravity: m/s2.
            body: a body, if there is one.
            pose: function of times [T] (s, from the start of this call) that returns x, y (m) and
                angle (rad) and z (m) of its reference point, [T, 4].

        Raises:
            ValueError: if a particle leaves the grid.
        """
        intervals = math.ceil(seconds / EXCHANGE - 1e-9)
        order = packing.cell_order(self.particles, self.grid)
        block = self.solver.block(self.particles[order])
        moved = ()
        if body is not None:
            path = pose(self.solver.dt * np.arange(intervals * self.solver.steps + 1))
            moved = ((body, path, None, None),)
        for loads in self.solver.advance(block, intervals, gravity, bodies=moved):
            self.impulse += loads.sum(axis=0) * self.solver.dt
        self.particles[order] = block.particles
        return intervals * EXCHANGE


def free_fall(seconds: float = 0.2) -> dict:
    """Drops a block; returns the relative error of its fall and its largest change of shape.

    The fall is compared with the parabola g t2 / 2, which velocity Verlet takes exactly.
    """
    room = Bin((0.2, 0.1, 0.4), 0.02, 0.04, (0, 0, 0), 1, 0.6, ())
    block = Bin((0.2, 0.1, 0.4), 0.02, 0.04, (10, 5, 20), 1, 0.6, ())
    experiment = Experiment(room, block, make_soil(1.5e6, 0.76), lift=0.4)
    # Away from the sticky walls.
    across = experiment.particles[:, [0, 2]]
    experiment.keep((np.abs(across - CORNER - [0.1, 0.2]) < [0.06, 0.12]).all(axis=1))
    start = experiment.particles[:, :3].copy()
    time = experiment.advance(seconds)
    fall = start - experiment.particles[:, :3]
    exact = EARTH_GRAVITY * time**2 / 2
    return {
        'fall_m': exact,
        'error': float(abs(fall[:, 1].mean() / exact - 1.0)),
        'deformation': float(np.abs(fall - [0.0, exact, 0.0]).max() / exact),
    }


def settled_soil(box: Bin, particles: np.ndarray, soil: Soil) -> dict:
    """Returns the reaction of walls and floor over the weight, and the stress over rho g h.

    The vertical stress in the middle of the bin is given apart for the soil above the lowest cell
    and within it: nodes below the floor are held, so that the grid has no linear field there.

    Args:
        box: the bin of the packing.
        particles: the settled packing.
        soil: of the packing.
    """
    grid, nodes = make_grid(box), make_nodes(make_grid(box))
    volume = packing.particle_volume(box)
    mass = volume * soil.bulk_density
    status = np.zeros(2, dtype=np.int64)
    # Half a step of one second: what is scattered is half the force, in N.
    extent = particles_to_grid(
        make_block(particles), nodes.velocity, grid, 0.5, mass, volume, soil.bulk_modulus, status
    )
    before = nodes.velocity.reshape(-1, 4).copy()
    free, _ = start_nodes(nodes, grid, extent, 0.0)
    held = before[:, 3] > 0.0
    held[nodes.free[:free] // 4] = False
    # What the walls take, and the weight of the soil that sits on their own nodes.
    reaction = -before[held, 1].sum() / 0.5 + before[held, 3].sum() * EARTH_GRAVITY
    across = np.array(box.size)[[0, 2]]
    middle = np.abs(particles[:, [0, 2]] - CORNER - across / 2)
    is_inner = (middle < across / 2 - box.size[1]).all(axis=1)
    is_low = particles[:, 1] < CORNER + box.dx
    pressure = soil.bulk_modulus * np.maximum(1.0 / particles[:, columns.VOLUME_RATIO] - 1.0, 0.0)
    stress = pressure - particles[:, columns.S + 1]
    overburden = soil.bulk_density * EARTH_GRAVITY * (box.surface - particles[:, 1])

    def ratio(chosen):
        return float((stress * overburden)[chosen].sum() / (overburden**2)[chosen].sum())

    return {
        'reaction_over_weight': float(reaction / (len(particles) * mass * EARTH_GRAVITY)),
        'stress_over_rho_g_h': ratio(is_inner & ~is_low),
        'stress_at_floor_over_rho_g_h': ratio(is_inner & is_low),
    }


def blade_in_weightless_soil(
    modulus: float = 1.5e6, steps: int = 0, dz: float = 0.04, body: bodies.Body | None = None
) -> tuple[Experiment, float]:
    """Shoots a blade through soil at 2 m/s; returns what is left of it, and the blade's speed.

    It ends before the first grain is a cell and a half from a wall, which would take momentum, too.
    """
    room = Bin((0.4, 0.1, 0.8), 0.02, dz, (0, 0, 0), 1, 0.5, ())
    block = Bin((0.4, 0.1, 0.8), 0.02, dz, (30, 8, 60), 1, 0.5, ())
    experiment = Experiment(room, block, make_soil(modulus, 0.76), lift=0.15, steps=steps)
    across = experiment.particles[:, [0, 2]]
    experiment.keep(np.abs(across - CORNER - [0.2, 0.4]).max(axis=1) < 0.1)
    speed = 2.0

    def pose(times):
        path = np.full((len(times), 4), -math.radians(20.0))
        path[:, 0], path[:, 1] = CORNER + 0.35 - speed * times, CORNER + 0.15
        path[:, 3] = CORNER + 0.4
        return path

    experiment.advance(0.08, 0.0, body or bodies.make_blade(), pose)
    return experiment, speed


def contact_momentum() -> dict:
    """Shoots a blade through weightless soil; returns the momentum that is not accounted for."""
    experiment, _ = blade_in_weightless_soil()
    impulse = experiment.impulse[:3]
    given = np.linalg.norm(impulse)
    lost = np.linalg.norm(experiment.momentum() + impulse)
    return {'impulse_N_s': float(given), 'unbalanced': float(lost / given)}


@numba.njit
def _shear(block, steps, dt, rate, soil):
    keep_elastic(block, 0)
    block.gradient[CHUNK] = rate  # dvx/dy
    for _ in range(steps):
        update_stress(block, 0, 1, dt, soil, 0.0)
    return_elastic(block, 0)


def homogeneous_shear(inertial_number: float, pressure: float = 1000.0) -> dict:
    """Shears one particle at constant volume; returns tau / p and mu(I) of the paper."""
    soil = make_soil(1.5e6, 0.76)
    rate = inertial_number * math.sqrt(pressure / soil.grain_density) / soil.grain_diameter
    row = np.zeros((1, columns.COLUMNS))
    row[0, columns.VOLUME_RATIO] = 1.0 / (1.0 + pressure / soil.bulk_modulus)
    block = make_block(row)
    # Steps of a tenth of a per mille of shear, to a strain of one half.
    _shear(block, 5000, 1.0e-4 / rate, rate, soil)
    s = block.particles[0, columns.S : columns.S + 6]
    tau = math.sqrt(0.5 * (s[:3] ** 2).sum() + (s[3:] ** 2).sum())
    rise = inertial_number / soil.inertial_number_0
    mu = soil.mu_s + (soil.mu_2 - soil.mu_s) * rise / (1.0 + rise)
    return {'tau_over_p': tau / pressure, 'mu': mu}


def column_collapse(aspect: float, length: float = 0.2, seconds: float = 1.5) -> dict:
    """Lets a column of soil collapse in a smooth channel; returns its run-out over its length.

    Friction as of sand with an angle of repose of 30 degrees: mu_s = sin(30 deg), the plane
    strain value. Expected (Lube, Huppert, Sparks, Freundt 2005, Phys. Rev. E 72, 041301): 1.2 a for
    aspect ratios a < 1.8, 1.9 a^(2/3) for a > 2.8.
    """
    dx = length / 15
    reach = length * (1.0 + 2.5 * 1.2 * aspect)
    room = Bin((dx * math.ceil(reach / dx), 0.0, 4 * dx), dx, dx, (0, 0, 0), 1, length * aspect, ())
    count = round(1.5 * 15)
    block = Bin(
        (length, length * aspect, 4 * dx), dx, dx, (count, round(count * aspect), 6), 1, 0.0, ()
    )
    experiment = Experiment(room, block, make_soil(1.5e6, 0.5), smooth_sides=True)
    for _ in range(50):
        experiment.advance(seconds / 50)
    # The farthest half per cent are single grains.
    front = np.quantile(experiment.particles[:, 0], 0.995) - CORNER
    expected = 1.2 * aspect if aspect < 1.8 else 1.9 * aspect ** (2.0 / 3.0)
    speed = np.linalg.norm(experiment.particles[:, columns.V : columns.V + 3], axis=1)
    return {
        'runout': float(front / length - 1.0),
        'expected': expected,
        'speed_at_end_m_s': float(np.quantile(speed, 0.99)),
    }
