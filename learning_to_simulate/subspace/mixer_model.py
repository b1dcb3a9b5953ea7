"""`MotionMixer`: mixes the state over space (modes x axes) and over time, without a graph.

After Bouazizi et al. 2022 (MotionMixer, IJCAI), whose poses of joints are here the velocities of
modes and rigid particles. A block mixes the channels of every frame, then the frames of every
channel, each with a residual and an excitation: of the channels alone (squeeze-and-excitation, Hu
et al. 2018), or of channels and frames at once (scSE, Roy et al. 2018). What is known of the
coming frame and has no history (positions, motion of the body, context) is one more frame.

    python -m learning_to_simulate.train --model=mixer_se --data_path=... --model_path=...
    python -m learning_to_simulate.train --model=mixer_scse --data_path=... --model_path=...
"""

import functools

import sonnet as snt
import tensorflow as tf

from learning_to_simulate.subspace.whole_state import WholeStateSimulator

REDUCTION = 4  # of the channels in the squeeze; Hu et al. take 16 of hundreds of channels


class Excitation(snt.Module):
    """Gates in (0, 1) on a sequence [B, T, C] of T frames of C channels.

    Channels: sigmoid(W2 relu(W1 mean over frames)), one gate per channel (Hu et al. 2018, eq. 2-4).
    Frames: sigmoid(w . x_t), one gate per frame; the two gated sequences are added (Roy et al.
    2018, eq. 3).

    Args:
      n_channel: C.
      of_frames: whether frames are gated as well.
    """

    def __init__(self, n_channel, of_frames, name='excitation'):
        super().__init__(name=name)
        self._squeeze = snt.Linear(max(n_channel // REDUCTION, 1), name='squeeze')
        self._excite = snt.Linear(n_channel, name='excite')
        self._frame = snt.Linear(1, name='frame') if of_frames else None

    def __call__(self, x):
        """Returns the gated sequence [B, T, C]."""
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
        x += excite(mix(norm(x)))
        mixed = tf.transpose(mix_time(tf.transpose(norm_time(x), [0, 2, 1])), [0, 2, 1])
        return x + excite_time(mixed)


class MotionMixer(snt.Module):
    """Embedding of the frames, `message_passing_steps` blocks, and a linear output of all frames.

    Args:
      config: `TrainConfig`; `latent_size` channels, `hidden_layers` per mixing.
      output_size: values of the output.
      of_frames: scSE instead of SE.
    """

    def __init__(self, config, output_size, of_frames, name='motion_mixer'):
        super().__init__(name=name)
        n_frame, size = config.velocity_inputs + 1, config.latent_size
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
        """Maps velocities [B, T, V D] and the rest of the state [B, F] to [B, output_size]."""
        frames = [self._embed_history(history), self._embed_state(state)[:, None]]
        x = tf.concat(frames, axis=1)
        for block in self._blocks:
            x = block(x)
        x = self._norm(x)
        return self._output(tf.reshape(x, [x.shape[0], -1]))

    def zero_decoder(self):
        """Sets the last layer to zero: every output is 0 until it is trained."""
        for variable in self._output.trainable_variables:
            variable.assign(tf.zeros_like(variable))


def simulator_with_se(*arguments):
    """A `WholeStateSimulator` of a mixer with SE; arguments as of `LearnedSimulator`."""
    return WholeStateSimulator(functools.partial(MotionMixer, of_frames=False), *arguments)


def simulator_with_scse(*arguments):
    """A `WholeStateSimulator` of a mixer with scSE; arguments as of `LearnedSimulator`."""
    return WholeStateSimulator(functools.partial(MotionMixer, of_frames=True), *arguments)
