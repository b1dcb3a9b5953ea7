"""`WholeStateSimulator`: one frame from a network that takes the whole state at once, no graph.

Features, normalisation, integration, losses, noise, training and rollouts are those of
`LearnedSimulator`; there are no edges and no node embeddings, because the place of a value in the
input says whose it is. Such a network fits one number of rigid particles.
"""

import tensorflow as tf

from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace import features
from learning_to_simulate.subspace.learned_simulator import LearnedSimulator


class WholeStateSimulator(LearnedSimulator):
    """One frame of the simulation of B scenes by a network on the whole state.

    Args:
      make_network: called with (config, output size) it makes a module with
        `network(history, state) -> [B, output size]` and `zero_decoder()`, where `history` is
        float32 [B, velocity_inputs, V D], the normalised velocities, oldest first, and `state` is
        float32 [B, F], everything else that is known of the coming frame.
      others: as `LearnedSimulator`.
    """

    def __init__(self, make_network, *others, name='whole_state_simulator'):
        self._make = make_network
        self._n_rigid = self._network = None
        super().__init__(*others, name=name)

    def _make_network(self):
        """Waits for `check_size`: the size of the network depends on R."""

    def check_size(self, n_rigid: int):
        """Fixes the network's size at the first call.

        Raises:
          ValueError: a body of another number of rigid particles later on.
        """
        if self._network is None:
            self._n_rigid = n_rigid
            rows = self._rigid_rows() + self.scene.n_modes
            self._network = self._make(self.config, rows * self.dim + self.load_size)
        if n_rigid != self._n_rigid:
            raise ValueError(
                f'model {self.config.model!r} was made for {self._n_rigid} rigid particles and '
                f'cannot take {n_rigid}: keep equally many with --rigid_particles where the '
                f'motion is prescribed, or use model gns'
            )

    def _rigid_rows(self):
        """Rows of the output that move the body: none, its height, or every rigid particle."""
        if self.scene.rigid_motion == RigidMotion.PREDICTED:
            return self._n_rigid
        return 1 if self.scene.rigid_motion == RigidMotion.DRIVEN else 0

    def _decoded(self, state, known, context, layout):
        n_graph = state.offset.shape[0]
        view = features.View(self, state, known, context, layout)
        # The place of a value says whose it is: no node needs a name.
        found = {
            f.name: features.values_of(f, view) for f in features.of(self) if f.name != 'embedding'
        }
        velocities = found.pop('velocity', tf.zeros([n_graph, layout.n_node, 0]))
        values = list(found.values())
        values = [
            tf.broadcast_to(tf.reshape(v, [v.shape[0], -1]), [n_graph, v.shape[1] * v.shape[2]])
            for v in values
        ]
        count = self.config.velocity_inputs if self.config.state_inputs else 0
        history = tf.reshape(velocities, [n_graph, layout.n_node, count, self.dim])
        history = tf.transpose(history, [0, 2, 1, 3])
        history = tf.reshape(history, [n_graph, count, layout.n_node * self.dim])
        if not values:  # the published inputs without a context are the velocities alone
            values = [tf.zeros([n_graph, 0])]
        decoded = self._network(history, tf.concat(values, axis=-1))
        body, n_row, n_mode = self._rigid_rows(), layout.n_rigid, self.scene.n_modes
        size = (body + n_mode) * self.dim
        load, decoded = decoded[:, size:], tf.reshape(decoded[:, :size], [n_graph, -1, self.dim])
        moved = decoded[:, :body]
        if body != n_row:
            moved = self._all_particles(moved, n_row)
        target = tf.concat([moved, decoded[:, body:]], axis=1)
        return target, load if self.scene.has_force else None

    def _all_particles(self, body, n_rigid):
        """The body's one row for all its particles; zeros where its motion is given."""
        shape = [body.shape[0], n_rigid, self.dim]
        return tf.broadcast_to(body, shape) if body.shape[1] else tf.zeros(shape)
