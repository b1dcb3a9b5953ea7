"""`Stepper`: a model in a subspace or on particles, stepped with the poses of its body, one frame
per call.

    stepper = lts.load('excavation/pcg').stepper()
    stepper.start(pose, velocity)
    frame = stepper.step(next_pose)
    points = frame.particles()        # only where they are asked for

A step computes the frames: `TfStep`, `full_space.simulator.ParticleStep`, or by C
(`native.engines`). Input that cannot be used is refused before anything changes; input unlike the
training runs is used and flagged, in that frame and in all that follow. After the first call
nothing is compiled any more.
"""

import contextlib
import copy
import threading
from typing import Any, NamedTuple

import numpy as np
import tensorflow as tf

from learning_to_simulate.axes import without_height
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live import poses, soil
from learning_to_simulate.live.starts import RecordedStart, Start, read_context
from learning_to_simulate.rollout import corrected_step
from learning_to_simulate.rollout_status import OK, Judgement, NodeRanges, RolloutStatus, worse
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace import path_memory
from learning_to_simulate.subspace.learned_simulator import SimulatorState
from learning_to_simulate.subspace.rigid_body import KnownMotion, shape_of
from pca_tools import rigid_fit

FLAG, HOLD, RAISE = 'flag', 'hold', 'raise'


class TfStep:
    """Frames by TensorFlow, compiled once for R rigid particles that are nodes; the variables of
    the `subspace_model.Model` are read anew in every frame."""

    def __init__(self, model, n_rigid: int):
        self._simulator, self._layout = model.simulator, model.layout(n_rigid)
        self._scene = scene = model.simulator.scene
        # Of the newest frame and of the coming one: state, context, memory of the path. Of the
        # run: shape of a predicted body, modes at the start where the path is an input.
        self._newest: Any = None
        self._proposed: Any = None
        self._shape = self._start = None
        dim, shape = self._simulator.dim, (1, self._layout.n_node)
        spec, run = tf.TensorSpec, (None, None)
        body = spec((1, n_rigid, dim))
        predicted = scene.rigid_motion == RigidMotion.PREDICTED
        if self._layout.memory is not None:
            run = spec((1, path_memory.WIDTH)), spec((1, scene.n_modes, dim))
        self._frame = tf.function(self._compute, jit_compile=True, autograph=False)
        n_context = len(scene.context_names)
        self._call = self._frame.get_concrete_function(
            SimulatorState(spec((*shape, dim)), spec((*shape, H - 1, dim))),
            KnownMotion(body, body, *run) if scene.rigid_motion.is_known else None,
            spec((1, n_context)) if n_context else None,
            spec((1, n_rigid, dim), tf.float64) if predicted else None,
        )
        # Compiled now and not in the first frame.
        origin = self._layout.origin
        self.reset(np.tile(origin, (H, 1, 1)), np.ones(n_context) if n_context else None)
        known = origin[:n_rigid], np.zeros((n_rigid, dim))
        self.propose(*known if scene.rigid_motion.is_known else (None, None))

    def reset(self, history, context) -> None:
        """Starts after the frames float64 [H, V, D], with a context float64 [C] or None."""
        layout, n, memory = self._layout, self._layout.n_rigid, None
        velocity = np.diff(history, axis=0).swapaxes(0, 1)
        state = SimulatorState(_batch(history[-1] - layout.origin), _batch(velocity))
        self._shape = shape_of(state.offset, layout, self._scene)
        if layout.memory is not None:
            self._start = state.offset[:, n:]
            memory = layout.memory.start(history[:1, :n])
            for body in history[1:, :n]:
                memory = layout.memory.advance(memory, body[None])
        self._newest = state, None if context is None else _batch(context), memory

    def propose(self, body, displacement, context=None):
        """The next frame, positions float64 [V, D], m, and force float32 [F], N, or None; the state
        stays as it is until `accept`. Of the body float64 [R, D], m, in the coming frame and its
        displacement into it, or None where it is predicted; the context float64 [C] from that frame
        on, None where it is as it was. ValueError for a path that leads farther than its memory
        reaches."""
        layout, known, (state, held, memory) = self._layout, None, self._newest
        if body is not None:
            motion = [body - layout.origin[: layout.n_rigid], displacement]
            if self._scene.rigid_motion == RigidMotion.DRIVEN:
                motion = [without_height(x, self._scene.up_axis) for x in motion]
            known = KnownMotion(*map(_batch, motion))
        if memory is not None:
            memory = layout.memory.advance(memory, body[None])
            path = tf.constant(layout.memory.values(memory))
            known = known._replace(path=path, start=self._start)
        context = held if context is None else _batch(context)
        after, force = self._call(state, known, context, self._shape)
        self._proposed = after, context, memory
        position = after.offset.numpy()[0] + layout.origin
        return position, None if force is None else force.numpy()[0]

    def accept(self) -> None:
        """Takes the frame that was proposed last as the newest one."""
        self._newest = self._proposed

    def clone(self) -> 'TfStep':
        """Another run at the same point, by the same compiled function."""
        return copy.copy(self)

    def _compute(self, state, known, context, shape):
        return corrected_step(self._simulator, self._layout, state, known, context, shape)


