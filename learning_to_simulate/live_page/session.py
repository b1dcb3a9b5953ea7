"""`Session`: a model, its soil and a tool that is steered; no browser, no clock.

session = Session(lts.load('excavation'))
session.steering.set('depth', 20)
moment = session.advance()          # once a frame
"""

import itertools
import os
import tempfile
from typing import Any, NamedTuple

import numpy as np

from learning_to_simulate.live import poses
from learning_to_simulate.live.paths import velocity_between
from learning_to_simulate.live.soil import plan_extent, surface
from learning_to_simulate.live_page.recorded import RecordedRuns
from learning_to_simulate.live_page.steering import BladeSteering, Ranges, WheelSteering
from learning_to_simulate.rollout_status import RolloutStatus
from learning_to_simulate.scene import RigidMotion

# What the lamp can show, from good to bad.
OK, LIMITED, OUTSIDE, STOPPED = 'ok', 'limited', 'outside', 'stopped'
# Shares of a wanted step (x, height, angle) that are tried, most of it first, until the frame is
# like those of the training runs. A wheel that turns without travelling would dig itself in.
SHARES = sorted(itertools.product((1.0, 0.5, 0.0), repeat=3), key=sum, reverse=True)
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
      bound: N, or None; as of `stepper.Frame`.
      lamp: `OK`, `LIMITED`, `OUTSIDE` or `STOPPED`.
      reason: why the lamp is not green, in words.
    """

    frame: int
    time: float
    particles: np.ndarray
    pose: np.ndarray
    force: np.ndarray | None
    torque: np.ndarray | None
    bound: float | None
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
      plane: (x, height, angle) of the body; of a driven one the height is that of the start.
      start, context: which of the model's starts, and {name: value} or None.
      rest, level: float32 [N, 3] the soil at the start, and its height, m.

    Raises:
      FileNotFoundError, ValueError: a model without live stepping.
    """

    def __init__(self, model, recorded: RecordedRuns | None = None):
        self.model, self.scene, self.recorded = model, model.scene, recorded
        self._live = model.stepper()
        self._is_driven = self.scene.rigid_motion == RigidMotion.DRIVEN
        self.within, self.start, self.context = True, 0, None
        self.reset()

    def reset(self, run: str | None = None, start: int | None = None, context=None) -> None:
        """Begins again on the bed at rest.

        Args:
          run: name of a recorded run to follow; None for a body that is steered.
          start: which of the model's starts; None for the last one, or the run's.
          context: {name: value}, where the scene has one; None for that of the start or the run.

        Raises:
          ValueError: no such run; nothing has changed.
        """
        starts, scene = self.model.starts, self.scene
        known = {} if self.recorded is None else self.recorded.runs
        if run is not None and run not in known:
            raise ValueError(f'no recorded run {run!r}; there are {list(known)}')
        self.run = None if run is None else known[run]
        if self.run is not None:
            start, context = self.run.start, self.run.context
        elif start is None:
            start = self.start
        if context is None and starts.context is not None:
            context = starts.context[start]
        if isinstance(context, dict):
            context = [context[name] for name in scene.context_names]
        first, velocity = starts.pose[start], np.zeros(6)
        if self.run is not None:
            first, second = self.run.poses[:2]
            velocity = velocity_between(first, second, scene.dt)
        case = starts.cases[start].get('case')
        self._beginning = {'velocity': velocity, 'case': case, 'context': context}
        judgement = self._live.start(first, **self._beginning)
        self.start, self.rest = start, self._live.particles()
        self.level = float(np.quantile(self.rest[:, scene.up_axis], 0.98))
        self.context = None if context is None else dict(zip(scene.context_names, context))
        across = 3 - scene.up_axis if scene.up_axis else 2
        self._reader = poses.PoseReader(scene.up_axis, starts.pose[start][across])
        self.plane = self._reader.plane(first)
        self.steering: Any = None
        if scene.rigid_motion.is_known:
            body = starts.body[start][starts.kept[start]]
            make = WheelSteering if self._is_driven else BladeSteering
            ranges = Ranges.of(self.model, self.level, body)
            self.steering = make(scene, self.plane, body, self.level, ranges)
        self._poses, self._broken, self._outside = [first], False, ''
        self._was_ok = judgement.status == RolloutStatus.OK
        force = np.zeros(3, np.float32) if scene.has_force else None
        self.moment = Moment(0, 0.0, self.rest, first, force, None, None, OK, '')
        if not self._was_ok:
            self._outside = judgement.reason
            self._show(OUTSIDE, f'unlike the training runs: {self._outside}')

    @property
    def forwards(self) -> float:
        """+1 or -1: the way along axis 0 that the body drives."""
        return 1.0 if self.steering is None else self.steering.forwards

    def travel(self) -> tuple[float, float]:
        """Lowest and highest x of the body, m: of the training runs, else of the bed."""
        statistics = getattr(self.model.model.simulator, 'statistics', None)
        given = getattr(statistics, 'given_range', None)
        if given is None:
            return float(self.rest[:, 0].min()), float(self.rest[:, 0].max())
        apart = poses.placed(self.body(), self.pose_of(self.plane))[:, 0] - self.plane[0]
        return float(given[0, 0] - apart.min()), float(given[1, 0] - apart.max())

    def take_over(self) -> None:
        """The body is steered from where it is; a recorded run is followed no farther."""
        if self.run is not None:
            self.run = None
            self.plane = self._reader.plane(self.moment.pose)
            if self.steering is not None:
                self.steering.aim(self.plane)

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
        """One frame farther; where that cannot be, the last moment with the reason."""
        coming = self.moment.frame + 1
        if self._broken:
            return self.moment
        if coming >= LONGEST:
            return self._show(STOPPED, f'the run is {LONGEST * self.scene.dt:.0f} s long: reset')
        if self.run is not None and coming >= len(self.run):
            return self._show(STOPPED, 'the recorded run has ended: reset, or take the tool')
        try:
            frame, held = self._step(coming)
        except ValueError as refused:  # The tool stays where it is; another step may be possible.
            return self._show(STOPPED, str(refused))
        if frame.now in (RolloutStatus.LEFT_BOUNDS, RolloutStatus.NON_FINITE):
            self._broken = True
            return self._show(STOPPED, f'the prediction left its bounds: {frame.reason}; reset (R)')
        time, self._was_ok = coming * self.scene.dt, frame.now == RolloutStatus.OK
        if not self._outside and not self._was_ok:
            self._outside = f'{frame.reason} at {time:.1f} s'
        lamp, reason = (LIMITED, f'held back: {held}') if held else (OK, '')
        if self._outside:
            was = 'was unlike' if self._was_ok else 'unlike'
            lamp, reason = OUTSIDE, f'{was} the training runs: {self._outside}'
        if frame.pose is not None:
            self._poses.append(frame.pose)
        self.moment = Moment(
            coming, time, frame.particles(), frame.pose, frame.force, frame.torque, frame.bound,
            lamp, reason,
        )  # fmt: skip
        return self.moment

    def _show(self, lamp, reason):
        self.moment = self.moment._replace(lamp=lamp, reason=reason)
        return self.moment

    def _step(self, coming):
        """The coming frame, and why the body did not go where it was asked to, '' if it did."""
        if self.run is not None:
            return self._live.step(self.run.poses[coming]), ''
        if self.steering is None:
            return self._live.step(), ''
        now, before = self.plane, self._live.state
        step = self.steering.wanted(now) - now
        # Whoever is outside already may move on, else there would be no way back.
        keeps = self.within and self._was_ok
        reason = ''
        for share in SHARES if keeps and not self._is_driven else SHARES[:1]:
            plane = now + share * step
            try:
                frame = self._live.step(self._reader.read(plane))
            except ValueError as refused:
                reason = reason or str(refused)
                continue
            if not keeps or frame.now != RolloutStatus.EXTRAPOLATING:
                self.plane = plane
                return frame, reason
            self._live.state = before
            reason = reason or frame.reason
        raise ValueError(f'{reason}; move a slider, or reset (R)' if keeps else reason)

    @property
    def sinkage(self) -> float | None:
        """How deep the lowest point of a driven wheel is below the bed at rest, m; else None."""
        if not self._is_driven:
            return None
        up = self.scene.up_axis
        radius = np.linalg.norm(self.body()[:, [0, up]], axis=1).max()
        return self.level + float(radius - self.moment.pose[up])

    def height_map(self, nx: int, nz: int) -> np.ndarray:
        """float [nx, nz] heights of the newest frame, m; NaN where a cell has no particle."""
        up = self.scene.up_axis
        return surface(self.moment.particles, plan_extent(self.rest, up), up, nx, nz)

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
