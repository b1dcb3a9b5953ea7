"""Live stepping: one frame per call, for embedding in an interactive program.

Example:
    stepper = Stepper.load('models/excavation/pcg', 'datasets/excavation', n_rigid=10)
    stepper.reset(history)                          # [6, R + r, 3], the last six frames
    while running:
        frame = stepper.step(next_blade_points)     # [R, 3], where the blade will be
        draw(stepper.particles(), frame.rigid_pose, frame.force)

A stepper compiles once, when it is made. After that no call traces, and none allocates memory that
it does not give back. Input that cannot be used is refused before anything changes.
"""

import os
from typing import NamedTuple

import numpy as np
import tensorflow as tf

from learning_to_simulate import checkpoints, experiment
from learning_to_simulate.folded_simulator import FoldedSimulator, Given
from learning_to_simulate.learned_simulator import KnownMotion, SimulatorState
from learning_to_simulate.presets import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.rollout import body_shape, corrected_body
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.two_pass import FramePass
from pca_tools.dataset import read_metadata
from pca_tools.subspace import Subspace


class Frame(NamedTuple):
    """One predicted frame.

    Attributes:
      modes: float64 [r, D] scores, m.
      force: float32 [D] on the body, N, or None where the scene has no force.
      rigid_pose: float64 [R, D] particles of the body that are nodes, m.
    """

    modes: np.ndarray
    force: np.ndarray | None
    rigid_pose: np.ndarray


