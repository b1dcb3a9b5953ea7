"""Encoder and decoder against their numpy twin, pair operations against loops, and what must not
change them."""

import numpy as np
import pytest
import tensorflow as tf

from nri import networks
from nri.networks import Decoder, Encoder, unroll
from tests.nri import numpy_twin

V, T, F, WIDTH, K = 4, 15, 3, 6, 3


def features(seed=0, batch=3):
    return np.random.default_rng(seed).normal(size=(batch, V, T, F)).astype(np.float32)


@pytest.mark.parametrize('n_node', [2, 3, 5, 28])
def test_pairs_stand_in_kipfs_order(n_node):
    rng = np.random.default_rng(n_node)
    receiver, sender = rng.normal(size=(2, 4, n_node, 3)).astype(np.float32)
    got = networks.pair_sums(tf.constant(receiver), tf.constant(sender)).numpy()
    order = numpy_twin.pairs_of(n_node)
    want = np.stack([receiver[:, i] + sender[:, j] for i, j in order], axis=1)
    np.testing.assert_array_equal(got, want)
    receivers, senders = networks.pair_indices(n_node)
    assert list(zip(receivers, senders, strict=True)) == order
    total = networks.sum_to_receivers(tf.constant(want), n_node).numpy()
    for i in range(n_node):
        mine = [e for e, (r, _) in enumerate(order) if r == i]
        np.testing.assert_allclose(total[:, i], want[:, mine].sum(1), rtol=1e-5, atol=1e-5)
    # Mutual pairs: a matrix and its transpose.
    matrix = np.zeros((4, n_node, n_node, 3), np.float32)
    matrix[:, receivers, senders] = want
    half = 0.5 * (matrix + matrix.swapaxes(1, 2))
    mean = networks.mean_of_both_ways(tf.constant(want), n_node)
    np.testing.assert_allclose(mean, half[:, *np.triu_indices(n_node, 1)], rtol=1e-6)
    both = networks.both_ways(mean, n_node)
    np.testing.assert_allclose(both, half[:, receivers, senders], rtol=1e-6)


@pytest.fixture(scope='module')
def encoder():
    """Trained a little: running averages and scales that are not those of a fresh module."""
    made = Encoder(WIDTH, K)
    for seed in range(3):
        made(tf.constant(features(seed) * (1 + seed)), is_training=True)
    rng = np.random.default_rng(9)
    for variable in made.trainable_variables:
        variable.assign(variable + rng.normal(0, 0.1, variable.shape))
    return made


def test_encoder_equals_its_twin(encoder):
    x = features(5)
    want = np.stack([numpy_twin.encode(encoder, sample.astype(float)) for sample in x])
    got = encoder(tf.constant(x), is_training=False)
    # Measured 2e-6 of the range. The twin sees one run, pair by pair: neither the others of a batch
    # nor the order of the nodes can matter.
    np.testing.assert_allclose(got, want, atol=2e-5 * np.abs(want).max())


@pytest.mark.parametrize('skip_first', [True, False])
def test_decoder_equals_its_twin(skip_first):
    decoder = Decoder(F, WIDTH, K, skip_first)
    frame = features(6)[:, :, 0]
    types = np.random.default_rng(1).dirichlet(np.ones(K), (3, V * (V - 1))).astype(np.float32)
    got = unroll(decoder, tf.constant(frame), tf.constant(types), 5).numpy()
    pairs = zip(frame.astype(float), types, strict=True)
    want = np.stack([numpy_twin.decode(decoder, f, t, 5, int(skip_first)) for f, t in pairs])
    assert got.shape == (3, V, 5, F)
    np.testing.assert_allclose(got, want, atol=2e-5 * np.abs(want).max())
