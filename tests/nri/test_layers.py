"""Dense pair operations against loops over layers."""

import numpy as np
import pytest
import tensorflow as tf

from nri import layers


@pytest.mark.parametrize('n_node', [2, 3, 5, 28])
def test_pair_sums_and_receivers_in_kipf_order(n_node):
    rng = np.random.default_rng(n_node)
    receiver, sender = rng.normal(size=(2, 4, n_node, 3)).astype(np.float32)
    got = layers.pair_sums(tf.constant(receiver), tf.constant(sender)).numpy()
    order = [(i, j) for i in range(n_node) for j in range(n_node) if i != j]
    want = np.stack([receiver[:, i] + sender[:, j] for i, j in order], axis=1)
    np.testing.assert_array_equal(got, want)
    receivers, senders = layers.pair_indices(n_node)
    assert list(zip(receivers, senders, strict=True)) == order
    total = layers.sum_to_receivers(tf.constant(want), n_node).numpy()
    for i in range(n_node):
        mine = [e for e, (r, _) in enumerate(order) if r == i]
        np.testing.assert_allclose(total[:, i], want[:, mine].sum(1), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize('n_node', [2, 3, 6])
def test_values_of_mutual_pairs_against_a_matrix_and_its_transpose(n_node):
    of_pair = np.random.default_rng(n_node).normal(size=(2, n_node * (n_node - 1), 3))
    matrix = np.zeros((2, n_node, n_node, 3))
    receivers, senders = layers.pair_indices(n_node)
    matrix[:, receivers, senders] = of_pair
    want = 0.5 * (matrix + matrix.swapaxes(1, 2))
    mean = layers.mean_of_both_ways(tf.constant(of_pair), n_node)
    np.testing.assert_allclose(mean, want[:, *np.triu_indices(n_node, 1)], rtol=1e-12)
    both = layers.both_ways(mean, n_node)
    np.testing.assert_allclose(both, want[:, receivers, senders], rtol=1e-12)