class Stepper:
    """Steps a trained model frame by frame.

    Args:
      model: `checkpoints.Model`; its weights are taken as they are now.
      n_rigid: R, rigid particles that are nodes.
      subspace: turns modes into particles; None if particles are never asked for.
      rigid_correction: whether a predicted body is kept rigid.

    Raises:
      ValueError: a subspace of another number of modes or particles than the model's, or a body
        that the model cannot take.
    """

    def __init__(
        self,
        model: checkpoints.Model,
        n_rigid: int,
        subspace: Subspace | None = None,
        rigid_correction: bool = True,
    ):
        self._simulator, self._layout = model.simulator, model.layout(n_rigid)
        self._scene = scene = model.simulator.scene
        self._correct = rigid_correction and scene.rigid_motion == RigidMotion.PREDICTED
        self._subspace = subspace
        if subspace is not None:
            subspace = model.fitting_subspace(subspace)
            self._components = np.ascontiguousarray(subspace.components, np.float32)
            self._mean = np.asarray(subspace.mean, np.float32)
        self._state = self._context = self._shape = self._pose = self._modes = None
        dim, shape = self._simulator.dim, (1, self._layout.n_node)
        spec = tf.TensorSpec
        body = spec((1, n_rigid, dim))
        self._frame = tf.function(self._compute, jit_compile=True, autograph=False)
        self._call = self._frame.get_concrete_function(
            SimulatorState(spec((*shape, dim)), spec((*shape, H - 1, dim))),
            KnownMotion(body, body) if scene.rigid_motion.is_known else None,
            spec((1, len(scene.context_names))) if scene.context_names else None,
            spec((1, n_rigid, dim), tf.float64) if self._correct else None,
        )
        self._warm_up(n_rigid)

    @classmethod
    def load(cls, model_path: str, data_path: str, n_rigid: int | None = None, **options):
        """A stepper of a model folder and the dataset folder it belongs to.

        Args:
          model_path: of `checkpoints.load_model`.
          data_path: its metadata and, if it has one, its subspace are read.
          n_rigid: R; default: that of the model's first training run.
          **options: of the constructor.

        Raises:
          FileNotFoundError, ValueError: no model or dataset there, or they do not belong together.
        """
        model = checkpoints.load_model(model_path)
        metadata = read_metadata(data_path)
        experiment.check_dataset(model_path, model, data_path, metadata)
        path = os.path.join(data_path, 'subspace.npz')
        subspace = Subspace.load(path) if os.path.exists(path) else None
        n_rigid = checkpoints.read_config(model_path)['n_rigid'] if n_rigid is None else n_rigid
        return cls(model, n_rigid, subspace, **options)

    @property
    def traces(self) -> int:
        """How often the frame was traced; 1 for the life of a stepper."""
        return self._frame.experimental_get_tracing_count()

    def reset(self, history, context=None) -> None:
        """Starts from the last H frames.

        Args:
          history: [H, V, D] positions, m; R rigid particles, then r modes; newest last.
          context: [C], where the scene has one.

        Raises:
          ValueError: wrong shape or values that are not finite; the state stays as it was.
        """
        layout, dim = self._layout, self._simulator.dim
        history = _checked('history', history, (H, layout.n_node, dim))
        names = self._scene.context_names
        if (context is None) == bool(names):
            raise ValueError(f'the scene takes context {list(names)}, got {context}')
        if names:
            context = _checked('context', context, (len(names),))
            context = tf.constant(context[None], tf.float32)
        velocity = np.diff(history, axis=0).swapaxes(0, 1)
        self._context, self._pose = context, history[-1, : layout.n_rigid]
        self._state = SimulatorState(
            tf.constant((history[-1] - layout.origin)[None], tf.float32),
            tf.constant(velocity[None], tf.float32),
        )
        self._modes = history[-1, layout.n_rigid :]
        if self._correct:
            n = layout.n_rigid
            self._shape = body_shape(self._state.offset[:, :n], layout.origin[:n])

    def step(self, rigid_pose=None) -> Frame:
        """Predicts the next frame.

        Args:
          rigid_pose: [R, D] positions of the body in the coming frame, m, where its motion is given
            (of a driven body the mean height is ignored); None where it is predicted.

        Raises:
          ValueError: before `reset`, a pose where none is taken or the other way round, wrong shape
            or values that are not finite; the state stays as it was.
        """
        if self._state is None:
            raise ValueError('call reset() with the first frames before step()')
        known, pose = self._known(rigid_pose)
        state, force = self._call(self._state, known, self._context, self._shape)
        offset = state.offset.numpy()[0] + self._layout.origin
        force = None if force is None else force.numpy()[0]
        self._state, self._pose = state, pose
        n = self._layout.n_rigid
        self._modes = offset[n:]
        return Frame(self._modes, force, offset[:n])

    def particles(self) -> np.ndarray:
        """float32 [N, D] positions of the soil in the newest frame, m.

        Raises:
          ValueError: before `reset`, or without a subspace.
        """
        if self._subspace is None or self._modes is None:
            missing = 'a subspace' if self._subspace is None else 'reset()'
            raise ValueError(f'particles() needs {missing} first')
        return self._components @ self._modes.astype(np.float32) + self._mean

    def _known(self, rigid_pose):
        """Known motion of the coming frame, and the given pose."""
        if self._scene.rigid_motion.is_known != (rigid_pose is not None):
            takes = 'takes' if rigid_pose is None else 'does not take'
            raise ValueError(f'the body is {self._scene.rigid_motion}: step() {takes} a pose')
        if rigid_pose is None:
            return None, None
        n = self._layout.n_rigid
        pose = _checked('rigid_pose', rigid_pose, (n, self._simulator.dim))
        motion = [pose - self._layout.origin[:n], pose - self._pose]
        if self._scene.rigid_motion == RigidMotion.DRIVEN:
            for values in motion:
                values[:, self._scene.up_axis] -= values[:, self._scene.up_axis].mean()
        return KnownMotion(*(tf.constant(x[None], tf.float32) for x in motion)), pose

    def _compute(self, state, known, context, shape):
        if self._simulator.config.has_lasting_graph:
            after, force = self._folded_step(state, known, context)
        else:
            after, force = self._simulator.step(state, known, context, self._layout)
        if self._correct:
            n = self._layout.n_rigid
            placed, velocity = corrected_body(
                shape, state.offset[:, :n], after.offset[:, :n], self._layout.origin[:n]
            )
            newest = tf.concat([velocity, after.velocity[:, n:, -1]], 1)
            after = SimulatorState(
                tf.concat([placed, after.offset[:, n:]], 1),
                tf.concat([after.velocity[:, :, :-1], newest[:, :, None]], 2),
            )
        return after, force

    def _folded_step(self, state, known, context):
        """`LearnedSimulator.step`, with the weights as constants."""
        simulator, n = self._simulator, self._layout.n_rigid
        folded = FoldedSimulator(simulator, self._layout, frozen=True)
        moving = folded.moving(state)
        up = np.eye(simulator.dim, dtype=np.float32)[self._scene.up_axis]
        given = Given(None, None, None, context)
        if known is not None:
            count = simulator.config.velocity_inputs
            offset, velocity = state.offset[:, :n], state.velocity[:, :n, -count:]
            if self._scene.rigid_motion == RigidMotion.DRIVEN:
                offset, velocity = (
                    x - up * tf.reduce_mean(x, 1, keepdims=True) for x in (offset, velocity)
                )
            given = Given(offset, velocity, known.velocity, context)
        outputs = folded.predict(FramePass({}, None), given, moving)
        after = folded.advance(outputs, moving)
        body, velocity = (tf.zeros([1, 0, simulator.dim]),) * 2
        if self._scene.rigid_motion == RigidMotion.PREDICTED:
            body, velocity = after.body, after.body_velocity[:, :, -1]
        elif known is not None:
            body, velocity = known
            if self._scene.rigid_motion == RigidMotion.DRIVEN:
                body += after.body[:, None] * up
                velocity += after.body_velocity[:, None, -1:] * up
        newest = tf.concat([velocity, after.modes_velocity[:, :, -1]], 1)
        return SimulatorState(
            tf.concat([body, after.modes], 1),
            tf.concat([state.velocity[:, :, 1:], newest[:, :, None]], 2),
        ), outputs.get('force')

    def _warm_up(self, n_rigid):
        """Runs one frame at rest, so that the first real call is as fast as the others."""
        origin = self._layout.origin
        context = np.ones(len(self._scene.context_names)) if self._scene.context_names else None
        self.reset(np.tile(origin, (H, 1, 1)), context)
        self.step(origin[:n_rigid] if self._scene.rigid_motion.is_known else None)
        self._state = self._modes = None


def _checked(name, values, shape):
    """float64 values of the given shape, or a ValueError that says what is wrong."""
    try:
        values = np.array(values, np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f'{name} is not an array of numbers of shape {shape} ({error})') from error
    if values.shape != shape:
        raise ValueError(f'{name} has shape {values.shape}, must be {shape}')
    if not np.isfinite(values).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(values))[0])
        raise ValueError(f'{name} holds {values[where]} at {where}, must be finite')
    return values
