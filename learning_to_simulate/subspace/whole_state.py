"""`WholeStateSimulator`: one frame from a network that takes the whole state at once, no graph: the
MLP and the Motion-Mixers.

All but the network is as of `LearnedSimulator`. There are no edges and no node embeddings, because
the place of a value in the input says whose it is. Such a network fits one number of rigid
particles.
"""

import sonnet as snt
import tensorflow as tf

from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace import features
from learning_to_simulate.subspace.learned_simulator import LearnedSimulator

REDUCTION = 4  # of the channels in the squeeze; Hu et al. take 16 of hundreds of channels


class WholeStateSimulator(LearnedSimulator):
    """One frame of the simulation of B scenes by a network on the whole state.

    Its `network(history, state) -> [B, output size]` takes the normalised velocities, oldest first,
    float32 [B, velocity_inputs, V D], and everything else that is known of the coming frame,
    float32 [B, F].
    """

    def _make_network(self):
        """Waits for `check_size`: the size of the network depends on R."""
        self._n_rigid = self.network = None

    def check_size(self, n_rigid: int):
        """Fixes the network's size at the first call; ValueError for another R later on."""
        if self.network is None:
            self._n_rigid = n_rigid
            rows = self._rigid_rows() + self.scene.n_modes
            make = StateMLP if self.config.model == 'mlp' else MotionMixer
            self.network = make(self.config, rows * self.dim + self.force_size)
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
        found = {f.name: f.values(view) for f in features.of(self) if f.name != 'embedding'}
        # [B, V, K D] of velocities -> [B, K, V D], a frame behind the other.
        count = 0 if self.config.reads_path else self.config.velocity_inputs
        velocities = found.pop('velocity', tf.zeros([n_graph, layout.n_node, 0]))
        history = tf.reshape(velocities, [n_graph, layout.n_node, count, self.dim])
        history = tf.transpose(history, [0, 2, 1, 3])
        history = tf.reshape(history, [n_graph, count, layout.n_node * self.dim])
        # The published inputs without a context are the velocities alone.
        others = [tf.zeros([n_graph, 0])]
        for values in found.values():
            flat = tf.reshape(values, [values.shape[0], -1])
            others.append(tf.broadcast_to(flat, [n_graph, flat.shape[1]]))
        decoded = self.network(history, tf.concat(others, axis=-1))
        body, n = self._rigid_rows(), layout.n_rigid
        size = (body + self.scene.n_modes) * self.dim
        rows = tf.reshape(decoded[:, :size], [n_graph, -1, self.dim])
        moved = rows[:, :body]
        if body != n:  # one row for all particles; zeros where the motion is given
            shape = [n_graph, n, self.dim]
            moved = tf.broadcast_to(moved, shape) if body else tf.zeros(shape)
        target = tf.concat([moved, rows[:, body:]], axis=1)
        return target, decoded[:, size:] if self.scene.has_force else None


class StateMLP(snt.Module):
    """`hidden_layers` ReLU layers of `latent_size`, LayerNorm, and a linear output.

    After Holden et al. 2019 (Subspace Neural Physics, SCA): the scores of all modes, their
    velocities and the motion of the body go in, the next displacement of all modes and the force
    come out.
    """

    def __init__(self, config, output_size, name='state_mlp'):
        super().__init__(name=name)
        self._hidden = snt.nets.MLP(
            [config.latent_size] * config.hidden_layers, activate_final=True, name='hidden'
        )
        self._norm = snt.LayerNorm(axis=-1, create_scale=True, create_offset=True)
        self._output = snt.Linear(output_size, name='output')

    def __call__(self, history, state):
        flat = tf.reshape(history, [history.shape[0], -1])
        hidden = self._hidden(tf.concat([flat, state], axis=-1))
        return self._output(self._norm(hidden))


class Excitation(snt.Module):
    """Gates in (0, 1) on a sequence [B, T, C] of T frames of C channels.

    Channels: sigmoid(W2 relu(W1 mean over frames)), one gate per channel (Hu et al. 2018, eq. 2-4).
    Frames: sigmoid(w . x_t), one gate per frame; the two gated sequences are added (Roy et al.
    2018, eq. 3).
    """

    def __init__(self, n_channel, of_frames, name='excitation'):
        super().__init__(name=name)
        self._squeeze = snt.Linear(max(n_channel // REDUCTION, 1), name='squeeze')
        self._excite = snt.Linear(n_channel, name='excite')
        self._frame = snt.Linear(1, name='frame') if of_frames else None

    def __call__(self, x):
        # g_c = sigmoid(W2 relu(W1 mean_t x)); x_tc g_c, and with frames + x_tc sigmoid(w . x_t).
        squeezed = tf.nn.relu(self._squeeze(tf.reduce_mean(x, axis=1, keepdims=True)))
        gated = x * tf.sigmoid(self._excite(squeezed))
        return gated if self._frame is None else gated + x * tf.sigmoid(self._frame(x))


class _Block(snt.Module):
    """One mixing step over space and one over time."""

    def __init__(self, n_frame, n_channel, hidden_layers, of_frames, name):
        super().__init__(name=name)
        self._parts = []
        for size, axis in ((n_channel, 'space'), (n_frame, 'time')):
            self._parts.append(
                (
                    snt.LayerNorm(-1, create_scale=True, create_offset=True, name=f'norm_{axis}'),
                    snt.nets.MLP(
                        [n_channel] * hidden_layers + [size], activation=tf.nn.gelu, name=axis
                    ),
                    Excitation(n_channel, of_frames, name=f'excitation_{axis}'),
                )
            )

    def __call__(self, x):
        (norm, mix, excite), (norm_time, mix_time, excite_time) = self._parts
        # Over channels: x += E(MLP(LN(x))); over frames: the same of the transposed sequence.
        x += excite(mix(norm(x)))
        mixed = tf.transpose(mix_time(tf.transpose(norm_time(x), [0, 2, 1])), [0, 2, 1])
        return x + excite_time(mixed)


class MotionMixer(snt.Module):
    """Embedding of the frames, `message_passing_steps` blocks, and a linear output of all frames.

    After Bouazizi et al. 2022 (MotionMixer, IJCAI), whose poses of joints are here the velocities
    of modes and rigid particles. A block mixes the channels of every frame, then the frames of
    every channel, each with a residual and an `Excitation` (SE or, of frames too, scSE).
    What is known of the coming frame and has no history (positions, motion of the body, context) is
    one more frame. There are `latent_size` channels and `hidden_layers` per mixing.
    """

    def __init__(self, config, output_size, name='motion_mixer'):
        super().__init__(name=name)
        n_frame, size = config.velocity_inputs + 1, config.latent_size
        of_frames = config.model == 'mixer_scse'
        self._size = size
        self._embed_history = snt.Linear(size, name='embed_history')
        self._embed_state = snt.Linear(size, name='embed_state')
        self._blocks = [
            _Block(n_frame, size, config.hidden_layers, of_frames, name=f'block_{m}')
            for m in range(config.message_passing_steps)
        ]
        self._norm = snt.LayerNorm(axis=-1, create_scale=True, create_offset=True)
        self._output = snt.Linear(output_size, name='output')

    def __call__(self, history, state):
        frames = [self._embed_history(history), self._embed_state(state)[:, None]]
        x = tf.concat(frames, axis=1)
        for block in self._blocks:
            x = block(x)
        x = self._norm(x)
        return self._output(tf.reshape(x, [x.shape[0], -1]))
