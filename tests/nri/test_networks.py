"""Encoder and decoder against their numpy twin, and what must not change them."""

import numpy as np
import pytest
import tensorflow as tf

from nri.decoder import Decoder, unroll
from nri.encoder import Encoder
from tests.nri import numpy_twin

V, T, F, WIDTH, K = 4, 15, 3, 6, 3


def features(seed=0, batch=3):
    return np.random.default_rng(seed).normal(size=(batch, V, T, F)).astype(np.float32)


@pytest.fixture(scope='module')
def encoder():
    """Trained a little: running averages and scales that are not those of a fresh module."""
    made = Encoder(WIDTH, K)
    for seed in range(3):
        made(tf.constant(features(seed) * (1 + seed)), is_training=True)
    rng = np.random.default_rng(9)
    for variable in made.trainable_variables:
        variable.assign(variable + rng.normal(0, 0.1, variable.shape))
    return lambda x: made(tf.constant(x), is_training=False).numpy(), made


def test_encoder_equals_its_twin(encoder):
    encode, module = encoder
    x = features(5)
    want = np.stack([numpy_twin.encode(module, sample.astype(float)) for sample in x])
    # Measured 2e-6 of the range.
    np.testing.assert_allclose(encode(x), want, atol=2e-5 * np.abs(want).max())


@pytest.mark.parametrize('skip_first', [True, False])
def test_decoder_equals_its_twin(skip_first):
    decoder = Decoder(F, WIDTH, K, skip_first)
    frame = features(6)[:, :, 0]
    types = np.random.default_rng(1).dirichlet(np.ones(K), (3, V * (V - 1))).astype(np.float32)
    got = unroll(decoder, tf.constant(frame), tf.constant(types), 5).numpy()
    want = np.stack(
        [
            numpy_twin.decode(decoder, f.astype(float), t, 5, int(skip_first))
            for f, t in zip(frame, types, strict=True)
        ]
    )
    assert got.shape == (3, V, 5, F)
    np.testing.assert_allclose(got, want, atol=2e-5 * np.abs(want).max())


def test_permuting_the_nodes_permutes_the_edges(encoder):
    def off_diagonal(of_pairs):
        dense = np.zeros((len(of_pairs), V, V, K))
        dense[:, ~np.eye(V, dtype=bool)] = of_pairs
        return dense

    x, order = features(7), [2, 0, 3, 1]
    plain, moved = off_diagonal(encoder[0](x)), off_diagonal(encoder[0](x[:, order]))
    np.testing.assert_allclose(moved, plain[:, order][:, :, order], atol=1e-4)


def test_type_zero_is_no_edge():
    """With skip_first and all pairs of type 0 a node's future does not depend on the others."""
    decoder = Decoder(F, WIDTH, 2, True)
    none = tf.constant(np.tile([1.0, 0.0], (1, V * (V - 1), 1)), tf.float32)
    x = features(8, batch=1)[:, :, 0]
    other = x.copy()
    other[:, 1:] += 1.0
    plain, changed = (unroll(decoder, tf.constant(f), none, 4).numpy() for f in (x, other))
    np.testing.assert_array_equal(plain[:, 0], changed[:, 0])
    linked = unroll(decoder, tf.constant(other), 1.0 - none, 4).numpy()
    assert np.abs(linked[:, 0] - plain[:, 0]).max() > 1e-4


def test_what_is_found_for_a_run_does_not_depend_on_the_others_in_its_batch(encoder):
    x = features(9)
    alone = [encoder[0](x[i : i + 1]) for i in range(3)]
    np.testing.assert_allclose(encoder[0](x), np.concatenate(alone), atol=1e-5)
