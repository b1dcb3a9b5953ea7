"""`Box`: soil on a coarse grid with up to two bodies, stepped frame by frame."""

import dataclasses
from collections.abc import Callable

import numpy as np

from mpm import packing
from mpm.bodies import Body, sample_points
from mpm.constitutive import Soil
from mpm.experiments import Experiment
from mpm.scenes import EARTH_GRAVITY, Bin
from mpm.solver import EXCHANGE

SETTLE_S = 0.2


@dataclasses.dataclass
class Moving:
    """A body and where it is.

    Attributes:
        body: its shape; `body.points` are recorded.
        pose: function of times [n] (s) that returns x, y (m) and angle (rad), [n, 3].
        load: N of a time (s), under which the height of `pose` is free; None where it is given.
    """

    body: Body
    pose: Callable
    load: Callable | None = None


class Box(Experiment):
    """Soil in the lower corner of a room, and the bodies that move it.

    Attributes:
        time: s since the bodies began to move.
        heave: float64 [3], see `solver.Motion`, of the first body.
    """

    def __init__(self, room: Bin, block: Bin, soil: Soil, smooth_sides: bool = False):
        super().__init__(room, block, soil, smooth_sides=smooth_sides)
        self.time, self.heave = 0.0, np.zeros(3)

    def settle(self, body: Body | None = None, height: float = 0.0, at=None, load: float = 0.0):
        """Lets the soil come to rest, and a body with a free height sink in from `height` (m)."""
        self.advance(SETTLE_S)
        if body is not None:
            self.heave[:] = height, 0.0, load / EARTH_GRAVITY
            self._advance(
                SETTLE_S, [Moving(body, lambda t: np.tile(at, (len(t), 1)), lambda t: load)]
            )
        self.particles[:, 3:6] = 0.0

    def frame(self, seconds: float, bodies=()) -> list[np.ndarray]:
        """Advances by a frame.

        Args:
            seconds: of the frame, a whole number of exchange intervals.
            bodies: at most two `Moving`; only the first may have a load.

        Returns:
            force [3] (N) of the soil on each body, mean over the frame.

        Raises:
            ValueError: not a whole number of intervals, or more bodies than that.
        """
        if len(bodies) > 2 or any(b.load for b in bodies[1:]):
            raise ValueError('the box takes two bodies at most, of which the first may have a load')
        before = self.impulse.copy(), self.solver.second_impulse.copy()
        self._advance(seconds, bodies)
        self.time += seconds
        after = self.impulse, self.solver.second_impulse
        return [(b[:3] - a[:3]) / seconds for a, b, _ in zip(before, after, bodies)]

    def _advance(self, seconds, bodies):
        intervals = round(seconds / EXCHANGE)
        if abs(intervals * EXCHANGE - seconds) > 1e-9:
            raise ValueError(f'{seconds} s is no whole number of {EXCHANGE:.3g} s')
        solver = self.solver
        times = self.time + solver.dt * np.arange(intervals * solver.steps + 1)
        order = packing.cell_order(self.particles, self.grid)
        block = solver.block(self.particles[order])
        options = {}
        if bodies:
            first, *others = bodies
            options = {'body': first.body, 'path': first.pose(times)}
            if first.load is not None:
                weight = np.array([first.load(t) for t in times])
                options |= {'weight': weight, 'heave': self.heave}
            if others:
                options['second'] = others[0].body, others[0].pose(times)
        solver.advance(block, intervals, EARTH_GRAVITY, **options)
        self.particles[order] = block.particles

    def points(self, moving: Moving) -> np.ndarray:
        """float64 [R, 3], m, of a body now."""
        x, y, angle = moving.pose(np.array([self.time]))[0]
        return sample_points(moving.body, x, self.heave[0] if moving.load else y, angle)
