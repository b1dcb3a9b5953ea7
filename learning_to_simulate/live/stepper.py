"""`Stepper`: a model in a subspace, stepped with the poses of its body, one frame per call.

    stepper = lts.load('excavation/pcg').stepper()
    stepper.start(pose, velocity)
    frame = stepper.step(next_pose)
    points = frame.particles()        # only where they are asked for

A step computes the frames: `tf_step.TfStep`, or by C (`native.engines`). Input that cannot be used
is refused before anything changes; input unlike the training runs is used and flagged, in that
frame and in all that follow. After the first call nothing is compiled any more.
"""

import contextlib
import threading
from typing import Any, NamedTuple

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live import poses
from learning_to_simulate.live.soil import Decoder, Soil
from learning_to_simulate.live.starts import RecordedStart, Start, read_context
from learning_to_simulate.live.tf_step import TfStep
from learning_to_simulate.rollout_status import OK, Judgement, NodeRanges, RolloutStatus, worse
from learning_to_simulate.scene import RigidMotion
from pca_tools import rigid_fit

FLAG, HOLD, RAISE = 'flag', 'hold', 'raise'


class Frame(NamedTuple):
    """One frame; its arrays cannot be written to.

    Attributes:
      judgement: how far it can be trusted: the worst since the start, with the frame in which that
        began and the reason.
      soil: its modes, and particles where they are asked for.
      rigid_pose: float64 [R, D] particles of the body that are nodes, m.
      pose: float64 [7], position (m) and quaternion (w, x, y, z) of the body; None where the body
        is given by its particles, or they do not fix one.
      force: [D] on the body, N, or [B, D] on several; None where the scene has no force.
      now: that of this frame alone.
    """

    judgement: Judgement
    soil: Soil
    rigid_pose: np.ndarray
    pose: np.ndarray | None
    force: np.ndarray | None
    now: Judgement = OK

    def __repr__(self) -> str:
        values = [] if self.force is None else [f'{value:.4g}' for value in np.ravel(self.force)]
        force = f'force {", ".join(values)} N, ' if values else ''
        return f'<frame: {force}{self.status}{f" ({self.reason})" if self.reason else ""}>'

    @property
    def torque(self) -> None:
        """None of these models predicts one."""

    @property
    def status(self) -> RolloutStatus:
        """The worst since the start."""
        return self.judgement.status

    @property
    def reason(self) -> str:
        return self.judgement.reason

    @property
    def modes(self) -> np.ndarray:
        """float64 [r, D] scores, m."""
        return self.soil.modes

    def particles(self) -> np.ndarray:
        """float32 [N, D] positions of the soil, m; ValueError without a subspace."""
        return self.soil.particles()

    def height_map(self, nx: int, nz: int) -> np.ndarray:
        """float32 [nx, nz] heights of the surface, m; see `soil.surface`."""
        return self.soil.height_map(nx, nz)


class StepperState(NamedTuple):
    """All that a stepper knows; what is kept can be put back. `body` [R, D] is that of the newest
    frame, where it is given, `of_step` what its step knows."""

    start: Any
    frame: Frame
    count: int
    body: Any
    of_step: Any


