"""What computes the frames of a `Stepper`, one by one: `SubspaceEngine`, whose step is by
TensorFlow (`TfStep`) or by C (`native.engines`)."""

from typing import Any, NamedTuple

import numpy as np
import tensorflow as tf

from learning_to_simulate.body_height import without_height
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live import poses
from learning_to_simulate.live.soil import Decoder, Soil
from learning_to_simulate.rollout import corrected_step
from learning_to_simulate.rollout_status import OK, Judgement, NodeRanges, RolloutStatus, worse
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace import path_memory, subspace_model
from learning_to_simulate.subspace.learned_simulator import SimulatorState
from learning_to_simulate.subspace.rigid_body import Correction, KnownMotion
from pca_tools import rigid_fit


class Frame(NamedTuple):
    """One frame; its arrays cannot be written to.

    Attributes:
      judgement: how far it can be trusted. An engine judges this frame alone; in the frames of a
        stepper it is the worst since the start, with the frame in which that began and the reason.
      soil: its modes, and particles where they are asked for.
      rigid_pose: float64 [R, D] particles of the body that are nodes, m.
      pose: float64 [7], position (m) and quaternion (w, x, y, z) of the body; None where the body
        is given by its particles, or they do not fix one.
      force: [D] on the body, N, or [B, D] on several; None where the scene has no force.
      now: the status of this frame alone.
    """

    judgement: Judgement
    soil: Soil
    rigid_pose: np.ndarray
    pose: np.ndarray | None
    force: np.ndarray | None
    now: RolloutStatus = RolloutStatus.OK

    torque = None  # none of these models predicts one

    def __repr__(self) -> str:
        values = [] if self.force is None else [f'{value:.4g}' for value in np.ravel(self.force)]
        force = f'force {", ".join(values)} N, ' if values else ''
        return f'<frame: {force}{self.status}{f" ({self.reason})" if self.reason else ""}>'

    @property
    def status(self) -> RolloutStatus:
        """The worst status since the start, as a rollout file would have it."""
        return self.judgement.status

    @property
    def reason(self) -> str:
        """Value and limits behind the status, in words; '' where it is OK."""
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


