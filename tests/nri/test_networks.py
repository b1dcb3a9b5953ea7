"""Encoders and decoders against their numpy twin, and what must not change them."""

import numpy as np
import pytest
import tensorflow as tf

from nri import config
from nri.decoder import DECODERS, unroll
from nri.encoder import ENCODERS
from tests.nri import numpy_twin

V, T, F, WIDTH, K = 4, 15, 3, 6, 3


def features(seed=0, batch=3):
    return np.random.default_rng(seed).normal(size=(batch, V, T, F)).astype(np.float32)


def trained_a_little(encoder):
    """Running averages and scales that are not those of a fresh module."""
    for seed in range(3):
        encoder(tf.constant(features(seed) * (1 + seed)), is_training=True)
    rng = np.random.default_rng(9)
    for variable in encoder.trainable_variables:
        variable.assign(variable + rng.normal(0, 0.1, variable.shape))
    return encoder


def off_diagonal(of_pairs):
    """[B, V (V - 1), C] -> [B, V, V, C] with a zero diagonal."""
    dense = np.zeros((len(of_pairs), V, V, of_pairs.shape[-1]), of_pairs.dtype)
    dense[:, ~np.eye(V, dtype=bool)] = of_pairs
    return dense


@pytest.mark.parametrize('is_factor', [True, False])
@pytest.mark.parametrize('kind', ['mlp', 'cnn'])
def test_encoder_equals_its_twin(kind, is_factor):
    encoder = trained_a_little(ENCODERS[kind](WIDTH, K, is_factor))
    x = features(5)
    got = encoder(tf.constant(x), is_training=False).numpy()
    twin = {'mlp': numpy_twin.mlp_encoder, 'cnn': numpy_twin.cnn_encoder}[kind]
    want = np.stack([twin(encoder, sample.astype(float), is_factor) for sample in x])
    # Measured 2e-6 of the range.
    np.testing.assert_allclose(got, want, atol=2e-5 * np.abs(want).max())


@pytest.mark.parametrize('burn_in', [1, 3])
@pytest.mark.parametrize('skip_first', [True, False])
@pytest.mark.parametrize('kind', ['mlp', 'rnn'])
def test_decoder_equals_its_twin(kind, skip_first, burn_in):
    decoder = DECODERS[kind](F, WIDTH, K, skip_first)
    frames = features(6)[:, :, :6]
    types = np.random.default_rng(1).dirichlet(np.ones(K), (3, V * (V - 1))).astype(np.float32)
    got = unroll(decoder, tf.constant(frames), tf.constant(types), burn_in).numpy()
    want = np.stack(
        [
            numpy_twin.decode(decoder, f.astype(float), t, kind, skip_first, burn_in)
            for f, t in zip(frames, types, strict=True)
        ]
    )
    assert got.shape == (3, V, 5, F)
    np.testing.assert_allclose(got, want, atol=2e-5 * np.abs(want).max())


@pytest.mark.parametrize('kind', ['mlp', 'cnn'])
def test_permuting_the_nodes_permutes_the_edges(kind):
    encoder = trained_a_little(ENCODERS[kind](WIDTH, K))
    x, order = features(7), [2, 0, 3, 1]
    plain = off_diagonal(encoder(tf.constant(x), is_training=False).numpy())
    moved = off_diagonal(encoder(tf.constant(x[:, order]), is_training=False).numpy())
    np.testing.assert_allclose(moved, plain[:, order][:, :, order], atol=1e-4)


@pytest.mark.parametrize('kind', ['mlp', 'rnn'])
def test_type_zero_is_no_edge(kind):
    """With skip_first and all pairs of type 0 a node's future does not depend on the others."""
    decoder = DECODERS[kind](F, WIDTH, 2, True)
    none = tf.constant(np.tile([1.0, 0.0], (1, V * (V - 1), 1)), tf.float32)
    x = features(8, batch=1)[:, :, :5]
    other = x.copy()
    other[:, 1:] += 1.0
    plain = unroll(decoder, tf.constant(x), none, 2).numpy()
    changed = unroll(decoder, tf.constant(other), none, 2).numpy()
    np.testing.assert_array_equal(plain[:, 0], changed[:, 0])
    linked = unroll(decoder, tf.constant(other), 1.0 - none, 2).numpy()
    assert np.abs(linked[:, 0] - plain[:, 0]).max() > 1e-4


def test_what_is_found_for_a_run_does_not_depend_on_the_others_in_its_batch():
    encoder = trained_a_little(ENCODERS['mlp'](WIDTH, K))
    x = features(9)
    together = encoder(tf.constant(x), is_training=False).numpy()
    alone = [encoder(tf.constant(x[i : i + 1]), is_training=False).numpy() for i in range(3)]
    np.testing.assert_allclose(together, np.concatenate(alone), atol=1e-5)


def test_every_kind_of_a_config_has_its_network():
    assert (tuple(ENCODERS), tuple(DECODERS)) == (config.ENCODERS, config.DECODERS)
