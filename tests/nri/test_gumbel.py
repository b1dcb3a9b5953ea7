"""Samples of edge types at the ends of every range."""

import numpy as np
import pytest
import tensorflow as tf

from nri import config, gumbel

SEED = tf.constant([3, 7])


@pytest.mark.parametrize('temperature', [0.0, -1.0, 0.049, float('nan'), float('inf')])
def test_temperatures_below_the_floor_are_refused(temperature):
    with pytest.raises(ValueError, match='temperature'):
        gumbel.gumbel_softmax(tf.zeros([1, 2]), temperature, SEED)


def test_gradient_survives_at_the_lowest_temperature():
    logits = tf.Variable(tf.random.stateless_normal([500, 2], [1, 2]))
    for straight_through in (False, True):
        with tf.GradientTape() as tape:
            sample = gumbel.gumbel_softmax(
                logits, config.MIN_TEMPERATURE, SEED, straight_through=straight_through
            )
            loss = tf.reduce_sum(sample[:, 0])
        gradient = tape.gradient(loss, logits).numpy()
        assert np.isfinite(sample).all() and np.isfinite(gradient).all()
        # Measured 0.22 of all samples.
        assert (np.abs(gradient).max(axis=1) > 1e-3).mean() > 0.02


def test_ten_million_draws_are_finite_and_gumbel():
    draws = gumbel.gumbel_from_uniform(tf.random.stateless_uniform([10_000_000], SEED)).numpy()
    assert np.count_nonzero(~np.isfinite(draws)) == 0
    # Mean 0.57722 and variance pi²/6; standard errors 4e-4 and 1.4e-3.
    assert abs(draws.mean() - np.euler_gamma) < 0.003
    assert abs(draws.var() - np.pi**2 / 6) < 0.01


def test_both_ends_of_the_interval_are_finite():
    ends = tf.constant([0.0, 2.0**-149, 1.0 - 2.0**-24, 1.0])
    draws = gumbel.gumbel_from_uniform(ends).numpy()
    assert np.isfinite(draws).all() and (np.diff(draws) >= 0).all()
    # -log(-log(u)) of the largest float32 below 1, in float64.
    assert draws[2] == pytest.approx(-np.log(-np.log1p(-(2.0**-24))), rel=1e-6)


def test_hot_samples_are_uniform():
    logits = tf.constant([[3.0, -2.0, 0.0]] * 100)
    sample = gumbel.gumbel_softmax(logits, 1e8, SEED).numpy().astype(np.float64)
    entropy = -(sample * np.log(sample)).sum(-1)
    np.testing.assert_allclose(entropy, np.log(3), atol=1e-6)


def test_frequencies_are_the_softmax_and_samples_follow_the_seed():
    logits = tf.constant([1.0, 0.0, -1.0])
    many = tf.tile(logits[None], [200_000, 1])
    hard = gumbel.gumbel_softmax(many, 0.5, SEED, straight_through=True).numpy()
    assert np.abs(hard.max(axis=1) - 1).max() < 1e-6
    # Standard error 1.1e-3.
    np.testing.assert_allclose(hard.mean(0), tf.nn.softmax(logits), atol=0.006)
    again = gumbel.gumbel_softmax(many, 0.5, SEED, straight_through=True).numpy()
    other = gumbel.gumbel_softmax(many, 0.5, SEED + 1, straight_through=True).numpy()
    np.testing.assert_array_equal(hard, again)
    assert (hard != other).any()


@pytest.mark.parametrize('size', [1e3, 1e30])
def test_saturated_logits_give_a_finite_sample_and_gradient(size):
    logits = tf.Variable([[size, -size], [-size, size]])
    with tf.GradientTape() as tape:
        sample = gumbel.gumbel_softmax(logits, 0.05, SEED)
        loss = tf.reduce_sum(sample**2)
    np.testing.assert_array_equal(sample, [[1, 0], [0, 1]])
    assert np.isfinite(tape.gradient(loss, logits)).all()
