"""`FoldedStep`: a frame with everything taken out of it that can be, for graphs whose edges last.

It computes what `step_form.PlainStep` computes, to float32 round-off:

  - what depends on nothing but the given motion of the body and the context (rate, features,
    encoding, messages and updates of nodes that no soil reaches, their share of the loads) is
    computed for all frames before the loop, in large products (`two_pass`);
  - constants are folded into the weights, updates that reach no output do not exist
    (`folded_network`, `folded_simulator`);
  - a frame carries only what frames change, with as much history as the model reads, and writes
    only what it decides: the modes, and of the body nothing, its height, or its particles.
"""

from typing import Any

import tensorflow as tf

from learning_to_simulate.body_height import up_vector
from learning_to_simulate.compiled.folded_simulator import FoldedSimulator, Given, MovingState
from learning_to_simulate.compiled.step_form import PlainStep, context_in
from learning_to_simulate.compiled.two_pass import AheadPass, FramePass
from learning_to_simulate.rollout import RolloutFunction
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace.learned_simulator import Layout, LearnedSimulator, SimulatorState
from learning_to_simulate.subspace.rigid_body import Correction, given_part


def step_of(simulator, layout, rigid_correction: bool = True):
    """The fastest step of a model: folded where its graph lasts."""
    kind = FoldedStep if simulator.config.has_lasting_graph else PlainStep
    return kind(simulator, layout, rigid_correction)


def rollout_function(simulator, layout, rigid_correction: bool = True) -> RolloutFunction:
    """The fastest compiled rollout of a model."""
    return RolloutFunction(simulator, layout, rigid_correction, step_of)


class FoldedStep:
    """Frames of a graph network; methods as in `step_form`.

    Args:
      simulator: the model; its weights are folded when the step is made.
      layout: of the graphs.
      rigid_correction: whether predicted bodies are kept rigid.
      ahead: whether what is known ahead is computed before the loop.
      dense: whether blocks of all pairs are computed without gathers.
      frozen: whether the weights of now become constants of the compiled function.
      shape: [B, R, D] of the bodies, where the correction goes on from earlier frames.
    """

    def __init__(
        self,
        simulator: LearnedSimulator,
        layout: Layout,
        rigid_correction: bool = True,
        ahead: bool = True,
        dense: bool = True,
        frozen: bool = False,
        shape=None,
    ):
        self.simulator, self.layout = simulator, layout
        self._motion = simulator.scene.rigid_motion
        self._correct = rigid_correction and self._motion == RigidMotion.PREDICTED
        self._ahead, self._shape = ahead, shape
        self._correction: Any = None
        self._folded = FoldedSimulator(simulator, layout, dense, frozen)

    def ahead(self, state, known, context, n_frame):
        """What is given of each frame, and the pass that reads what was computed before."""
        given = given_motion(self.simulator, self.layout, state, known, n_frame)
        path = start = None
        if known is not None:
            path, start = known.path, known.start
        results = self.first_pass(given, context, n_frame, path, start) if self._ahead else {}

        def frame(k):
            at = [None if x is None else x[k] for x in (*given, path)]
            now = Given(*at[:3], context_in(context, k), at[3], start)
            return FramePass(results, k), now

        return frame

    def first_pass(self, given, context, n_frame: int, path=None, start=None) -> dict:
        """What is computed of all frames at once, by name; `given` is of `given_motion`, path and
        start of `KnownMotion`."""
        ahead = AheadPass(n_frame)

        def rows_of(x):
            return tf.reshape(x, [-1, *x.shape[2:]])

        offsets, velocities, coming, paths = (
            None if x is None else rows_of(x) for x in (*given, path)
        )
        starts = None if start is None else tf.tile(start, [n_frame, 1, 1])
        contexts = context
        if context is not None:
            by_frame = context.shape.rank == 3
            contexts = rows_of(context) if by_frame else tf.tile(context, [n_frame, 1])
        nothing = MovingState(None, None, None, None)
        all_given = Given(offsets, velocities, coming, contexts, paths, starts)
        self._folded.predict(ahead, all_given, nothing)
        return ahead.results

    def begin(self, state: SimulatorState) -> MovingState:
        """The part of a state that frames change."""
        n = self.layout.n_rigid
        if self._correct:
            origin = self.layout.origin[:n]
            self._correction = Correction(state.offset[:, :n], origin, self._shape)
        return self._folded.moving(state)

    def advance(self, carry: MovingState, frame):
        """One frame; writes modes, what it decides of the body, and the loads if there are any."""
        one, now = frame
        outputs = {n: one.read(x) for n, x in self._folded.predict(one, now, carry).items()}
        after = self._folded.advance(outputs, carry, now)
        if self._correct:
            placed, velocity = self._correction(carry.body, after.body)
            history = tf.concat([after.body_velocity[:, :, :-1], velocity[:, :, None]], axis=2)
            after = after._replace(body=placed, body_velocity=history)
        return after, [after.modes, after.body, *(outputs[n] for n in ('load',) if n in outputs)]

    def written_shapes(self, carry: MovingState):
        """Of modes, body and loads."""
        size = self.simulator.load_size
        load = [(carry.modes.shape[0], size)] if size else []
        return [carry.modes.shape, carry.body.shape, *load]

    def results(self, stacked, known):
        """Offsets [T', B, V, D] and loads [T', B, F] or None."""
        modes, bodies, *load = stacked
        offsets = tf.concat([self._body_offsets(known, bodies), modes], axis=2)
        return offsets, load[0] if load else None

    def _body_offsets(self, known, bodies):
        """Offsets [T', B, R, D] of the body from what the frames wrote of it."""
        if self._motion == RigidMotion.PREDICTED:
            return bodies
        if self._motion == RigidMotion.DRIVEN:
            up = up_vector(self.simulator.dim, self.simulator.scene.up_axis)
            return known.offset + bodies[..., None] * up
        if known is None:
            return tf.zeros([*bodies.shape[:2], 0, self.simulator.dim])
        return known.offset

    def state_after(self, before, known, carry: MovingState) -> SimulatorState:
        """A whole state after one frame, for callers that keep one.

        Args:
          before: `SimulatorState` before the frame.
          known: `KnownMotion` of the frame, or None.
          carry: after the frame.
        """
        body, velocity = (tf.zeros([1, 0, self.simulator.dim]),) * 2
        if self._motion == RigidMotion.PREDICTED:
            body, velocity = carry.body, carry.body_velocity[:, :, -1]
        elif known is not None:
            body, velocity = known.offset, known.velocity
            if self._motion == RigidMotion.DRIVEN:
                up = up_vector(self.simulator.dim, self.simulator.scene.up_axis)
                body += carry.body[:, None] * up
                velocity += carry.body_velocity[:, None, -1:] * up
        newest = tf.concat([velocity, carry.modes_velocity[:, :, -1]], 1)
        return SimulatorState(
            tf.concat([body, carry.modes], 1),
            tf.concat([before.velocity[:, :, 1:], newest[:, :, None]], 2),
        )


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
    first = [state.offset[:, :n], tf.transpose(state.velocity[:, :n], [2, 0, 1, 3])]
    first = [given_part(x, simulator.scene) for x in first]
    offsets = tf.concat([first[0][None], known.offset[:-1]], 0)
    past = first[1][-count:]
    velocities = tf.concat([past, known.velocity], 0)
    windows = tf.stack([velocities[j : j + n_frame] for j in range(count)], axis=3)
    return offsets, windows, known.velocity
