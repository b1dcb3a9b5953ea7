"""Gumbel-softmax samples of edge types (Jang et al. 2017, Maddison et al. 2017)."""

import tensorflow as tf

from nri.config import check_temperature

# float32 numbers nearest to 0 and 1 for which both logarithms of a Gumbel draw are finite.
_LOWEST, _HIGHEST = 2.0**-126, 1.0 - 2.0**-24


def gumbel_from_uniform(uniform: tf.Tensor) -> tf.Tensor:
    """-log(-log(u)) with u kept inside the open interval (0, 1); float32."""
    return -tf.math.log(-tf.math.log(tf.clip_by_value(uniform, _LOWEST, _HIGHEST)))


def gumbel_softmax(logits, temperature: float, seed, straight_through: bool = False) -> tf.Tensor:
    """A random, differentiable choice of one type.

    Args:
      logits: float32 [..., K].
      temperature: small is nearly one type, large is nearly uniform.
      seed: int32 [2]; the draw is a function of it.
      straight_through: return the chosen type as exactly 0 and 1, with the gradient of the soft
        sample.

    Returns:
      float32 [..., K], sums to 1.

    Raises:
      ValueError: see `config.check_temperature`.
    """
    check_temperature(temperature)
    noise = gumbel_from_uniform(tf.random.stateless_uniform(tf.shape(logits), seed))
    soft = tf.nn.softmax((logits + noise) / temperature)
    if not straight_through:
        return soft
    hard = tf.one_hot(tf.argmax(soft, axis=-1), logits.shape[-1], dtype=soft.dtype)
    return hard + soft - tf.stop_gradient(soft)
