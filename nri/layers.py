"""All ordered pairs of V nodes as dense tensors, and the layers on nodes and pairs.

Pair (i, j), i receives and j sends, i != j, stands at place i (V - 1) + j - (j > i): Kipf's order.
Only broadcasts, slices and reshapes are needed.
"""

import numpy as np
import sonnet as snt
import tensorflow as tf


def pair_indices(n_node: int) -> tuple[np.ndarray, np.ndarray]:
    """receivers, senders: int32 [V (V - 1)]."""
    receivers, senders = np.nonzero(~np.eye(n_node, dtype=bool))
    return receivers.astype(np.int32), senders.astype(np.int32)


def pair_sums(of_receiver: tf.Tensor, of_sender: tf.Tensor) -> tf.Tensor:
    """Sum of a receiver's and a sender's values for each pair.

    Args:
      of_receiver, of_sender: [B, V, C].

    Returns:
      [B, V (V - 1), C].
    """
    n_node, width = of_sender.shape[1:]
    dense = of_receiver[:, :, None] + of_sender[:, None]
    flat = tf.reshape(dense, [-1, n_node * n_node, width])
    # Without its first entry the flattened matrix has the diagonal in its last column.
    rows = tf.reshape(flat[:, 1:], [-1, n_node - 1, n_node + 1, width])[:, :, :-1]
    return tf.reshape(rows, [-1, n_node * (n_node - 1), width])


def sum_to_receivers(of_pair: tf.Tensor, n_node: int) -> tf.Tensor:
    """Sum over the senders of each receiver: [B, V (V - 1), C] -> [B, V, C]."""
    return tf.reduce_sum(tf.reshape(of_pair, [-1, n_node, n_node - 1, of_pair.shape[-1]]), axis=2)


def one_way(n_node: int) -> tuple[np.ndarray, np.ndarray]:
    """Places of the pairs (i, j) with i < j, and of (j, i): int32 [V (V - 1) / 2] each."""
    receivers, senders = pair_indices(n_node)
    place = np.zeros((n_node, n_node), np.int32)
    place[receivers, senders] = np.arange(len(receivers))
    upper = np.triu_indices(n_node, 1)
    return place[upper], place.T[upper]


def both_ways(of_mutual: tf.Tensor, n_node: int) -> tf.Tensor:
    """Values of pairs i < j for both directions: [B, V (V - 1) / 2, C] -> [B, V (V - 1), C]."""
    source = np.zeros(n_node * (n_node - 1), np.int32)
    for places in one_way(n_node):
        source[places] = np.arange(len(places))
    return tf.gather(of_mutual, source, axis=1)


def mean_of_both_ways(of_pair: tf.Tensor, n_node: int) -> tf.Tensor:
    """Mean of the two directions of each pair: [B, V (V - 1), C] -> [B, V (V - 1) / 2, C]."""
    there, back = one_way(n_node)
    return 0.5 * (tf.gather(of_pair, there, axis=1) + tf.gather(of_pair, back, axis=1))


class AfterFirst(snt.Module):
    """ELU, Linear, ELU, BatchNorm: what follows the first linear layer.

    The normalisation over the batch takes out what all pairs have in common. Without it (LayerNorm
    instead) the encoder soon gives all pairs the same type for certain and learns nothing more.
    """

    def __init__(self, width, name=None):
        super().__init__(name=name)
        self._second = snt.Linear(width)
        # Batch statistics in training, their running averages otherwise.
        self._norm = snt.BatchNorm(
            create_scale=True, create_offset=True, decay_rate=0.99, name='batch_norm'
        )

    def __call__(self, hidden, is_training):
        """[..., width] -> [..., width]."""
        return self._norm(tf.nn.elu(self._second(tf.nn.elu(hidden))), is_training)


class Mlp(snt.Module):
    """Linear, then `AfterFirst`."""

    def __init__(self, width, name=None):
        super().__init__(name=name)
        self._first = snt.Linear(width)
        self._rest = AfterFirst(width)

    def __call__(self, inputs, is_training):
        """[..., C] -> [..., width]."""
        return self._rest(self._first(inputs), is_training)


class PairLinear(snt.Module):
    """A linear layer on [receiver, sender] of every pair: two on nodes and their sum, for
    2 / (V - 1) of the work."""

    def __init__(self, width, name=None):
        super().__init__(name=name)
        self._of_receiver = snt.Linear(width, name='of_receiver')
        self._of_sender = snt.Linear(width, with_bias=False, name='of_sender')

    def __call__(self, nodes):
        """[B, V, C] -> [B, V (V - 1), width]."""
        return pair_sums(self._of_receiver(nodes), self._of_sender(nodes))
