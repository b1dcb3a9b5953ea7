"""Few objects that act on each other along lines between them: their edges without an encoder.

An object moves by itself and by the sum of what others do to it (letters as in nri/README.md):

    x_i(t+1) = x_i(t) + u(x_i(t)) + sum_(j != i) f_(z_ij)(x_i(t), x_j(t)) + e              (5)
    f_k = [a d + b w, c d + g w],     (a, b, c, g) = h_k(|D|, |W|, d . w)

D and W are place and velocity of j from i, d = D / |D|, w = W / |W|. With an f of all coordinates a
type may stand for attraction in one direction or place and for repulsion in another; training then
ends there. The error e has a Student distribution, as two objects that meet cannot be predicted. So
the types of all edges to one receiver have a posterior that is a table of K^(V - 1) values:

    log q(z_ij for all j) = sum_t log p(x_i(t+1) | x(t), z_ij for all j) + log p(z) + const   (6)

Where both directions of a pair share a type, receivers tell each other what they know of it: some
rounds of belief propagation (Pearl 1988, Probabilistic Reasoning in Intelligent Systems), which is
not exact in graphs with loops. Training is a generalised expectation maximisation: (6) by the
networks of this step, then a step up the expected log likelihood. Memory grows as runs in a batch
x frames x V x K^(V - 1).
"""

import math

import numpy as np
import sonnet as snt
import tensorflow as tf

from nri import networks

MAX_SETS = 1024  # K^(V - 1)
FREEDOM = 3.0  # degrees, of the Student distribution
SOFT = 1e-4  # added to squares of lengths, in normalised units
ROUNDS, DAMPING, LEAST_MESSAGE = 5, 0.5, -20.0  # of belief propagation, whose messages are logs
# The scale of e is exp(FASTER s): s moves by the learning rate in a step. It begins far above the
# errors, so that the posterior is undecided at first. What does not move at all has the least one.
FASTER, LEAST_SCALE = 10.0, 1e-6


def _from_zero(widths, name):
    """An MLP whose values are 0 before training: types that differ at random would be chosen at
    once."""
    hidden = snt.nets.MLP(widths[:-1], activate_final=True, name=name)
    return snt.Sequential([hidden, snt.Linear(widths[-1], w_init=tf.zeros, name=f'{name}_last')])


