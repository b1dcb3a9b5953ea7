"""The sampled edge types, the negative evidence bound and its parts, how edges are judged.

All is from log-softmax: no epsilon in any logarithm.
"""

import itertools
import math

import numpy as np
import tensorflow as tf

# float32 numbers nearest to 0 and 1 for which both logarithms of a Gumbel draw are finite.
_LOWEST, _HIGHEST = 2.0**-126, 1.0 - 2.0**-24


def gumbel_from_uniform(uniform: tf.Tensor) -> tf.Tensor:
    """-log(-log(u)) with u kept inside the open interval (0, 1); float32."""
    return -tf.math.log(-tf.math.log(tf.clip_by_value(uniform, _LOWEST, _HIGHEST)))


def gumbel_softmax(logits, temperature: float, seed) -> tf.Tensor:
    """A random, differentiable choice of one type (Jang et al. 2017, Maddison et al. 2017): float32
    [..., K], sums to 1, of logits of that shape and a seed, int32 [2]. At a small temperature it is
    nearly one type, at a large one nearly uniform."""
    noise = gumbel_from_uniform(tf.random.stateless_uniform(tf.shape(logits), seed))
    return tf.nn.softmax((logits + noise) / temperature)


def kl_to_prior(logits: tf.Tensor, log_prior_types) -> tf.Tensor:
    """Kullback-Leibler divergence [...] of the edge types (logits [..., K]) from their prior [K],
    per pair. Exact for saturated logits: p log p is 0 where p is 0, because log p stays finite."""
    log_posterior = tf.nn.log_softmax(logits)
    return tf.reduce_sum(tf.exp(log_posterior) * (log_posterior - log_prior_types), axis=-1)


def gaussian_nll(prediction, target, least_variance: float) -> tf.Tensor:
    """Mean negative log likelihood of one value, up to a constant, under the best variance; 0 for a
    perfect prediction.

    The variance is the mean square error of the batch itself, but not below `least_variance`,
    where Kipf et al. keep it. Springs are found as fast either way; but where predictions never
    get that good, as for soil, the prior would count for nothing beside a likelihood whose
    variance is far too small."""
    mean_square = tf.reduce_mean(tf.math.squared_difference(prediction, target))
    variance = tf.maximum(tf.stop_gradient(mean_square), least_variance)
    return 0.5 * (mean_square / variance + tf.math.log(variance / least_variance))


def edge_accuracy(predicted, true, n_types: int) -> tuple[float, tuple[int, ...]]:
    """Share of right edge types, in [1 / K, 1], under the best naming of the types, one for the
    whole data set, and that naming: the true type of each predicted one. Types found without labels
    have no names: type 0 of the model may be type 1 of the data. `predicted` and `true` are integer
    arrays of equal shape, 0 ... K - 1."""
    pairs = np.bincount((predicted * n_types + true).ravel(), minlength=n_types**2)
    counts = pairs.reshape(n_types, n_types)  # [predicted type, true type]
    namings = itertools.permutations(range(n_types))
    best = max(namings, key=lambda naming: counts[range(n_types), naming].sum())
    return float(counts[range(n_types), best].sum() / counts.sum()), best


def edge_usage(probabilities) -> dict:
    """How a posterior [..., K] uses the edge types: `usage`, list of K shares of pairs whose
    likeliest type it is; `entropy`, mean over pairs, as a share of log K; `status`, 'COLLAPSED' if
    a type is used by less than 1 % or more than 99 % of the pairs, else 'OK'."""
    probabilities = np.asarray(probabilities, np.float64)
    n_types = probabilities.shape[-1]
    chosen = probabilities.argmax(axis=-1).reshape(-1)
    usage = np.bincount(chosen, minlength=n_types) / chosen.size
    logs = np.log(np.where(probabilities > 0, probabilities, 1.0))
    entropy = -(probabilities * logs).sum(axis=-1).mean() / math.log(n_types)
    collapsed = usage.min() < 0.01 or usage.max() > 0.99
    return {
        'usage': usage.tolist(),
        'entropy': float(entropy),
        'status': 'COLLAPSED' if collapsed else 'OK',
    }
