"""`Limits`: what of a wanted motion the training runs cover."""

from types import SimpleNamespace

import numpy as np

from learning_to_simulate.body_height import without_height
from learning_to_simulate.live import poses
from learning_to_simulate.rollout_status import RANGE_MARGIN, widened
from learning_to_simulate.scene import RigidMotion

# Shares of a wanted turn that are tried, the largest that is allowed is taken.
SHARES = (1.0, 0.5, 0.25, 0.1, 0.0)
INSIDE = 0.9  # of the judge's margin, so that rounding does not lead out of it
ANGLES = np.deg2rad(np.arange(0.0, 90.5, 0.5))
AXES = ('along the drive', 'in height')


def _of_wheel(field, points):
    """The ranges of a field's wheel as those of its particles [R, 3] where it starts."""
    axes, dt, ranges = field.axes, field.scene.dt, field.ranges
    points = without_height(points, axes.up)
    places = np.stack([points.min(axis=0), points.max(axis=0)])
    size = np.linalg.norm((points - places.mean(axis=0))[:, [axes.axis, axes.up]], axis=1).max()
    places[:, axes.up] = -size, size
    extent = np.stack([np.zeros(3), np.ptp(places, axis=0)])
    places[:, axes.axis] += sorted(axes.sign * place for place in ranges['tip'])
    speed, rim = sorted(axes.sign * v for v in ranges['speed']), np.abs(ranges['rim']).max()
    velocity = np.stack([np.full(3, -rim), np.full(3, rim)])
    velocity[:, axes.axis] += speed
    fastest = np.hypot(rim, np.abs(speed).max())
    return SimpleNamespace(
        given_range=places, given_velocity_range=dt * velocity, body_extent_range=extent,
        body_speed_range=dt * np.array([[0.0], [fastest]]),
    )  # fmt: skip


class Limits:
    """Cuts steps of a body in the plane of drive and height to the ranges of the training runs.

    They are the ranges that `FrameJudge` holds the given motion against.

    Args:
      scene: of the model.
      statistics: of the training runs, with the ranges of a given motion.
      body: float64 [R, 3], m, the nodes of the body in its own frame.
      reader: `poses.PoseReader` of the scene.
    """

    def __init__(self, scene, statistics, body, reader: poses.PoseReader):
        extra = 1 + 2 * INSIDE * RANGE_MARGIN
        (self.low, self.high), self.speed, self._extent, (_, (self._fastest,)) = (
            widened(*x, extra)  # type: ignore[call-arg]
            for x in (
                statistics.given_range, statistics.given_velocity_range,
                statistics.body_extent_range, statistics.body_speed_range,
            )
        )  # fmt: skip
        self._driven = scene.rigid_motion == RigidMotion.DRIVEN
        self._up, self._plan = scene.up_axis, [0, scene.up_axis]
        self._body, self._reader, self._dt = body, reader, scene.dt

    @classmethod
    def of(cls, model, body, reader, start=(0.0, 0.0, 0.0)) -> 'Limits | None':
        """Of a model, or None where it has no such ranges.

        Args:
          model: `api.TrainedModel`.
          body, reader: of the constructor.
          start: (x, height, angle) from which the way of a field's wheel is counted.
        """
        statistics = getattr(getattr(model.model, 'simulator', None), 'statistics', None)
        if getattr(statistics, 'given_range', None) is not None:
            return cls(model.scene, statistics, body, reader)
        field = getattr(model.model, 'field', None)
        if field is not None and field.tool.predicts_height:
            points = poses.placed(body, reader.read(start))
            return cls(model.scene, _of_wheel(field, points), body, reader)
        return None

    def nodes(self, plane) -> np.ndarray:
        """float64 [R, 3], m, at (x, height, angle); of a driven body without its height."""
        points = poses.placed(self._body, self._reader.read(plane))
        return without_height(points, self._up) if self._driven else points

    def angles(self) -> tuple[float, float]:
        """Lowest and highest angle, rad, in which the body is no larger than in training."""

        def last(sign):
            fits = [self._fits(self.nodes((0.0, 0.0, sign * angle))) for angle in ANGLES]
            return sign * ANGLES[fits.index(False) - 1 if False in fits else -1] if fits[0] else 0.0

        return float(last(-1)), float(last(1))

    def _fits(self, points):
        extent = np.ptp(points, axis=0)
        return bool(((extent >= self._extent[0]) & (extent <= self._extent[1])).all())

    def step(self, now, wanted) -> tuple[np.ndarray, str]:
        """A step as far as the training runs cover it.

        Args:
          now, wanted: (x, height, angle), m and rad.

        Returns:
          where the body may go, float64 [3], and what was in the way, '' if nothing.
        """
        now, wanted = np.asarray(now, np.float64), np.asarray(wanted, np.float64)
        before = self.nodes(now)
        for share in SHARES:
            angle = now[2] + share * (wanted[2] - now[2])
            turned = self.nodes((now[0], now[1], angle))
            change = turned - before
            # A body that is outside already may go on, but not farther out.
            low = np.maximum(
                self.speed[0] - change.min(axis=0),
                np.minimum(self.low - turned.min(axis=0), 0.0),
            )
            high = np.minimum(
                self.speed[1] - change.max(axis=0),
                np.maximum(self.high - turned.max(axis=0), 0.0),
            )
            if (low <= high).all() and (share == 0.0 or self._fits(turned)):
                break
        move = np.zeros(3)
        move[self._plan] = wanted[:2] - now[:2]
        if self._driven:
            low[self._up], high[self._up] = -np.inf, np.inf
        allowed = np.clip(move, low, np.maximum(low, high))
        size = np.sqrt(((change + allowed) ** 2).sum(axis=1).mean())
        slower = min(1.0, self._fastest / size) if size > 0 else 1.0
        reached = np.array([*(now[:2] + slower * allowed[self._plan]), now[2]])
        reached[2] += slower * (angle - now[2])
        reason = ''
        if share < 1.0:
            reason = 'the angle is as far as the training runs have it'
        for name, axis in zip(AXES, self._plan):
            if abs(allowed[axis] - move[axis]) > 1e-9:
                reason = f'held back {name}: {self._why(axis, move, turned)}'
        if not reason and slower < 1.0:
            reason = 'as fast as the training runs are'
        return reached, reason

    def _why(self, axis, move, turned):
        outward = turned[:, axis].max() if move[axis] > 0 else turned[:, axis].min()
        limit = (self.high if move[axis] > 0 else self.low)[axis]
        if abs(outward - limit) < abs(move[axis]) + 1e-9:
            return f'the training runs end at {limit:.3g} m'
        low, high = self.speed[0][axis] / self._dt, self.speed[1][axis] / self._dt
        return f'training runs move by {low:.3g} to {high:.3g} m a second'
