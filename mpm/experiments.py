"""A block of soil that is stepped by hand, for checks and tests. All in SI units."""

import math

import numpy as np

from mpm import bodies, packing
from mpm.columns import V
from mpm.constitutive import Soil, make_soil
from mpm.grid import make_grid
from mpm.motions.drive import poses
from mpm.scenes import CORNER, EARTH_GRAVITY, Bin
from mpm.solver import EXCHANGE, Solver


class Experiment:
    """A block of soil in a box, stepped by hand; its `particles` [N, COLUMNS] are free of stress
    and at rest at first."""

    def __init__(
        self, room: Bin, block: Bin, soil: Soil, lift: float = 0.0, smooth_sides: bool = False
    ):
        """Fills the lower corner of the box `room` with the soil of `block`, raised by `lift` m;
        `smooth_sides`: the walls across z are smooth."""
        grid = make_grid(room)
        grid = grid._replace(walls=grid.walls[:5] + (int(smooth_sides),))
        self.particles = packing.lattice(block, seed=0)
        self.particles[:, 1] += lift
        self.solver = Solver(grid, soil, packing.particle_volume(block))
        self.impulse = np.zeros(6)  # given to the body: N s, and N m s about its reference point

    @property
    def mass(self) -> float:
        """Mass of one particle, kg."""
        return self.solver.volume * self.solver.soil.bulk_density

    def momentum(self) -> np.ndarray:
        """Returns the momentum [3] of the soil, N s."""
        return self.mass * self.particles[:, V : V + 3].sum(axis=0)

    def advance(
        self, seconds: float, gravity: float = EARTH_GRAVITY, body=None, pose=None
    ) -> float:
        """Advances by whole exchange intervals, at least `seconds`; returns how far, s.

        A `bodies.Body` moves along `pose`: times [T] (s, from the start of this call) -> its poses
        [T, 4].
        """
        intervals = math.ceil(seconds / EXCHANGE - 1e-9)
        order = packing.cell_order(self.particles, self.solver.grid)
        block = self.solver.block(self.particles[order])
        moved = None
        if body is not None:
            path = pose(self.solver.dt * np.arange(intervals * self.solver.steps + 1))
            moved = body, path, None, None
        loads = self.solver.advance(block, intervals, gravity, moved=moved)
        self.impulse += loads.sum(axis=0) * self.solver.dt
        self.particles[order] = block.particles
        return intervals * EXCHANGE


def weightless_soil(modulus: float = 1.5e6) -> Experiment:
    """Returns a block of soil, far from all walls, for a blade that stands beside it."""
    block = Bin((0.4, 0.1, 0.8), 0.02, 0.04, (30, 8, 60), 1, 0.5, ())
    experiment = Experiment(block, block, make_soil(modulus, 0.76), lift=0.15)
    across = experiment.particles[:, [0, 2]]
    is_kept = np.abs(across - CORNER - [0.2, 0.4]).max(axis=1) < 0.1
    experiment.particles = experiment.particles[is_kept]
    return experiment


def blade_in_weightless_soil(modulus: float = 1.5e6) -> tuple[Experiment, float]:
    """Shoots a blade through soil at 2 m/s; returns what is left of it, and the blade's speed.

    It ends before the first grain is a cell and a half from a wall, which would take momentum, too.
    """
    experiment, speed = weightless_soil(modulus), 2.0

    def pose(times):
        x = CORNER + 0.35 - speed * times
        return poses(times, x, CORNER + 0.15, -math.radians(20.0), CORNER + 0.4)

    experiment.advance(0.08, 0.0, bodies.make_blade(), pose)
    return experiment, speed