def _batch(values):
    return tf.constant(values[None], tf.float32)


class Frame(NamedTuple):
    """One frame; its arrays cannot be written to.

    Attributes:
      judgement: how far it can be trusted: the worst since the start, with the frame in which that
        began and the reason.
      modes: float64 [r, D] scores of the soil, m, or its particles, of a model on them.
      rigid_pose: float64 [R, D] particles of the body that are nodes, m.
      pose: float64 [7], position (m) and quaternion (w, x, y, z) of the body; None where the body
        is given by its particles, or they do not fix one.
      force: [D] on the body, N, or [B, D] on several; None where the scene has no force.
      now: that of this frame alone.
      decoder: turns modes into particles where they are asked for; None without a subspace.
    """

    judgement: Judgement
    modes: np.ndarray
    rigid_pose: np.ndarray
    pose: np.ndarray | None
    force: np.ndarray | None
    now: Judgement = OK
    decoder: soil.Particles | None = None

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

    def particles(self) -> np.ndarray:
        """float32 [N, D] positions of the soil, m; ValueError without a subspace."""
        return soil.known(self.decoder).particles(self.modes)

    def height_map(self, nx: int, nz: int) -> np.ndarray:
        """float32 [nx, nz] heights of the surface, m; see `soil.Decoder.height_map`."""
        return soil.known(self.decoder).height_map(self.modes, nx, nz)


class _Run(NamedTuple):
    """Where a stepper is: its `Start`, newest frame, frames since, and the body [R, D] of the
    newest, where it is given."""

    start: Any
    frame: Frame
    count: int
    body: Any