class SubspaceEngine:
    """Frames of a model in a subspace: says what the coming frame would be, and stays where it is
    until that frame is accepted.

    Args:
      model: `subspace_model.Model`.
      starts: `starts.Starts` of the model folder; None where only recorded frames are begun from.
      subspace: turns modes into particles; None if particles are never asked for.
      n_rigid: R of the first run; None for that of the first start.
      make_step: makes the step of (model, R): `TfStep`, or `native.engines.CStep`.
      name: what the step is called.

    Raises:
      ValueError: a subspace of another number of modes or particles than the model's, or a body
        that the model cannot take.

    Attributes:
      scene, starts, name: of the model, and as given.
    """

    def __init__(
        self, model, starts=None, subspace=None, n_rigid=None, make_step=None, name='TensorFlow'
    ):
        self._model, self._make = model, make_step or TfStep
        self.scene, self.starts, self.name = model.simulator.scene, starts, name
        self._decoder = None
        if subspace is not None:
            self._decoder = Decoder(model.fitting_subspace(subspace), self.scene.up_axis)
        self._sizes: dict[int, tuple] = {}  # R -> step and ranges
        self._now: Any = None  # step of the run
        self._ranges: Any = None
        self._start: Any = None
        self._body: Any = None  # [R, D] of the newest frame, where it is given
        self._coming: Any = None
        self._allowed = {n_rigid} if starts is None else {len(kept) for kept in starts.kept}
        # Compiles now and not in the first frame.
        self._of_size(len(starts.kept[0]) if n_rigid is None else n_rigid)

    @property
    def step(self):
        """The step for bodies of the first size."""
        return next(iter(self._sizes.values()))[0]

    def _of_size(self, n_rigid):
        """The step and the ranges for bodies of R nodes, made once."""
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

    def begin(self, start) -> Frame:
        """The first frame, of a `starts.Start` or `starts.RecordedStart`.

        Raises:
          ValueError: a body that the model does not take; the run before goes on.
        """
        history, n = start.history(), len(start.kept)
        if start.velocity is None and n not in self._allowed:
            raise ValueError(
                f'history has {n} rigid nodes, the bodies of the model {sorted(self._allowed)}'
            )
        step, ranges = self._of_size(n)
        step.reset(history, start.context)
        if start.velocity is None:  # recorded frames: all of them are judged
            judgement = OK
            for k, frame in enumerate(history):
                before = history[k - 1, :n] if k else None
                now = ranges.start(frame, None if k else start.context, before, k)
                judgement = worse(judgement, now)
        else:  # The frames before the newest one are made up.
            before = history[-2, :n] if start.velocity.any() else None
            judgement = ranges.start(history[-1], start.context, before)
        self._now, self._ranges, self._start = step, ranges, start
        self._body = history[-1, :n]
        force = self._by_body(np.zeros(self._model.simulator.force_size, np.float32))
        soil = Soil(history[-1, n:], self._decoder)
        return Frame(judgement, soil, self._body, start.pose, force)

    def _by_body(self, force):
        """The force [F] as [D], or on several bodies [B, D]; None where there is none."""
        simulator = self._model.simulator
        if not simulator.force_size:
            return None
        return force.reshape(-1, simulator.dim) if simulator.force_size > simulator.dim else force

    def propose(self, number: int, coming, context=None, dt: float | None = None) -> Frame:
        """The frame in which the body reaches a pose.

        Args:
          number: of the frame, for its judgement.
          coming: what the start reads of the body: a pose [7] or particles; None where the body is
            predicted. Of a driven body the height is ignored.
          context: float64 [C] from that frame on; None leaves it as it was.
          dt: s; None or the frame time of the model.

        Raises:
          ValueError: see `Stepper.step`.
        """
        scene, start, n = self.scene, self._start, len(self._start.kept)
        if scene.rigid_motion.is_known != (coming is not None):
            takes = 'takes' if coming is None else 'does not take'
            raise ValueError(f'the body is {scene.rigid_motion}: step() {takes} a pose')
        if dt is not None and abs(dt - scene.dt) > 1e-6 * scene.dt:
            raise ValueError(
                f'dt is {dt} s: a frame of the model is {scene.dt:.6g} s and cannot be divided; '
                f'hold the last frame in between'
            )
        body = displacement = None
        if coming is not None:
            body = start.nodes(coming)
            displacement = body - self._body
        position, flat = self._now.propose(body, displacement, context)
        judgement = self._ranges.judge(number, position, flat, body, self._body, context)
        force = self._by_body(flat)
        for values in (position, force):
            if values is not None:
                values.setflags(write=False)
        self._coming = body
        pose = self._pose(coming, position[:n])
        soil = Soil(position[n:], self._decoder)
        return Frame(judgement, soil, position[:n], pose, force)

    def accept(self) -> None:
        """Takes the frame that was proposed last as the newest one."""
        self._now.accept()
        self._body = self._coming

    @property
    def state(self) -> tuple:
        """All that the coming frames follow from; what is put back goes on to the same bits."""
        return self._start, self._body, self._now.state

    @state.setter
    def state(self, state: tuple) -> None:
        self._start, self._body, of_step = state
        self._now, self._ranges = self._of_size(len(self._start.kept))
        self._now.state = of_step

    def _pose(self, coming, nodes):
        """The pose [7] of the body; None where its particles do not fix one."""
        start = self._start
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


