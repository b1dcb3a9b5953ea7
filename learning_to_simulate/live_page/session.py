"""`Session`: a model, its soil and a tool that is steered; no browser, no clock.

session = Session(lts.load('excavation'))
session.steering.set('depth', 20)
moment = session.advance()          # once a frame
"""

import os
import tempfile
from typing import NamedTuple

import numpy as np

from learning_to_simulate.live import poses
from learning_to_simulate.live.paths import velocity_between
from learning_to_simulate.live.soil import surface
from learning_to_simulate.live_page.limits import Limits
from learning_to_simulate.live_page.recorded import RecordedRuns
from learning_to_simulate.live_page.steering import BladeSteering, WheelSteering
from learning_to_simulate.rollout_status import BOUNDS_FACTOR, RolloutStatus, widened
from learning_to_simulate.scene import RigidMotion

# What the lamp can show, from good to bad.
OK, LIMITED, OUTSIDE, STOPPED = 'ok', 'limited', 'outside', 'stopped'
# Soil that has moved so many times as far as in any training run is told of; at twice as far,
# `rollout_status.BOUNDS_FACTOR`, the page stops.
FAR = 1.5
# Frames of a run that are kept for its file; then it stops.
LONGEST = 36_000


class Moment(NamedTuple):
    """What there is to show of a frame.

    Attributes:
      frame: since the start.
      time: s since the start.
      particles: float32 [N, 3], m.
      pose: float64 [7] of the body.
      force, torque: [3], N and N m, or None.
      lamp: `OK`, `LIMITED`, `OUTSIDE` or `STOPPED`.
      reason: why the lamp is not green, in words.
    """

    frame: int
    time: float
    particles: np.ndarray
    pose: np.ndarray
    force: np.ndarray | None
    torque: np.ndarray | None
    lamp: str
    reason: str


