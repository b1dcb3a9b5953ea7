"""A block of soil that is stepped by hand, for checks and tests. All in SI units."""

import dataclasses
import math

import numpy as np

from mpm import bodies, columns, packing
from mpm.constitutive import Soil, make_soil
from mpm.grid import Grid, make_grid
from mpm.scenes import CORNER, EARTH_GRAVITY, Bin, Scene, sampled
from mpm.solver import EXCHANGE, Solver


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
