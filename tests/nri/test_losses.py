"""Samples, divergence, likelihood, accuracy and usage against closed forms and other libraries."""

import numpy as np
import pytest
import tensorflow as tf
from scipy import stats

from nri import config, losses

SEED = tf.constant([3, 7])


@pytest.mark.parametrize('size', [1e3, 1e30])
def test_saturated_logits_have_an_exact_divergence_a_finite_sample_and_gradients(size):
    logits = tf.Variable([[size, -size], [-size, size]])
    with tf.GradientTape(persistent=True) as tape:
        uniform = losses.kl_to_prior(logits, config.log_prior(2, None))
        sparse = losses.kl_to_prior(logits, config.log_prior(2, 0.9))
        sample = losses.gumbel_softmax(logits, 0.05, SEED)
        square = tf.reduce_sum(sample**2)
    np.testing.assert_allclose(uniform, np.log(2), atol=1e-6)
    np.testing.assert_allclose(sparse, [-np.log(0.9), -np.log(0.1)], rtol=1e-6)
    np.testing.assert_array_equal(sample, [[1, 0], [0, 1]])
    assert all(np.isfinite(tape.gradient(value, logits)).all() for value in (uniform, square))


@pytest.mark.parametrize('prior', [None, 0.05, 0.5, 0.99])
def test_divergence_is_that_of_scipy_and_never_negative(prior):
    logits = np.random.default_rng(0).normal(0, 3, (1000, 3))
    log_prior = config.log_prior(3, prior)
    got = losses.kl_to_prior(tf.constant(logits, tf.float32), log_prior).numpy()
    weights = np.exp(logits) / np.exp(logits).sum(-1, keepdims=True)
    np.testing.assert_allclose(
        got, stats.entropy(weights, np.exp(log_prior.astype(float)), axis=-1), atol=2e-5
    )
    assert got.min() > -1e-6
    at_prior = losses.kl_to_prior(tf.constant(log_prior[None]), log_prior)
    np.testing.assert_allclose(at_prior, 0.0, atol=1e-6)


def test_likelihood_is_that_of_a_gaussian_and_at_the_best_variance_where_errors_are_large():
    rng = np.random.default_rng(1)
    target = rng.normal(size=(4, 5, 3)).astype(np.float32)
    for spread, variance in ((1e-3, 5e-5), (0.3, None)):
        prediction = target + spread * rng.normal(size=target.shape).astype(np.float32)
        got = float(losses.gaussian_nll(tf.constant(prediction), tf.constant(target), 5e-5))
        error = (prediction - target).astype(float)
        variance = variance or (error**2).mean()
        nll = -stats.norm.logpdf(error, scale=np.sqrt(variance)).mean()
        constant = 0.5 * np.log(2 * np.pi * 5e-5)
        assert got == pytest.approx(nll - constant, rel=1e-4)
    assert float(losses.gaussian_nll(tf.constant(target), tf.constant(target), 5e-5)) == 0.0


def test_accuracy_is_that_of_one_naming_of_the_types_for_the_whole_data_set():
    rng = np.random.default_rng(2)
    true = rng.integers(0, 3, (50, 20))
    found = np.where(rng.random(true.shape) < 0.8, true, rng.integers(0, 3, true.shape))
    plain, naming = losses.edge_accuracy(found, true, 3)
    assert plain == (found == true).mean() and naming == (0, 1, 2)
    renamed, naming = losses.edge_accuracy(np.array([2, 0, 1])[found], true, 3)
    assert renamed == plain and naming == (1, 2, 0)
    # Types switched in half of the runs are half wrong, not all right.
    true = rng.integers(0, 2, (100, 20))
    switched = np.concatenate([true[:50], 1 - true[50:]])
    assert losses.edge_accuracy(switched, true, 2)[0] == pytest.approx(0.5, abs=0.05)


def test_a_collapsed_posterior_is_flagged():
    certain = np.zeros((10, 100, 2))
    certain[..., 0] = 1.0
    used = losses.edge_usage(certain)
    assert used == {'usage': [1.0, 0.0], 'entropy': 0.0, 'status': 'COLLAPSED'}
    for count, status in ((9, 'COLLAPSED'), (11, 'OK')):  # of 1000 pairs
        barely = certain.copy()
        barely[0, :count] = [0.0, 1.0]
        assert losses.edge_usage(barely)['status'] == status
    unsure = losses.edge_usage(np.full((4, 5, 2), 0.5))
    assert unsure['entropy'] == pytest.approx(1.0) and unsure['status'] == 'COLLAPSED'


def test_draws_are_finite_and_gumbel_at_both_ends_of_the_interval():
    ends = losses.gumbel_from_uniform(tf.constant([0.0, 2.0**-149, 1.0 - 2.0**-24, 1.0])).numpy()
    assert np.isfinite(ends).all() and (np.diff(ends) >= 0).all()
    # -log(-log(u)) of the largest float32 below 1, in float64.
    assert ends[2] == pytest.approx(-np.log(-np.log1p(-(2.0**-24))), rel=1e-6)


def test_frequencies_are_the_softmax_and_samples_follow_the_seed():
    logits = tf.constant([1.0, 0.0, -1.0])
    many = tf.tile(logits[None], [200_000, 1])
    sample, again, other = (
        losses.gumbel_softmax(many, 0.5, seed).numpy() for seed in (SEED, SEED, SEED + 1)
    )
    # The largest of logits and noise is drawn as the softmax says; standard error 1e-3.
    chosen = np.bincount(sample.argmax(axis=1), minlength=3) / len(many)
    np.testing.assert_allclose(chosen, tf.nn.softmax(logits), atol=0.006)
    np.testing.assert_array_equal(sample, again)
    assert (sample != other).any()