class Session:
    """Everything of a live page but the page. One thread calls its methods.

    Args:
      model: `api.TrainedModel`.
      recorded: runs of the solver to follow, or None.

    Attributes:
      model, scene, recorded: as given, and of the model.
      steering: of the body: `sliders`, `set`, `aim`; any thread may use it. None of a body whose
        motion is predicted.
      within: whether the body keeps to the ranges of the training runs.
      run: the recorded run that is followed, or None.
      moment: the newest `Moment`.
      start, context: which of the model's starts, and {name: value} or None.
      rest, level: float32 [N, 3] the soil at the start, and its height, m.

    Raises:
      FileNotFoundError, ValueError: a model without live stepping.
    """

    def __init__(self, model, recorded: RecordedRuns | None = None):
        self.model, self.scene, self.recorded = model, model.scene, recorded
        self._live = model.stepper()
        self.within = True
        self._angles: tuple | None = None
        self.start, self.context = 0, None
        self.reset()

    def reset(self, run: str | None = None, start: int | None = None, context=None) -> None:
        """Begins again on the bed at rest.

        Args:
          run: name of a recorded run to follow; None for a body that is steered.
          start: which of the model's starts; None for the one of before, or the run's.
          context: {name: value}, where the scene has one; None for that of the start or the run.

        Raises:
          ValueError: no such run; nothing has changed.
        """
        starts = self.model.starts
        if run is not None and (self.recorded is None or run not in self.recorded.runs):
            have = [] if self.recorded is None else list(self.recorded.runs)
            raise ValueError(f'no recorded run {run!r}; there are {have}')
        self.run = None if run is None else self.recorded.runs[run]
        if self.run is not None:
            start, context = self.run.start, self.run.context
        elif start is None:
            start = self.start
        if context is None and starts.context is not None:
            context = starts.context[start]
        names = self.scene.context_names
        if isinstance(context, dict):
            context = [context[name] for name in names]
        first = starts.pose[start] if self.run is None else self.run.poses[0]
        velocity = np.zeros(6)
        if self.run is not None:
            velocity = velocity_between(first, self.run.poses[1], self.scene.dt)
        case = starts.cases[start].get('case')
        self._beginning = {'velocity': velocity, 'case': case, 'context': context}
        judgement = self._live.start(first, **self._beginning)
        self.start, self.rest = start, self._live.particles()
        self.level = float(np.quantile(self.rest[:, self.scene.up_axis], 0.98))
        self.context = None if context is None else dict(zip(names, context))
        self._steer(start, first)
        self._poses = [first]
        self._outside, self._broken = judgement.reason, False
        force = np.zeros(3, np.float32) if self.scene.has_force else None
        self.moment = Moment(0, 0.0, self.rest, first, force, None, *self._lamp(judgement.status))

    def _steer(self, start, first):
        starts, scene = self.model.starts, self.scene
        across = 3 - scene.up_axis if scene.up_axis else 2
        self._reader = poses.PoseReader(scene.up_axis, starts.pose[start][across])
        self._plane = self._reader.plane(first)
        self.steering = self._limits = None
        if not scene.rigid_motion.is_known:
            return
        body = starts.body[start][starts.kept[start]]
        self._limits = Limits.of(self.model, body, self._reader, self._plane)
        if self._angles is None and self.recorded is not None:
            self._angles = self.recorded.angles(self._reader)
        driven = scene.rigid_motion == RigidMotion.DRIVEN
        make = WheelSteering if driven else BladeSteering
        self.steering = make(scene, self._plane, body, self.level, self._limits, self._angles)

    @property
    def forwards(self) -> float:
        """+1 or -1: the way along axis 0 that the body drives."""
        return 1.0 if self.steering is None else self.steering.forwards

    @property
    def plane(self) -> np.ndarray:
        """(x, height, angle) of the body; of a driven one without its height."""
        return self._plane.copy()

    def travel(self) -> tuple[float, float]:
        """Lowest and highest x of the body, m: of the training runs, else of the bed."""
        if self._limits is None:
            return float(self.rest[:, 0].min()), float(self.rest[:, 0].max())
        apart = self._limits.nodes(self._plane)[:, 0] - self._plane[0]
        low, high = self._limits.low[0] - apart.min(), self._limits.high[0] - apart.max()
        return float(low), float(high)

    def take_over(self) -> None:
        """The body is steered from where it is; a recorded run is followed no farther."""
        if self.run is not None:
            self.run = None
            self._plane = self._reader.plane(self.moment.pose)
            if self.steering is not None:
                self.steering.aim(self._plane)

    def pose_of(self, plane) -> np.ndarray:
        """float64 [7] of (x, height, angle)."""
        return self._reader.read(plane)

    def plane_of(self, pose) -> np.ndarray:
        """(x, height, angle) of a pose [7]; raises as `poses.PoseReader.read`."""
        return self._reader.plane(self._reader.read(pose))

    def body(self) -> np.ndarray:
        """float64 [R', 3], m, the particles of the body in its own frame."""
        return self.model.starts.body[self.start]

    def advance(self) -> Moment:
        """One frame farther; where that cannot be, the moment of before with the reason."""
        last = self.moment
        if self._broken:
            return last
        pose, plane, limited = self._next()
        if pose is None and limited:
            return self._stay(limited)
        try:
            frame = self._live.step(pose)
            bad = frame.now in (RolloutStatus.LEFT_BOUNDS, RolloutStatus.NON_FINITE)
        except ValueError as refused:
            # The tool stays where it is; another wish may be possible.
            return self._stay(str(refused))
        if bad:
            self._broken = True
            return self._stay(f'the prediction left its bounds, reset (R): {frame.reason}')
        self._plane = plane
        if pose is not None:
            self._poses.append(pose)
        if not self._outside and frame.now != RolloutStatus.OK:
            self._outside = f'{frame.reason} at {(last.frame + 1) * self.scene.dt:.1f} s'
        lamp, reason = self._lamp(frame.now, limited)
        if (far := self._far(frame)) > FAR:
            lamp = OUTSIDE
            reason = (
                f'the soil has moved {far:.1f} times as far as in any training run; at '
                f'{BOUNDS_FACTOR:g} times the page stops: reset (R)'
            )
        self.moment = Moment(
            last.frame + 1, (last.frame + 1) * self.scene.dt, frame.particles(), frame.pose,
            frame.force, frame.torque, lamp, reason,
        )  # fmt: skip
        return self.moment

    def _stay(self, reason):
        self.moment = self.moment._replace(lamp=STOPPED, reason=reason)
        return self.moment

    def _next(self):
        """Pose, plane and what was in the way of the coming frame; no pose: the run has ended."""
        coming = self.moment.frame + 1
        if coming >= LONGEST:
            return None, None, f'the run is {LONGEST * self.scene.dt:.0f} s long: reset'
        if self.run is not None:
            if coming >= len(self.run):
                return None, None, 'the recorded run has ended: reset, or take the tool'
            return self.run.poses[coming], None, ''
        if self.steering is None:
            return None, None, ''
        wanted, limited = self.steering.wanted(self._plane), ''
        if self.within and self._limits is not None:
            asked, (wanted, limited) = wanted, self._limits.step(self._plane, wanted)
            driven = self.scene.rigid_motion == RigidMotion.DRIVEN
            if driven and asked[0] != self._plane[0] == wanted[0]:
                # It would turn on the spot and dig itself in.
                return None, None, f'{limited}: reset (R)'
        return self._reader.read(wanted), wanted, limited

    def _far(self, frame) -> float:
        """How far the soil has moved, in units of the training runs; 0 of a field."""
        statistics = getattr(getattr(self.model.model, 'simulator', None), 'statistics', None)
        hull = getattr(statistics, 'position_range', None)
        if hull is None:
            return 0.0
        low, high = widened(*hull[:, 1:], 1.0)  # type: ignore[call-arg]
        return float(np.abs((2 * frame.modes - low - high) / (high - low)).max())

    @property
    def sinkage(self) -> float | None:
        """How deep the lowest point of a driven wheel is below the bed at rest, m; else None."""
        if self.scene.rigid_motion != RigidMotion.DRIVEN:
            return None
        up = self.scene.up_axis
        radius = np.linalg.norm(self.body()[:, [0, up]], axis=1).max()
        return self.level + float(radius - self.moment.pose[up])

    def _lamp(self, now, limited=''):
        if now != RolloutStatus.OK:
            return OUTSIDE, f'unlike the training runs: {self._outside}'
        if self._outside:
            return OUTSIDE, f'was unlike the training runs: {self._outside}'
        return (LIMITED, limited) if limited else (OK, '')

    def height_map(self, nx: int, nz: int) -> np.ndarray:
        """float [nx, nz] heights of the newest frame, m; NaN where a cell has no particle."""
        up = self.scene.up_axis
        level = np.delete(self.rest, up, axis=1)
        extent = np.stack([level.min(axis=0), level.max(axis=0)], axis=1)
        return surface(self.moment.particles, extent, up, nx, nz)

    def path(self) -> np.ndarray:
        """float64 [T, 7]: the poses since the start."""
        return np.array(self._poses)

    def rollout_file(self) -> bytes:
        """The run since the start as an `.npz` that `render_rollout` reads; any thread.

        The path is rolled out anew, as `TrainedModel.rollout`: the same frames to round-off.

        Raises:
          ValueError: nothing has moved yet, or a model whose paths cannot be rolled out.
        """
        path, beginning = self.path(), dict(self._beginning)
        if len(path) < 2:
            raise ValueError('there is no frame yet to record')
        rollout = self.model.rollout(path, **beginning)
        with tempfile.TemporaryDirectory() as folder:
            target = os.path.join(folder, 'rollout.npz')
            rollout.save(target)
            with open(target, 'rb') as file:
                return file.read()
