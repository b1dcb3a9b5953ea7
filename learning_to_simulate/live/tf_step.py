"""`TfStep`: the frames of a `Stepper` by TensorFlow."""

import copy
from typing import Any

import numpy as np
import tensorflow as tf

from learning_to_simulate.axes import without_height
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.rollout import corrected_step
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace import path_memory, subspace_model
from learning_to_simulate.subspace.learned_simulator import SimulatorState
from learning_to_simulate.subspace.rigid_body import KnownMotion, shape_of


class TfStep:
    """Frames by TensorFlow, compiled once for R rigid particles that are nodes; the variables of
    the `subspace_model.Model` are read anew in every frame."""

    def __init__(self, model: subspace_model.Model, n_rigid: int):
        self._simulator, self._layout = model.simulator, model.layout(n_rigid)
        self._scene = scene = model.simulator.scene
        self._correct = scene.rigid_motion == RigidMotion.PREDICTED
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
            self._shape = shape_of(self._state.offset[:, :n], layout.origin[:n])
        if layout.memory is not None:
            self._start = self._state.offset[:, n:]
            self._memory = layout.memory.start(history[:1, :n])
            for body in history[1:, :n]:
                self._memory = layout.memory.advance(self._memory, body[None])

    def propose(self, body, displacement, context=None):
        """The next frame, positions float64 [V, D], m, and force float32 [F], N, or None; the state
        stays as it is until `accept`. Of the body float64 [R, D], m, in the coming frame and its
        displacement into it, or None where it is predicted; the context float64 [C] from that frame
        on, None where it is as it was. ValueError for a path that leads farther than its memory
        reaches."""
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

    def clone(self) -> 'TfStep':
        """Another run at the same point, by the same compiled function."""
        return copy.copy(self)

    def _compute(self, state, known, context, shape):
        return corrected_step(self._simulator, self._layout, state, known, context, shape)