class Stepper:
    """Steps a model frame by frame.

    Args:
      model: `subspace_model.Model`, or `full_space.method.ParticleModel`.
      starts: `starts.Starts` of the model folder; None where only recorded frames are begun from.
      subspace: turns modes into particles; None if particles are never asked for.
      n_rigid: R of the first run; None for that of the first start.
      outside: what is done with a frame that is not `ok`: 'flag' goes on and says so; 'hold' stays
        in the frame before; 'raise' refuses it. A frame that is not finite never becomes the state.
      make_step: makes the step of (model, R): `TfStep`, `full_space.simulator.ParticleStep`, or
        `native.binding.CSubspace`.

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
        self._decoder = model.decoder(subspace)
        self._lock = threading.Lock()
        self._sizes: dict[int, tuple] = {}  # R -> step and ranges
        self._run: _Run | None = None
        self._allowed = {n_rigid} if starts is None else {len(kept) for kept in starts.kept}
        self._size = len(starts.kept[0]) if n_rigid is None else n_rigid
        self._of_size(self._size)  # compiles now and not in the first frame

    @property
    def computing(self):
        """The step of the run, or before the start of the first size; for comparisons."""
        return self._sizes[self._size][0]

    @property
    def dt(self) -> float:
        return self.scene.dt

    def _of_size(self, n_rigid):
        if n_rigid not in self._sizes:
            limit = None if self.starts is None else self.starts.force_limit
            statistics = self._model.simulator.statistics
            ranges = NodeRanges(n_rigid, statistics, self.scene, limit)
            self._sizes[n_rigid] = self._make(self._model, n_rigid), ranges
        return self._sizes[n_rigid]

    @property
    def frame(self) -> Frame:
        """The newest; ValueError before the start."""
        return self._begun().frame

    @property
    def start_of_run(self) -> Any:
        """The `starts.Start` or `RecordedStart` of the run; ValueError before it."""
        return self._begun().start

    def start(self, pose=None, velocity=None, case=None, context=None) -> Frame:
        """Begins where the body is; returns that frame, with a force of zeros.

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

    def reset(self, history, context=None) -> Frame:
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
            judgement = ranges.history(history, [start.context] + [None] * (H - 1))
        else:  # the frames before the newest one are made up
            before = history[-2, :n] if start.velocity.any() else None
            judgement = ranges.start(history[-1], start.context, before)
        self._size, body = n, history[-1, :n]
        force = self._by_body(np.zeros(self._model.simulator.force_size, np.float32))
        modes, pose = history[-1, n:], start.pose
        frame = Frame(judgement, modes, body, pose, force, judgement, self._decoder)
        self._run = _Run(start, frame, 0, body)
        return frame

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
            frame, body = self._proposed(pose, context, dt)
            run, alone = self._begun(), frame.now
            is_good = alone.status == RolloutStatus.OK
            if not is_good and self._outside == RAISE:
                raise ValueError(f'{alone.status}: {alone.reason}; the state stays as it was')
            holds = not is_good and self._outside == HOLD
            if holds or alone.status == RolloutStatus.NON_FINITE:
                before = run.frame._replace(judgement=frame.judgement)
                self._run = run._replace(frame=before)
                return before._replace(now=alone) if holds else frame
            self.computing.accept()
            self._run = _Run(run.start, frame, run.count + 1, body)
            return frame

    def propose(self, pose=None, context=None, dt: float | None = None) -> Frame:
        """The frame of `step`, flagged where it is not `ok`; nothing changes. Raises as `step`."""
        with _held(self._lock):
            return self._proposed(pose, context, dt)[0]

    def _proposed(self, pose, context, dt):
        """The coming frame, and the body [R, D] in it where it is given."""
        run, known = self._begun(), self.scene.rigid_motion.is_known
        start = run.start
        if context is not None:
            context = read_context(self.scene, context)
        if pose is not None:
            pose = start.read(pose)
        if known != (pose is not None):
            takes = 'takes' if known else 'does not take'
            raise ValueError(f'the body is {self.scene.rigid_motion}: step() {takes} a pose')
        if dt is not None and abs(dt - self.dt) > 1e-6 * self.dt:
            raise ValueError(
                f'dt is {dt} s: a frame of the model is {self.dt:.6g} s and cannot be divided; '
                f'hold the last frame in between'
            )
        body = None if pose is None else start.nodes(pose)
        moved = None if body is None else body - run.body
        step, ranges = self._sizes[self._size]
        position, flat = step.propose(body, moved, context)
        n = len(start.kept)
        alone = ranges.judge(H + run.count, position, flat, body, run.body, context)
        force = self._by_body(flat)
        for values in (position, force):
            if values is not None:
                values.setflags(write=False)
        nodes, modes = position[:n], position[n:]
        at, so_far = self._pose(start, pose, nodes), worse(run.frame.judgement, alone)
        return Frame(so_far, modes, nodes, at, force, alone, self._decoder), body

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

    def clone(self) -> 'Stepper':
        """A stepper of its own at the same point; both go on to the same bits."""
        with _held(self._lock):
            other = copy.copy(self)
            other._lock = threading.Lock()
            other._sizes = {n: (step.clone(), ranges) for n, (step, ranges) in self._sizes.items()}
            return other

    def particles(self) -> np.ndarray:
        """float32 [N, 3] of the soil in the newest frame, or at the start, m; ValueError without a
        subspace."""
        return self.frame.particles()

    def _begun(self) -> _Run:
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