class TfStep:
    """Frames by TensorFlow, compiled once.

    Args:
      model: `subspace_model.Model`; its variables are read anew in every frame.
      n_rigid: R, rigid particles that are nodes.
      rigid_correction: whether a predicted body is kept rigid.
    """

    def __init__(self, model: subspace_model.Model, n_rigid: int, rigid_correction: bool = True):
        self._simulator, self._layout = model.simulator, model.layout(n_rigid)
        self._scene = scene = model.simulator.scene
        self._correct = rigid_correction and scene.rigid_motion == RigidMotion.PREDICTED
        self._state: Any = None
        self._proposed: Any = None
        self._context = self._shape = None
        # With a path as an input: the memory of it after the newest frame, of the coming one, and
        # the modes at the start.
        self._memory: Any = None
        self._coming: Any = None
        self._start = None
        dim, shape = self._simulator.dim, (1, self._layout.n_node)
        spec = tf.TensorSpec
        body = spec((1, n_rigid, dim))
        run = (None, None)
        if self._layout.memory is not None:
            run = spec((1, path_memory.WIDTH)), spec((1, scene.n_modes, dim))
        self._frame = tf.function(self._compute, jit_compile=True, autograph=False)
        self._call = self._frame.get_concrete_function(
            SimulatorState(spec((*shape, dim)), spec((*shape, H - 1, dim))),
            KnownMotion(body, body, *run) if scene.rigid_motion.is_known else None,
            spec((1, len(scene.context_names))) if scene.context_names else None,
            spec((1, n_rigid, dim), tf.float64) if self._correct else None,
        )

    @property
    def traces(self) -> int:
        """How often the frame was traced; 1 for the life of a back end."""
        return self._frame.experimental_get_tracing_count()

    def reset(self, history, context) -> None:
        """Starts after the frames float64 [H, V, D], with a context float64 [C] or None."""
        layout = self._layout
        velocity = np.diff(history, axis=0).swapaxes(0, 1)
        self._context = None if context is None else tf.constant(context[None], tf.float32)
        self._state = SimulatorState(
            tf.constant((history[-1] - layout.origin)[None], tf.float32),
            tf.constant(velocity[None], tf.float32),
        )
        n = layout.n_rigid
        if self._correct:
            self._shape = Correction(self._state.offset[:, :n], layout.origin[:n]).shape
        if layout.memory is not None:
            self._start = self._state.offset[:, n:]
            self._memory = layout.memory.start(history[:1, :n])
            for body in history[1:, :n]:
                self._memory = layout.memory.advance(self._memory, body[None])

    def propose(self, body, displacement, context=None):
        """The next frame; the state stays as it is until `accept`.

        Args:
          body: float64 [R, D], m, the body in the coming frame, or None where it is predicted.
          displacement: float64 [R, D], m, of the body into that frame; or None.
          context: float64 [C] from that frame on; None leaves it as it was.

        Returns:
          float64 [V, D] positions, m, and float32 [F] force, N, or None.

        Raises:
          ValueError: a path that leads farther than its memory reaches.
        """
        known = None
        if body is not None:
            motion = [body - self._layout.origin[: self._layout.n_rigid], displacement]
            if self._scene.rigid_motion == RigidMotion.DRIVEN:
                motion = [without_height(x, self._scene.up_axis) for x in motion]
            known = KnownMotion(*(tf.constant(x[None], tf.float32) for x in motion))
        if self._memory is not None:
            memory = self._layout.memory
            self._coming = memory.advance(self._memory, body[None])
            path = tf.constant(memory.values(self._coming))
            known = known._replace(path=path, start=self._start)
        context = self._context if context is None else tf.constant(context[None], tf.float32)
        after, force = self._call(self._state, known, context, self._shape)
        self._proposed = after, context
        position = after.offset.numpy()[0] + self._layout.origin
        return position, None if force is None else force.numpy()[0]

    def accept(self) -> None:
        """Takes the frame that was proposed last as the newest one."""
        self._state, self._context = self._proposed
        self._memory = self._coming

    @property
    def state(self) -> tuple:
        """All that the coming frames follow from; can be put back."""
        return self._state, self._context, self._memory, self._shape, self._start

    @state.setter
    def state(self, state: tuple) -> None:
        self._state, self._context, self._memory, self._shape, self._start = state

    def _compute(self, state, known, context, shape):
        correction = None
        if self._correct:
            correction = Correction(None, self._layout.origin[: self._layout.n_rigid], shape)
        return corrected_step(self._simulator, self._layout, state, known, context, correction)
