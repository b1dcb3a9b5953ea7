"""One frame behind one interface: `PlainStep` here, `folded_step.FoldedStep` for speed.

Rollouts, live steps and the count of products use the same five methods:

  ahead(state, known, context, n_frame) -> frames   what is known of every frame; frames(k) is one;
                                                    context [B, C], or [n_frame, B, C], or None
  begin(state) -> carry                             the part of the state that frames change
  advance(carry, frame) -> carry, written           one frame; written are tensors to be kept
  written_shapes(carry) -> shapes                   of `written`
  results(stacked, known) -> offsets, loads         from what was written in all frames
  state_after(before, known, carry) -> state        a whole `SimulatorState` after one frame
"""

from typing import Any

import tensorflow as tf

from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace.learned_simulator import SimulatorState
from learning_to_simulate.subspace.rigid_body import Correction


def context_in(context, frame):
    """The context [B, C] of a frame, of one [B, C] for all or [n_frame, B, C]; None for None."""
    return context if context is None or context.shape.rank == 2 else context[frame]


class PlainStep:
    """Frames by `LearnedSimulator.step`: for networks of any kind, and what the folded form is held
    against.

    Args:
      simulator: the model.
      layout: of the graphs.
      rigid_correction: whether predicted bodies are kept rigid.
      shape: [B, R, D] of the bodies, where the correction goes on from earlier frames.
    """

    def __init__(self, simulator, layout, rigid_correction: bool = True, shape=None):
        self.simulator, self.layout = simulator, layout
        self._correct = rigid_correction and simulator.scene.rigid_motion == RigidMotion.PREDICTED
        self._shape = shape
        self._correction: Any = None

    def ahead(self, state, known, context, n_frame):
        """The known motion by frame, and the context."""
        del state, n_frame

        def frame(k):
            return None if known is None else known.at(k), context_in(context, k)

        return frame

    def begin(self, state: SimulatorState) -> SimulatorState:
        """The state itself."""
        n = self.layout.n_rigid
        if self._correct:
            origin = self.layout.origin[:n]
            self._correction = Correction(state.offset[:, :n], origin, self._shape)
        return state

    def advance(self, carry: SimulatorState, frame):
        """One frame; writes the offsets of all nodes and, where there are any, the loads."""
        after, load = self.simulator.step(carry, *frame, self.layout)
        if self._correct:
            n = self.layout.n_rigid
            placed, velocity = self._correction(carry.offset[:, :n], after.offset[:, :n])
            last = tf.concat([velocity, after.velocity[:, n:, -1]], axis=1)
            after = SimulatorState(
                tf.concat([placed, after.offset[:, n:]], axis=1),
                tf.concat([after.velocity[:, :, :-1], last[:, :, None]], axis=2),
            )
        return after, [after.offset] + ([] if load is None else [load])

    def written_shapes(self, carry: SimulatorState):
        """Of offsets and loads."""
        shape = carry.offset.shape
        size = self.simulator.load_size
        load = [(shape[0], size)] if size else []
        return [shape, *load]

    def results(self, stacked, known):
        """Offsets [T', B, V, D] and loads [T', B, F] or None."""
        del known
        return stacked[0], stacked[1] if len(stacked) > 1 else None

    def state_after(self, before, known, carry: SimulatorState) -> SimulatorState:
        """The state itself."""
        del before, known
        return carry
