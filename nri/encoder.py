"""Encoders: trajectories -> logits of the edge types of every pair (Kipf et al. 2018, 3.1)."""

import sonnet as snt
import tensorflow as tf

from nri import pairs
from nri.layers import AfterFirst, Mlp, PairLinear, batch_norm


class _FactorGraph(snt.Module):
    """Pairs -> nodes -> pairs, with the pairs of before beside them; or an MLP on pairs alone."""

    def __init__(self, width, factor_graph, name=None):
        super().__init__(name=name)
        self._factor_graph = factor_graph
        self._middle = Mlp(width, name='middle')
        if factor_graph:
            self._ends = PairLinear(width, name='ends')
        else:
            self._ends = snt.Linear(width, name='ends')
        self._skip = snt.Linear(width, with_bias=False, name='skip')
        self._last = AfterFirst(width, name='last')

    def __call__(self, of_pair, n_node, is_training):
        hidden = of_pair
        if self._factor_graph:
            hidden = pairs.sum_to_receivers(of_pair, n_node) / (n_node - 1)
        hidden = self._ends(self._middle(hidden, is_training))
        return self._last(hidden + self._skip(of_pair), is_training)


class MlpEncoder(snt.Module):
    """MLP on the whole trajectory of each node, then messages between nodes.

    Args:
      width: hidden units.
      n_types: K.
      factor_graph: whether pairs exchange messages through their nodes.
    """

    def __init__(self, width, n_types, factor_graph=True, name='encoder'):
        super().__init__(name=name)
        self._of_node = Mlp(width, name='of_node')
        self._ends = PairLinear(width, name='ends')
        self._of_pair = AfterFirst(width, name='of_pair')
        self._messages = _FactorGraph(width, factor_graph, name='messages')
        self._logits = snt.Linear(n_types, name='logits')

    def __call__(self, features, is_training):
        """Logits float32 [B, V (V - 1), K] of features [B, V, T, F]."""
        n_node, n_frame, n_feature = features.shape[1:]
        nodes = self._of_node(tf.reshape(features, [-1, n_node, n_frame * n_feature]), is_training)
        of_pair = self._of_pair(self._ends(nodes), is_training)
        return self._logits(self._messages(of_pair, n_node, is_training))


class CnnEncoder(snt.Module):
    """Convolutions along the time of each pair, pooled with attention, then messages.

    Takes trajectories of any length from 14 frames (two kernels of 5 and a pooling of 2 between).

    Args:
      width, n_types, factor_graph: as for `MlpEncoder`.
    """

    def __init__(self, width, n_types, factor_graph=True, name='encoder'):
        super().__init__(name=name)
        self._width = width
        self._receiver = snt.Conv1D(width, 5, padding='VALID', name='receiver')
        self._sender = snt.Conv1D(width, 5, padding='VALID', with_bias=False, name='sender')
        self._norm = batch_norm('first_norm')
        self._second = snt.Conv1D(width, 5, padding='VALID', name='second')
        self._second_norm = batch_norm('second_norm')
        self._value = snt.Linear(width, name='value')
        self._attention = snt.Linear(1, name='attention')
        self._of_pair = Mlp(width, name='of_pair')
        self._messages = _FactorGraph(width, factor_graph, name='messages')
        self._logits = snt.Linear(n_types, name='logits')

    def __call__(self, features, is_training):
        """Logits float32 [B, V (V - 1), K] of features [B, V, T, F]."""
        n_node, n_frame, n_feature = features.shape[1:]
        series = tf.reshape(features, [-1, n_frame, n_feature])

        def of_nodes(convolution):
            return tf.reshape(convolution(series), [-1, n_node, (n_frame - 4) * self._width])

        hidden = pairs.pair_sums(of_nodes(self._receiver), of_nodes(self._sender))
        n_pair = hidden.shape[1]
        hidden = tf.reshape(hidden, [-1, n_frame - 4, self._width])
        hidden = self._norm(tf.nn.relu(hidden), is_training)
        hidden = tf.nn.max_pool1d(hidden, 2, 2, 'VALID')
        hidden = self._second_norm(tf.nn.relu(self._second(hidden)), is_training)
        weight = tf.nn.softmax(self._attention(hidden), axis=1)
        hidden = tf.reduce_sum(weight * self._value(hidden), axis=1)
        of_pair = self._of_pair(tf.reshape(hidden, [-1, n_pair, self._width]), is_training)
        return self._logits(self._messages(of_pair, n_node, is_training))


ENCODERS = {'mlp': MlpEncoder, 'cnn': CnnEncoder}