class Stepper:
    """Steps a model frame by frame.

    Args:
      model: `subspace_model.Model`.
      starts: `starts.Starts` of the model folder; None where only recorded frames are begun from.
      subspace: turns modes into particles; None if particles are never asked for.
      n_rigid: R of the first run; None for that of the first start.
      outside: what is done with a frame that is not `ok`: 'flag' goes on and says so; 'hold' stays
        in the frame before; 'raise' refuses it. A frame that is not finite never becomes the state.
      make_step: makes the step of (model, R): `TfStep`, or `native.engines.CStep`.

    Raises:
      ValueError: an unknown `outside`, a subspace of another number of modes or particles than the
        model's, or a body that the model cannot take.

    Attributes:
      scene, starts: of the model.
      engine: what computes the frames: C with its instructions, or TensorFlow and why not C.
    """

    def __init__(
        self, model, starts=None, subspace=None, n_rigid=None, outside=FLAG, make_step=TfStep
    ):
        if outside not in (FLAG, HOLD, RAISE):
            raise ValueError(f'outside is {outside!r}, must be one of {(FLAG, HOLD, RAISE)}')
        self._model, self._make, self._outside = model, make_step, outside
        self.scene, self.starts, self.engine = model.simulator.scene, starts, 'TensorFlow'
        self._decoder = None
        if subspace is not None:
            self._decoder = Decoder(model.fitting_subspace(subspace), self.scene.up_axis)
        self._lock = threading.Lock()
        self._sizes: dict[int, tuple] = {}  # R -> step and ranges
        self._run: StepperState | None = None  # but for what its step knows
        self._allowed = {n_rigid} if starts is None else {len(kept) for kept in starts.kept}
        # Compiles now and not in the first frame.
        self._now, self._ranges = self._of_size(len(starts.kept[0]) if n_rigid is None else n_rigid)

    @property
    def computing(self):
        """The step of the run, or before the start of the first size; for comparisons."""
        return self._now

    @property
    def dt(self) -> float:
        return self.scene.dt

    def _of_size(self, n_rigid):
        if n_rigid not in self._sizes:
            model, scene = self._model, self.scene
            step = self._make(model, n_rigid)
            origin = model.layout(n_rigid).origin
            n = len(scene.context_names)
            step.reset(np.tile(origin, (H, 1, 1)), np.ones(n) if n else None)
            known = origin[:n_rigid], np.zeros((n_rigid, origin.shape[1]))
            step.propose(*known if scene.rigid_motion.is_known else (None, None))
            limit = None if self.starts is None else self.starts.force_limit
            ranges = NodeRanges(n_rigid, model.simulator.statistics, scene, limit)
            self._sizes[n_rigid] = step, ranges
        return self._sizes[n_rigid]

    def start(self, pose=None, velocity=None, case=None, context=None) -> Judgement:
        """Begins where the body is; returns how the start is to be judged.

        Args:
          pose: of the body now (see `poses`); None for that of the case.
          velocity: [3] linear, m/s, or [6] with the angular one, rad/s, in the world's axes; None
            for a body at rest.
          case: of the dataset, where beds or bodies differ by case; None for the most similar
            context, or the first.
          context: [C] or {name: value}, where the scene has one; None for that of the case.

        Raises:
          ValueError: something that cannot be used; the state stays as it was.
          RuntimeError: another thread is at work here.
        """
        with _held(self._lock):
            start = Start(self.scene, self.starts, pose, velocity, case, context)
            start.pose.setflags(write=False)
            return self._begin(start)

    def reset(self, history, context=None) -> Judgement:
        """Starts from the last H frames, the body told by its particles; `step` then takes those.

        Args:
          history: [H, V, D] positions, m; R rigid particles, then r modes; newest last.
          context: [C], where the scene has one.

        Raises:
          ValueError, RuntimeError: as `start`; values that are not finite in float32.
        """
        with _held(self._lock):
            shape = np.shape(history)
            n_rigid = max(shape[1] - self.scene.n_modes if len(shape) == 3 else 0, 0)
            start = RecordedStart(self.scene, n_rigid, history, context)
            if n_rigid not in self._allowed:
                raise ValueError(
                    f'history has {n_rigid} rigid nodes, the bodies of the model '
                    f'{sorted(self._allowed)}'
                )
            return self._begin(start)

    def _begin(self, start):
        history, n = start.history(), len(start.kept)
        step, ranges = self._of_size(n)
        step.reset(history, start.context)
        if start.velocity is None:  # recorded frames: all of them are judged
            judgement = OK
            for k, frame in enumerate(history):
                before = history[k - 1, :n] if k else None
                now = ranges.start(frame, None if k else start.context, before, k)
                judgement = worse(judgement, now)
        else:  # the frames before the newest one are made up
            before = history[-2, :n] if start.velocity.any() else None
            judgement = ranges.start(history[-1], start.context, before)
        self._now, self._ranges, body = step, ranges, history[-1, :n]
        force = self._by_body(np.zeros(self._model.simulator.force_size, np.float32))
        soil = Soil(history[-1, n:], self._decoder)
        frame = Frame(judgement, soil, body, start.pose, force, judgement)
        self._run = StepperState(start, frame, 0, body, None)
        return judgement

    def step(self, pose=None, context=None, dt: float | None = None) -> Frame:
        """Predicts the frame in which the body reaches a pose.

        Args:
          pose: of the body in the coming frame (see `poses`), where its motion is given; of a
            driven body the height is ignored. None where the body is predicted. After `reset` the
            particles [R, D] of the body, m.
          context: [C] or {name: value} in the coming frame and those after it, where it changes;
            None leaves it as it was.
          dt: s; None or the frame time of the model, which cannot be divided.

        Raises:
          ValueError: before the start; not a pose, or one where none is taken; another time step; a
            path beyond what a memory of it reaches; with `outside='raise'` a frame that is not
            `ok`. The state stays as it was.
          RuntimeError: another thread is at work here.
        """
        with _held(self._lock):
            run, scene = self._begun(), self.scene
            last, start = run.frame, run.start
            if context is not None:
                context = read_context(scene, context)
            if pose is not None:
                pose = start.read(pose)
            if scene.rigid_motion.is_known != (pose is not None):
                takes = 'takes' if pose is None else 'does not take'
                raise ValueError(f'the body is {scene.rigid_motion}: step() {takes} a pose')
            if dt is not None and abs(dt - scene.dt) > 1e-6 * scene.dt:
                raise ValueError(
                    f'dt is {dt} s: a frame of the model is {scene.dt:.6g} s and cannot be '
                    f'divided; hold the last frame in between'
                )
            body = None if pose is None else start.nodes(pose)
            moved = None if body is None else body - run.body
            position, flat = self._now.propose(body, moved, context)
            number, n = H + run.count, len(start.kept)
            alone = self._ranges.judge(number, position, flat, body, run.body, context)
            so_far = worse(last.judgement, alone)
            if alone.status != RolloutStatus.OK and self._outside != FLAG:
                if self._outside == RAISE:
                    raise ValueError(f'{alone.status}: {alone.reason}; the state stays as it was')
                held = last._replace(judgement=so_far)
                self._run = run._replace(frame=held)
                return held._replace(now=alone)
            force = self._by_body(flat)
            for values in (position, force):
                if values is not None:
                    values.setflags(write=False)
            soil, at = Soil(position[n:], self._decoder), self._pose(start, pose, position[:n])
            frame = Frame(so_far, soil, position[:n], at, force, alone)
            if alone.status == RolloutStatus.NON_FINITE:
                self._run = run._replace(frame=last._replace(judgement=so_far))
                return frame
            self._now.accept()
            self._run = StepperState(start, frame, run.count + 1, body, None)
            return frame

    def _by_body(self, force):
        """The force [F] as [D], or on several bodies [B, D]; None where there is none."""
        simulator = self._model.simulator
        if not simulator.force_size:
            return None
        return force.reshape(-1, simulator.dim) if simulator.force_size > simulator.dim else force

    def _pose(self, start, coming, nodes):
        """The pose [7] of the body; None where its particles do not fix one."""
        if start.velocity is None:  # told by its particles
            return None
        if coming is None:
            if len(nodes) < rigid_fit.MIN_POINTS or not np.isfinite(nodes).all():
                return None
            motion = rigid_fit.fit_rigid_motion(start.body[start.kept], nodes)
            return np.concatenate([motion.translation, poses.quaternion_of(motion.rotation)])
        if self.scene.rigid_motion == RigidMotion.DRIVEN:  # the height is the model's
            up = self.scene.up_axis
            coming[up] += (nodes - start.nodes(coming))[:, up].mean()
        coming.setflags(write=False)
        return coming

    @property
    def state(self) -> StepperState:
        """What is kept can be put back, and goes on from there to the same bits; ValueError before
        `start`."""
        return self._begun()._replace(of_step=self._now.state)

    @state.setter
    def state(self, state: StepperState) -> None:
        with _held(self._lock):
            self._now, self._ranges = self._of_size(len(state.start.kept))
            self._now.state = state.of_step
            self._run = state

    def particles(self) -> np.ndarray:
        """float32 [N, 3] of the soil in the newest frame, or at the start, m; ValueError without a
        subspace."""
        return self._begun().frame.particles()

    def _begun(self) -> StepperState:
        if self._run is None:
            raise ValueError('call start() first')
        return self._run


@contextlib.contextmanager
def _held(lock):
    """A lock that is held for a call, or a message: two threads would mix their paths."""
    if not lock.acquire(blocking=False):
        raise RuntimeError('another thread is using this stepper; give each thread its own')
    try:
        yield
    finally:
        lock.release()
