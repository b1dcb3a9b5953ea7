"""Encoder and decoder (Kipf et al. 2018, 3.1 and 3.3), on all ordered pairs of V nodes as dense
tensors: broadcasts, slices and reshapes only.

Pair (i, j), i receives and j sends, i != j, stands at place i (V - 1) + j - (j > i): Kipf's order.
"""

import numpy as np
import sonnet as snt
import tensorflow as tf


def pair_indices(n_node: int) -> tuple[np.ndarray, np.ndarray]:
    """receivers, senders: int32 [V (V - 1)]."""
    receivers, senders = np.nonzero(~np.eye(n_node, dtype=bool))
    return receivers.astype(np.int32), senders.astype(np.int32)


def pair_sums(of_receiver: tf.Tensor, of_sender: tf.Tensor) -> tf.Tensor:
    """Sum of a receiver's and a sender's values [B, V, C] for each pair: [B, V (V - 1), C]."""
    n_node, width = of_sender.shape[1:]
    dense = of_receiver[:, :, None] + of_sender[:, None]
    flat = tf.reshape(dense, [-1, n_node * n_node, width])
    # Without its first entry the flattened matrix has the diagonal in its last column.
    rows = tf.reshape(flat[:, 1:], [-1, n_node - 1, n_node + 1, width])[:, :, :-1]
    return tf.reshape(rows, [-1, n_node * (n_node - 1), width])


def sum_to_receivers(of_pair: tf.Tensor, n_node: int) -> tf.Tensor:
    """Sum over the senders of each receiver: [B, V (V - 1), C] -> [B, V, C]."""
    return tf.reduce_sum(tf.reshape(of_pair, [-1, n_node, n_node - 1, of_pair.shape[-1]]), axis=2)


def _one_way(n_node):
    """Places of the pairs (i, j) with i < j, and of (j, i): int32 [V (V - 1) / 2] each."""
    place = np.zeros((n_node, n_node), np.int32)
    place[pair_indices(n_node)] = np.arange(n_node * (n_node - 1))
    upper = np.triu_indices(n_node, 1)
    return place[upper], place.T[upper]


def both_ways(of_mutual: tf.Tensor, n_node: int) -> tf.Tensor:
    """Values of pairs i < j for both directions: [B, V (V - 1) / 2, C] -> [B, V (V - 1), C]."""
    places = np.argsort(np.concatenate(_one_way(n_node))) % of_mutual.shape[1]
    return tf.gather(of_mutual, places, axis=1)


def mean_of_both_ways(of_pair: tf.Tensor, n_node: int) -> tf.Tensor:
    """Mean of the two directions of each pair: [B, V (V - 1), C] -> [B, V (V - 1) / 2, C]."""
    there, back = (tf.gather(of_pair, places, axis=1) for places in _one_way(n_node))
    return 0.5 * (there + back)


class _AfterFirst(snt.Module):
    """ELU, Linear, ELU, BatchNorm: what follows the first linear layer.

    The normalisation over the batch takes out what all pairs have in common. Without it (LayerNorm
    instead) the encoder soon gives all pairs the same type for certain and learns nothing more.
    """

    def __init__(self, width, name='after_first'):
        super().__init__(name=name)
        self._second = snt.Linear(width)
        # Batch statistics in training, their running averages otherwise.
        self._norm = snt.BatchNorm(
            create_scale=True, create_offset=True, decay_rate=0.99, name='batch_norm'
        )

    def __call__(self, hidden, is_training):
        return self._norm(tf.nn.elu(self._second(tf.nn.elu(hidden))), is_training)


class _Mlp(snt.Module):
    """Linear, then `_AfterFirst`."""

    def __init__(self, width, name):
        super().__init__(name=name)
        self._first = snt.Linear(width)
        self._rest = _AfterFirst(width)

    def __call__(self, inputs, is_training):
        return self._rest(self._first(inputs), is_training)


class _PairLinear(snt.Module):
    """A linear layer on [receiver, sender] of every pair, [B, V, C] -> [B, V (V - 1), width]: two
    on nodes and their sum, for 2 / (V - 1) of the work."""

    def __init__(self, width, name):
        super().__init__(name=name)
        self._of_receiver = snt.Linear(width, name='of_receiver')
        self._of_sender = snt.Linear(width, with_bias=False, name='of_sender')

    def __call__(self, nodes):
        return pair_sums(self._of_receiver(nodes), self._of_sender(nodes))


class _FactorGraph(snt.Module):
    """Pairs -> nodes -> pairs, with the pairs that came in beside them."""

    def __init__(self, width, name):
        super().__init__(name=name)
        self._middle = _Mlp(width, 'middle')
        self._ends = _PairLinear(width, 'ends')
        self._skip = snt.Linear(width, with_bias=False, name='skip')
        self._last = _AfterFirst(width, 'last')

    def __call__(self, of_pair, n_node, is_training):
        hidden = sum_to_receivers(of_pair, n_node) / (n_node - 1)
        hidden = self._ends(self._middle(hidden, is_training))
        return self._last(hidden + self._skip(of_pair), is_training)


class Encoder(snt.Module):
    """Trajectories -> logits of the K edge types of every pair: an MLP on the whole trajectory of
    each node, then messages between nodes."""

    def __init__(self, width, n_types, name='encoder'):
        super().__init__(name=name)
        self._of_node = _Mlp(width, 'of_node')
        self._ends = _PairLinear(width, 'ends')
        self._of_pair = _AfterFirst(width, 'of_pair')
        self._messages = _FactorGraph(width, 'messages')
        self._logits = snt.Linear(n_types, name='logits')

    def __call__(self, features, is_training):
        """Logits float32 [B, V (V - 1), K] of features [B, V, T, F]."""
        n_node, n_frame, n_feature = features.shape[1:]
        nodes = self._of_node(tf.reshape(features, [-1, n_node, n_frame * n_feature]), is_training)
        of_pair = self._of_pair(self._ends(nodes), is_training)
        return self._logits(self._messages(of_pair, n_node, is_training))


class Decoder(snt.Module):
    """One frame and the edge types -> the next frame: the last one plus an MLP of it and of the
    messages received,
    m_i = sum_j sum_k z_ijk h_k(x_i, x_j), x_i <- x_i + u(x_i, m_i), one network h_k for each of K
    types; with `skip_first` type 0 stands for no edge, so that nothing is exchanged."""

    def __init__(self, n_features, width, n_types, skip_first, name='decoder'):
        super().__init__(name=name)
        self._types = range(1 if skip_first else 0, n_types)
        self._first = [_PairLinear(width, f'first_{k}') for k in self._types]
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
    """Predicts `count` frames [B, V, count, F] from one [B, V, F]; `types` as for `Decoder`."""
    predictions = []
    for _ in range(count):
        frame = decoder(frame, types)
        predictions.append(frame)
    return tf.stack(predictions, axis=2)
