"""Decoders: one frame and the edge types -> the next frames (Kipf et al. 2018, 3.3).

One message network per edge type; with `skip_first` pairs of type 0 exchange nothing.
"""

import sonnet as snt
import tensorflow as tf

from nri import pairs
from nri.layers import PairLinear


class _Messages(snt.Module):
    """Sum of the messages to each node, weighted by the types of the pairs."""

    def __init__(self, width, n_types, skip_first, activation, name='messages'):
        super().__init__(name=name)
        self._activation = activation
        self._types = range(1 if skip_first else 0, n_types)
        self._first = [PairLinear(width, name=f'first_{k}') for k in self._types]
        self._second = [snt.Linear(width, name=f'second_{k}') for k in self._types]

    def __call__(self, nodes, types):
        """[B, V, C], [B, V (V - 1), K] -> [B, V, width]."""
        total = 0.0
        for k, first, second in zip(self._types, self._first, self._second, strict=True):
            message = self._activation(second(self._activation(first(nodes))))
            total += message * types[:, :, k : k + 1]
        return pairs.sum_to_receivers(total, nodes.shape[1])


class MlpDecoder(snt.Module):
    """The next frame is the last one plus an MLP of it and of the messages received.

    Args:
      n_features: F.
      width: hidden units.
      n_types: K.
      skip_first: whether type 0 stands for no edge.
    """

    def __init__(self, n_features, width, n_types, skip_first, name='decoder'):
        super().__init__(name=name)
        self._messages = _Messages(width, n_types, skip_first, tf.nn.relu)
        self._update = snt.nets.MLP([width, width, n_features], name='update')

    def initial_memory(self, frame):
        """Nothing is remembered."""
        return ()

    def __call__(self, frame, types, memory):
        """One step.

        Args:
          frame: [B, V, F].
          types: [B, V (V - 1), K] weights of the edge types.
          memory: of `initial_memory` or the step before.

        Returns:
          next frame [B, V, F], memory.
        """
        received = self._messages(frame, types)
        return frame + self._update(tf.concat([frame, received], axis=-1)), memory


class RnnDecoder(snt.Module):
    """As `MlpDecoder`, with a gated recurrent unit per node whose memory the messages carry.

    Args:
      n_features, width, n_types, skip_first: as for `MlpDecoder`.
    """

    def __init__(self, n_features, width, n_types, skip_first, name='decoder'):
        super().__init__(name=name)
        self._width = width
        self._messages = _Messages(width, n_types, skip_first, tf.nn.tanh)
        self._of_frame = snt.Linear(3 * width, name='of_frame')
        self._of_received = snt.Linear(3 * width, with_bias=False, name='of_received')
        self._update = snt.nets.MLP([width, width, n_features], name='update')

    def initial_memory(self, frame):
        """Zeros [B, V, width]."""
        return tf.zeros([*frame.shape[:2], self._width])

    def __call__(self, frame, types, memory):
        """One step; arguments and results as for `MlpDecoder`."""
        received = self._messages(memory, types) / (frame.shape[1] - 1)
        reset, keep, new = tf.split(self._of_frame(frame), 3, axis=-1)
        reset_r, keep_r, new_r = tf.split(self._of_received(received), 3, axis=-1)
        reset = tf.sigmoid(reset + reset_r)
        keep = tf.sigmoid(keep + keep_r)
        new = tf.tanh(new + reset * new_r)
        memory = (1.0 - keep) * new + keep * memory
        return frame + self._update(memory), memory


DECODERS = {'mlp': MlpDecoder, 'rnn': RnnDecoder}


def unroll(decoder, frames, types, burn_in: int = 1):
    """Predicts all frames after the first from the first `burn_in` ones.

    Args:
      decoder: `MlpDecoder` or `RnnDecoder`.
      frames: [B, V, T, F] true frames.
      types: [B, V (V - 1), K].
      burn_in: true frames that are fed in; after them the decoder is fed its own predictions.

    Returns:
      [B, V, T - 1, F] predictions of frames 1 ... T - 1.
    """
    frame = frames[:, :, 0]
    memory = decoder.initial_memory(frame)
    predictions = []
    for t in range(frames.shape[2] - 1):
        if 0 < t < burn_in:
            frame = frames[:, :, t]
        frame, memory = decoder(frame, types, memory)
        predictions.append(frame)
    return tf.stack(predictions, axis=2)
