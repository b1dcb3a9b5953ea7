"""The two-layer network that the encoders are made of, and linear layers on pairs of nodes."""

import sonnet as snt
import tensorflow as tf

from nri import pairs


class AfterFirst(snt.Module):
    """ELU, Linear, ELU, LayerNorm: what follows the first linear layer.

    Kipf et al. normalise over the batch, which makes what is found for one run depend on the
    others; LayerNorm does not.
    """

    def __init__(self, width, name=None):
        super().__init__(name=name)
        self._second = snt.Linear(width)
        self._norm = snt.LayerNorm(axis=-1, create_scale=True, create_offset=True)

    def __call__(self, hidden):
        """[..., width] -> [..., width]."""
        return self._norm(tf.nn.elu(self._second(tf.nn.elu(hidden))))


class Mlp(snt.Module):
    """Linear, then `AfterFirst`."""

    def __init__(self, width, name=None):
        super().__init__(name=name)
        self._first = snt.Linear(width)
        self._rest = AfterFirst(width)

    def __call__(self, inputs):
        """[..., C] -> [..., width]."""
        return self._rest(self._first(inputs))


class PairLinear(snt.Module):
    """A linear layer on [receiver, sender] of every pair, applied node by node."""

    def __init__(self, width, name=None):
        super().__init__(name=name)
        self._of_receiver = snt.Linear(width, name='of_receiver')
        self._of_sender = snt.Linear(width, with_bias=False, name='of_sender')

    def __call__(self, nodes):
        """[B, V, C] -> [B, V (V - 1), width]."""
        return pairs.pair_sums(self._of_receiver(nodes), self._of_sender(nodes))
