"""`EdgeGates`: mode -> mode edges learned together with the simulator.

One hard-concrete gate (Louizos, Welling & Kingma, ICLR 2018, "Learning sparse neural networks
through L0 regularization") per pair of modes multiplies the messages of its edge. A gate is exactly
0 or exactly 1 with a probability that has a gradient, so the expected number of open gates can be
a term of the loss. After `gate_steps` the gates are replaced by a fixed edge list and cost nothing.
"""

import copy
import dataclasses
import hashlib
import json
import math

import numpy as np
import tensorflow as tf

from learning_to_simulate.subspace import edge_lists
from learning_to_simulate.subspace.edge_lists import EdgeList

# Louizos et al. 2018, section 4: temperature, and the ends of the stretched interval.
TEMPERATURE, LOW, HIGH = 2 / 3, -0.1, 1.1
# Gates start open (97 %), so that training starts on the full graph.
INITIAL_LOG_ALPHA = 2.0
# Gates have a hundred values against the network's 1e5, and their own, constant rate: they must
# cross from 2 to -3 within some hundred steps.
LEARNING_RATE = 0.02
# An edge stays if its gate is more likely open than shut.
OPEN_THRESHOLD = 0.5


class EdgeGates(tf.Module):
    """Gates of the r² edges between modes, self-edges included."""

    def __init__(self, n_modes: int):
        super().__init__(name='edge_gates')
        self.n_modes = n_modes
        self.log_alpha = tf.Variable(
            tf.fill([n_modes, n_modes], INITIAL_LOG_ALPHA), name='log_alpha'
        )
        self.optimizer = tf.keras.optimizers.Adam(LEARNING_RATE)
        self.optimizer.build([self.log_alpha])

    def sample(self, n_graph: int, seed):
        """Gates of B graphs, float32 [B, r, r] in [0, 1], entry [receiver, sender] (their eq. 10
        and 11); every graph draws its own, and the same seed, int32 [2], gives the same gates."""
        uniform = tf.random.stateless_uniform([n_graph, self.n_modes, self.n_modes], seed)
        # The draw includes 0, whose logarithm does not exist; 2^-24 is below all others.
        uniform = tf.maximum(uniform, 2.0**-24)
        # s = sigmoid((logit(u) + log alpha) / beta), z = clip(s (HIGH - LOW) + LOW, 0, 1).
        logit = tf.math.log(uniform) - tf.math.log1p(-uniform) + self.log_alpha
        return tf.clip_by_value(tf.sigmoid(logit / TEMPERATURE) * (HIGH - LOW) + LOW, 0.0, 1.0)

    def open_probability(self):
        """P(gate > 0), float32 [r, r] (their eq. 12)."""
        return tf.sigmoid(self.log_alpha - TEMPERATURE * math.log(-LOW / HIGH))

    def with_price(self, values, config, step):
        """The losses {name: scalar} of a step with the price of the open gates in the `loss`, and
        the expected share of `open_gates`.

        The price rises linearly from 0 to `gate_weight`, so that the network learns what its edges
        are good for before they have to go.
        """
        # Price lambda t / t_end times the mean of P(z > 0).
        share = tf.reduce_mean(self.open_probability())
        price = config.gate_weight * tf.cast(step, tf.float32) / config.gate_steps
        return values | {'loss': values['loss'] + price * share, 'open_gates': share}

    def edge_list(self, config, data_path: str) -> EdgeList:
        """The edges that are more likely open than not; `config` is that of the simulator."""
        probabilities = self.open_probability().numpy().astype(np.float64)
        mask = edge_lists.select(probabilities, threshold=OPEN_THRESHOLD)
        settings = json.dumps(dataclasses.asdict(config), sort_keys=True)
        return EdgeList(
            mask=mask,
            node_names=edge_lists.mode_names(self.n_modes),
            probabilities=probabilities,
            method='gates',
            threshold=OPEN_THRESHOLD,
            digests={'model': hashlib.sha256(settings.encode()).hexdigest()}
            | edge_lists.data_digests(data_path),
            # Training has no one to ask: it says so and goes on.
            degenerate=edge_lists.degeneracy(mask),
            report={'expected_open_gates': float(probabilities.sum()), 'seed': config.seed},
        )

    def gated(self, layout, n_graph: int, seed):
        """A copy of a `Layout`, whose mode block is fully connected, with a drawn gate on every
        mode -> mode edge: its `edge_gates` is float32 [B, E]; other edges have gates of 1."""
        drawn = tf.reshape(self.sample(n_graph, seed), [n_graph, self.n_modes**2])
        with_one = tf.concat([drawn, tf.ones([n_graph, 1])], axis=1)
        receiver, sender = (layout.node_class[e] - 1 for e in (layout.receivers, layout.senders))
        between_modes = (receiver >= 0) & (sender >= 0)
        index = np.where(between_modes, receiver * self.n_modes + sender, self.n_modes**2)
        gated = copy.copy(layout)
        gated.edge_gates = tf.gather(with_one, index, axis=1)
        return gated
