"""Encoder: trajectories -> logits of the edge types of every pair (Kipf et al. 2018, 3.1)."""

import sonnet as snt
import tensorflow as tf

from nri.layers import AfterFirst, Mlp, PairLinear, sum_to_receivers


class _FactorGraph(snt.Module):
    """Pairs -> nodes -> pairs, with the pairs of before beside them."""

    def __init__(self, width, name=None):
        super().__init__(name=name)
        self._middle = Mlp(width, name='middle')
        self._ends = PairLinear(width, name='ends')
        self._skip = snt.Linear(width, with_bias=False, name='skip')
        self._last = AfterFirst(width, name='last')

    def __call__(self, of_pair, n_node, is_training):
        hidden = sum_to_receivers(of_pair, n_node) / (n_node - 1)
        hidden = self._ends(self._middle(hidden, is_training))
        return self._last(hidden + self._skip(of_pair), is_training)


class Encoder(snt.Module):
    """MLP on the whole trajectory of each node, then messages between nodes.

    Args:
      width: hidden units.
      n_types: K.
    """

    def __init__(self, width, n_types, name='encoder'):
        super().__init__(name=name)
        self._of_node = Mlp(width, name='of_node')
        self._ends = PairLinear(width, name='ends')
        self._of_pair = AfterFirst(width, name='of_pair')
        self._messages = _FactorGraph(width, name='messages')
        self._logits = snt.Linear(n_types, name='logits')

    def __call__(self, features, is_training):
        """Logits float32 [B, V (V - 1), K] of features [B, V, T, F]."""
        n_node, n_frame, n_feature = features.shape[1:]
        nodes = self._of_node(tf.reshape(features, [-1, n_node, n_frame * n_feature]), is_training)
        of_pair = self._of_pair(self._ends(nodes), is_training)
        return self._logits(self._messages(of_pair, n_node, is_training))