class Central(snt.Module):
    """Networks of (5), and the posterior (6) of V objects with F features: D coordinates of their
    place, then D of their velocity, normalised. `config` is an `NriConfig`, `log_prior` the log
    probabilities [K] of types. ValueError: more than `MAX_SETS` sets of types of one receiver's
    edges."""

    def __init__(self, n_node, n_features, config, log_prior, name='central'):
        super().__init__(name=name)
        n_types, width = config.edge_types, config.hidden
        self.n_sets = n_types ** (n_node - 1)
        if self.n_sets > MAX_SETS:
            raise ValueError(
                f'{n_node} objects and {n_types} types of edges: {self.n_sets} sets of edges of '
                f'one object, central takes up to {MAX_SETS}'
            )
        sets = np.arange(self.n_sets)[:, None] // n_types ** np.arange(n_node - 1) % n_types
        self._chosen = np.eye(n_types, dtype=np.float32)[sets]  # [C, V - 1, K]
        # An edge that two receivers share stands in the table of both.
        self._log_prior = (self._chosen @ log_prior).sum(axis=1) / (1 + config.symmetric)
        receivers, senders = networks.pair_indices(n_node)
        self._swapped = np.lexsort((receivers, senders))  # place of (j, i) for (i, j)
        self._symmetric, self._first = config.symmetric, int(config.skip_first)
        self._factors = [
            _from_zero([width, width, 4], f'factors_{k}') for k in range(self._first, n_types)
        ]
        self._alone = _from_zero([width, width, n_features], 'alone')
        self._scale = tf.Variable(tf.zeros([n_features]), name='scale')

    def log_likelihoods(self, frames, after) -> tf.Tensor:
        """First terms of (6), [B, n, V, C], of frames [B, n, V, F] and those that follow them."""
        n_node, n_features = frames.shape[2:]
        flat = tf.reshape(frames, [-1, n_node, n_features])
        change = tf.reshape(after, [-1, n_node, n_features]) - flat - self._alone(flat)
        acts = [tf.reshape(act, [-1, n_node, n_node - 1, n_features]) for act in self._acts(flat)]
        errors = change[:, :, None]
        for j in range(n_node - 1):  # later senders are higher digits of a set's number
            errors = tf.concat(
                [errors] * self._first + [errors - act[:, :, j, None] for act in acts], axis=2
            )
        log_scale = tf.maximum(FASTER * self._scale, math.log(LEAST_SCALE))
        square = tf.reduce_sum((errors * tf.exp(-log_scale)) ** 2, axis=-1)
        heavy = 0.5 * (FREEDOM + n_features) * tf.math.log1p(square / FREEDOM)
        found = -heavy - tf.reduce_sum(log_scale)
        return tf.reshape(found, [-1, frames.shape[1], n_node, self.n_sets])

    def _acts(self, frames):
        """f_k of all pairs, [B, V (V - 1), F] for each k that acts."""
        dim = frames.shape[2] // 2
        apart = networks.pair_sums(-frames, frames)
        parts = apart[..., :dim], apart[..., dim:]
        sizes = [tf.sqrt(tf.reduce_sum(x**2, axis=-1, keepdims=True) + SOFT) for x in parts]
        d, w = (x / size for x, size in zip(parts, sizes, strict=True))
        angle = tf.reduce_sum(d * w, axis=-1, keepdims=True)
        seen = tf.concat([*sizes, *map(tf.math.log, sizes), angle], axis=-1)
        for h in self._factors:
            a, b, c, g = tf.split(h(seen), 4, axis=-1)
            yield tf.concat([a * d + b * w, c * d + g * w], axis=-1)

    def posterior(self, log_likelihoods) -> tuple[tf.Tensor, tf.Tensor]:
        """Of sums over frames [B, V, C]: log q of (6), [B, V, C], and logits of each edge
        [B, V (V - 1), K]."""
        table = log_likelihoods + self._log_prior
        n_node, n_types = table.shape[1], self._chosen.shape[2]
        messages = tf.zeros([tf.shape(table)[0], n_node, n_node - 1, n_types])
        for _ in range(ROUNDS if self._symmetric else 0):
            back = self._back(self._edges(self._sets(table, messages)) - messages)
            heard = tf.maximum(tf.nn.log_softmax(back), LEAST_MESSAGE)
            messages = (1.0 - DAMPING) * messages + DAMPING * heard
        sets = self._sets(table, messages)
        edges = self._edges(sets) - messages
        if self._symmetric:
            edges += self._back(edges)
        return tf.nn.log_softmax(sets), tf.reshape(edges, [-1, n_node * (n_node - 1), n_types])

    def _sets(self, table, messages):
        """Log weights of the sets [B, V, C]: of their table and of messages about their edges,
        [B, V, V - 1, K]."""
        return table + tf.einsum('bvjk,cjk->bvc', messages, self._chosen)

    def _edges(self, sets):
        """Log weights of each type of each edge, [B, V, V - 1, K], of those of the sets."""
        shut = tf.constant(np.where(self._chosen, 0.0, -np.inf).astype(np.float32))
        return tf.reduce_logsumexp(sets[..., None, None] + shut, axis=2)

    def _back(self, edges):
        """Values of (j, i) at (i, j): [B, V, V - 1, K]."""
        n_node, n_types = edges.shape[1], edges.shape[3]
        pairs = tf.reshape(edges, [-1, n_node * (n_node - 1), n_types])
        return tf.reshape(tf.gather(pairs, self._swapped, axis=1), tf.shape(edges))

    def losses(self, frames, after) -> tuple[tf.Tensor, tf.Tensor]:
        """Negative expected log likelihood, per object and frame, and the divergence of q from the
        prior, per object, of [B, n, V, F]; q has no gradient. With `symmetric` each end counts what
        it knows of an edge."""
        each = self.log_likelihoods(frames, after)
        total = tf.reduce_sum(each, axis=1)
        log_q, _ = self.posterior(tf.stop_gradient(total))
        q = tf.exp(log_q)
        likelihood = tf.reduce_mean(tf.reduce_sum(q * total, axis=-1)) / each.shape[1]
        kl = tf.reduce_sum(q * (log_q - self._log_prior), axis=-1)
        return -likelihood, tf.reduce_mean(kl)
