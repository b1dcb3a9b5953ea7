"""Whole rollouts in one compiled loop, with everything taken out of the loop that can be.

`SpecialisedRollout` computes what `rollout.RolloutFunction` computes, to float32 round-off:

  - what depends on nothing but the given motion of the body and the context (rate, features,
    encoding, messages and updates of nodes that no soil reaches, their share of the force) is
    computed for all frames before the loop, in large products (`two_pass`);
  - constants are folded into the weights, updates that reach no output do not exist
    (`folded_network`, `folded_simulator`);
  - the loop carries only what frames change, with as much history as the model reads, and writes
    only what it decides: the modes, and of the body nothing, its height, or its particles.
"""

import numpy as np
import tensorflow as tf

from learning_to_simulate.folded_simulator import FoldedSimulator, Given, MovingState
from learning_to_simulate.learned_simulator import (
    Layout,
    LearnedSimulator,
    SimulatorState,
)
from learning_to_simulate.rollout import RolloutFunction, body_shape, corrected_body
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.two_pass import AheadPass, FramePass


def rollout_function(simulator, layout: Layout, rigid_correction: bool = True):
    """The fastest compiled rollout of a model: specialised where its graph lasts."""
    kind = SpecialisedRollout if simulator.config.has_lasting_graph else RolloutFunction
    return kind(simulator, layout, rigid_correction)


class SpecialisedRollout(RolloutFunction):
    """A compiled rollout of B graphs over a fixed number of frames; called as `RolloutFunction`.

    Args:
      simulator: the model; its variables are read anew in every call.
      layout: of the graphs.
      rigid_correction: whether predicted bodies are kept rigid; has no effect where the motion is
        given.
      ahead: whether what is known ahead is computed before the loop.
      dense: whether blocks of all pairs are computed without gathers.
    """

    def __init__(
        self,
        simulator: LearnedSimulator,
        layout: Layout,
        rigid_correction: bool = True,
        ahead: bool = True,
        dense: bool = True,
    ):
        super().__init__(simulator, layout, rigid_correction)
        self._motion = simulator.scene.rigid_motion
        self._ahead, self._dense = ahead, dense

    def _loop(self, state, known, context, n_frame):
        folded = FoldedSimulator(self.simulator, self.layout, self._dense)
        given = given_motion(self.simulator, self.layout, state, known, n_frame)
        n_graph, n = state.offset.shape[0], self.layout.n_rigid
        ahead = AheadPass(n_frame)
        if self._ahead:
            rows = [
                None if x is None else tf.reshape(x, [n_frame * n_graph, *x.shape[2:]])
                for x in given
            ]
            contexts = None if context is None else tf.tile(context, [n_frame, 1])
            folded.predict(ahead, Given(*rows, contexts), MovingState(None, None, None, None))
        shape = body_shape(state.offset[:, :n], self.layout.origin[:n]) if self._correct else None

        def body(k, moving, arrays):
            now = Given(*(None if x is None else x[k] for x in given), context)
            frame = FramePass(ahead.results, k)
            outputs = {n: frame.read(x) for n, x in folded.predict(frame, now, moving).items()}
            after = folded.advance(outputs, moving)
            if self._correct:
                after = _corrected(shape, moving, after, self.layout.origin[:n])
            written = [after.modes, after.body, *(outputs[n] for n in ('force',) if n in outputs)]
            return k + 1, after, [a.write(k, x) for a, x in zip(arrays, written, strict=True)]

        moving = folded.moving(state)
        elements = [moving.modes.shape, moving.body.shape]
        if self.simulator.scene.has_force:
            elements.append((n_graph, state.offset.shape[2]))
        arrays = [tf.TensorArray(tf.float32, n_frame, element_shape=e) for e in elements]
        _, _, arrays = tf.while_loop(
            lambda k, *_: k < n_frame, body, (0, moving, arrays), maximum_iterations=n_frame
        )
        modes, bodies, *forces = (a.stack() for a in arrays)
        offsets = tf.concat([self._body_offsets(known, bodies), modes], axis=2)
        return offsets, forces[0] if forces else None

    def _body_offsets(self, known, bodies):
        """Offsets [T', B, R, D] of the body from what the loop wrote of it."""
        if self._motion == RigidMotion.PREDICTED:
            return bodies
        if self._motion == RigidMotion.DRIVEN:
            up = np.eye(self.simulator.dim, dtype=np.float32)[self.simulator.scene.up_axis]
            return known.offset + bodies[..., None] * up
        if known is None:
            return tf.zeros([*bodies.shape[:2], 0, self.simulator.dim])
        return known.offset


def given_motion(simulator, layout, state: SimulatorState, known, n_frame: int):
    """Offset before each frame, last velocities and coming velocity of the body, as far as given.

    Args:
      simulator, layout: of the model.
      state: before the first frame.
      known: `KnownMotion` [n_frame, B, R, D] or None.
      n_frame: T'.

    Returns:
      float32 [T', B, R, D], [T', B, R, K, D] and [T', B, R, D]; three None where nothing is given.
    """
    if known is None:
        return None, None, None
    n, count = layout.n_rigid, simulator.config.velocity_inputs
    first = state.offset[:, :n], state.velocity[:, :n]
    if simulator.scene.rigid_motion == RigidMotion.DRIVEN:
        up = np.eye(simulator.dim, dtype=np.float32)[simulator.scene.up_axis]
        first = [x - up * tf.reduce_mean(x, axis=1, keepdims=True) for x in first]
    offsets = tf.concat([first[0][None], known.offset[:-1]], 0)
    past = tf.transpose(first[1], [2, 0, 1, 3])[-count:]
    velocities = tf.concat([past, known.velocity], 0)
    windows = tf.stack([velocities[j : j + n_frame] for j in range(count)], axis=3)
    return offsets, windows, known.velocity


def _corrected(shape, before: MovingState, after: MovingState, origin) -> MovingState:
    """`after` with the predicted body kept rigid."""
    placed, velocity = corrected_body(shape, before.body, after.body, origin)
    history = tf.concat([after.body_velocity[:, :, :-1], velocity[:, :, None]], axis=2)
    return after._replace(body=placed, body_velocity=history)
