"""The two-layer network that the encoders are made of, and linear layers on pairs of nodes."""

import sonnet as snt
import tensorflow as tf

from nri import pairs


def batch_norm(name='batch_norm'):
    """Batch statistics in training, their running averages otherwise."""
    return snt.BatchNorm(create_scale=True, create_offset=True, decay_rate=0.99, name=name)


class AfterFirst(snt.Module):
    """ELU, Linear, ELU, BatchNorm: what follows the first linear layer.

    The normalisation over the batch takes out what all pairs have in common. Without it (LayerNorm
    instead) the encoder soon gives all pairs the same type for certain and learns nothing more.
    """

    def __init__(self, width, name=None):
        super().__init__(name=name)
        self._second = snt.Linear(width)
        self._norm = batch_norm()

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
    """A linear layer on [receiver, sender] of every pair, applied node by node."""

    def __init__(self, width, name=None):
        super().__init__(name=name)
        self._of_receiver = snt.Linear(width, name='of_receiver')
        self._of_sender = snt.Linear(width, with_bias=False, name='of_sender')

    def __call__(self, nodes):
        """[B, V, C] -> [B, V (V - 1), width]."""
        return pairs.pair_sums(self._of_receiver(nodes), self._of_sender(nodes))
