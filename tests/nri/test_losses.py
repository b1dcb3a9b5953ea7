"""Divergence, likelihood, accuracy and usage against closed forms and other libraries."""

import numpy as np
import pytest
import tensorflow as tf
from scipy import stats

from nri import config, losses


def test_divergence_of_saturated_logits_is_exact():
    for size in (1e3, 1e30):
        logits = tf.constant([[size, -size], [-size, size]])
        uniform = losses.kl_to_prior(logits, config.log_prior(2, None)).numpy()
        np.testing.assert_allclose(uniform, np.log(2), atol=1e-6)
        sparse = losses.kl_to_prior(logits, config.log_prior(2, 0.9)).numpy()
        np.testing.assert_allclose(sparse, [-np.log(0.9), -np.log(0.1)], rtol=1e-6)


def test_gradient_of_the_divergence_is_finite_when_saturated():
    logits = tf.Variable([[1e3, -1e3], [1e30, -1e30]])
    with tf.GradientTape() as tape:
        divergence = tf.reduce_sum(losses.kl_to_prior(logits, config.log_prior(2, None)))
    assert np.isfinite(tape.gradient(divergence, logits)).all()


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


@pytest.mark.parametrize('prior', [0.0, 1.0, -0.1, float('nan')])
def test_impossible_priors_are_refused(prior):
    with pytest.raises(ValueError, match='no_edge_prior'):
        config.log_prior(2, prior)


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


def test_accuracy_does_not_depend_on_the_names_of_the_types():
    rng = np.random.default_rng(2)
    true = rng.integers(0, 3, (50, 20))
    found = np.where(rng.random(true.shape) < 0.8, true, rng.integers(0, 3, true.shape))
    plain, naming = losses.edge_accuracy(found, true, 3)
    assert plain == (found == true).mean() and naming == (0, 1, 2)
    renamed, naming = losses.edge_accuracy(np.array([2, 0, 1])[found], true, 3)
    assert renamed == plain and naming == (1, 2, 0)


def test_one_naming_serves_the_whole_data_set():
    """Types switched in half of the runs are half wrong, not all right."""
    true = np.random.default_rng(3).integers(0, 2, (100, 20))
    found = true.copy()
    found[50:] = 1 - found[50:]
    assert losses.edge_accuracy(found, true, 2)[0] == pytest.approx(0.5, abs=0.05)


def test_accuracy_refuses_what_does_not_fit():
    with pytest.raises(ValueError, match='differ'):
        losses.edge_accuracy(np.zeros((2, 3), int), np.zeros((2, 4), int), 2)
    with pytest.raises(ValueError, match='from 0 to 2'):
        losses.edge_accuracy(np.zeros(3, int), np.array([0, 1, 2]), 2)


def test_a_collapsed_posterior_is_flagged():
    certain = np.zeros((10, 100, 2))
    certain[..., 0] = 1.0
    used = losses.edge_usage(certain)
    assert used == {'usage': [1.0, 0.0], 'entropy': 0.0, 'status': 'COLLAPSED'}
    barely = certain.copy()
    barely[0, :9] = [0.0, 1.0]
    assert losses.edge_usage(barely)['status'] == 'COLLAPSED'
    barely[0, :11] = [0.0, 1.0]
    assert losses.edge_usage(barely)['status'] == 'OK'
    unsure = losses.edge_usage(np.full((4, 5, 2), 0.5))
    assert unsure['entropy'] == pytest.approx(1.0) and unsure['status'] == 'COLLAPSED'
