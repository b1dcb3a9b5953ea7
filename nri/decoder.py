"""Decoder: one frame and the edge types -> the next frames (Kipf et al. 2018, 3.3)."""

import sonnet as snt
import tensorflow as tf

from nri.layers import PairLinear, sum_to_receivers


class Decoder(snt.Module):
    """The next frame is the last one plus an MLP of it and of the messages received:
    m_i = sum_j sum_k z_ijk h_k(x_i, x_j), x_i <- x_i + u(x_i, m_i), one network h_k for each type.

    Args:
      n_features: F.
      width: hidden units.
      n_types: K.
      skip_first: whether type 0 stands for no edge, so that nothing is exchanged.
    """

    def __init__(self, n_features, width, n_types, skip_first, name='decoder'):
        super().__init__(name=name)
        self._types = range(1 if skip_first else 0, n_types)
        self._first = [PairLinear(width, name=f'first_{k}') for k in self._types]
        self._second = [snt.Linear(width, name=f'second_{k}') for k in self._types]
        self._update = snt.nets.MLP([width, width, n_features], name='update')

    def __call__(self, frame, types):
        """Next frame [B, V, F] of a frame [B, V, F] and weights of the types [B, V (V - 1), K]."""
        total = 0.0
        for k, first, second in zip(self._types, self._first, self._second, strict=True):
            message = tf.nn.relu(second(tf.nn.relu(first(frame))))
            total += message * types[:, :, k : k + 1]
        received = sum_to_receivers(total, frame.shape[1])
        return frame + self._update(tf.concat([frame, received], axis=-1))


def unroll(decoder, frame, types, count: int):
    """Predicts `count` frames from one.

    Args:
      decoder: `Decoder`.
      frame: [B, V, F].
      types: [B, V (V - 1), K].
      count: frames.

    Returns:
      [B, V, count, F].
    """
    predictions = []
    for _ in range(count):
        frame = decoder(frame, types)
        predictions.append(frame)
    return tf.stack(predictions, axis=2)
