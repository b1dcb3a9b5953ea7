"""Config, probabilities, and models on disk."""

import numpy as np
import pytest
import tensorflow as tf

from nri import model, networks
from nri.config import NriConfig
from nri.model import load_model
from pca_tools import files
from tests.nri import small


@pytest.mark.parametrize(
    ('settings', 'message'),
    [
        ({'temperature': 0.0}, 'temperature is 0.0, must be at least 0.05'),
        ({'edge_types': 1}, 'edge_types is 1, must be at least 2'),
        ({'segment': 49}, 'more than the window of 49'),
        ({'seed': 2**28}, 'seed is 268435456'),
        ({'output_variance': float('nan')}, 'output_variance is nan'),
        *(({'no_edge_prior': p}, f'no_edge_prior is {p}, must') for p in (0.0, 1.0, np.nan)),
    ],
)
def test_settings_outside_their_range_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        NriConfig(**settings)


@pytest.mark.parametrize('symmetric', [False, True])
def test_a_saved_model_gives_the_same_bits(tmp_path, symmetric):
    held = small.springs(n_run=6)
    made = small.model(held, symmetric=symmetric)
    made.encode(tf.constant(held.features), is_training=True)  # running averages of their own
    made.save(str(tmp_path))
    loaded = load_model(str(tmp_path))
    assert loaded.config == made.config and loaded.node_names == held.node_names
    assert loaded.digest == files.sha256_of_file(str(tmp_path / 'weights.npz'))
    want = made.edge_probabilities(held.features)
    assert want.shape == (6, 6, 2)
    np.testing.assert_allclose(want.sum(-1), 1.0, atol=1e-6)
    np.testing.assert_array_equal(loaded.edge_probabilities(held.features), want)
    seed = tf.constant([1, 2])
    for name, value in made.losses(held.features, seed).items():
        assert float(loaded.losses(held.features, seed)[name]) == float(value)


def test_long_runs_are_the_mean_over_their_windows():
    held = small.springs(n_run=3, n_frame=40)
    # Windows of 15 frames (of 29 with a stride) cover 40; the last one ends with the run.
    for stride, span, starts in ((1, 15, (0, 12, 25)), (2, 29, (0, 11))):
        made = small.model(held, stride=stride)
        windows = [held.features[:, :, s : s + span : stride] for s in starts]
        want = np.mean([made.window_probabilities(window) for window in windows], axis=0)
        np.testing.assert_allclose(made.edge_probabilities(held.features), want, atol=1e-6)


def test_foreign_features_are_refused():
    held = small.springs(n_run=2)
    made = small.model(held)
    for features, message in (
        (small.springs(n_run=2, n_objects=4).features, r'\(2, 4, 15, 4\), \(runs, 3 nodes'),
        (held.features[:, :, :14], 'runs have 14 frames'),
        (held.features[..., :3], 'frames, 4'),
        (held.features[0], 'shape'),
    ):
        with pytest.raises(ValueError, match=message):
            made.edge_probabilities(features)


def test_damaged_and_foreign_model_folders_are_refused(tmp_path):
    made = small.model(small.springs(n_run=2))
    with pytest.raises(FileNotFoundError, match='config.json'):
        load_model(str(tmp_path))
    made.save(str(tmp_path))
    before, good = (tmp_path / 'weights.npz').read_bytes(), made.to_json()
    for changes, message in (
        ({'kind': None}, 'not the config of an NRI model'),
        ({'schema_version': 2}, 'not a model config of schema version 1'),
        ({'config': good['config'] | {'new': 1}}, 'missing, unknown'),
        ({'config': good['config'] | {'hidden': 9}}, 'not the weights of config.json'),
        ({'config': good['config'] | {'temperature': 0}}, 'temperature'),
    ):
        files.write_json(str(tmp_path / 'config.json'), good | changes)
        with pytest.raises(ValueError, match=message):
            load_model(str(tmp_path))
    files.write_json(str(tmp_path / 'config.json'), good)
    load_model(str(tmp_path))
    made.trainable_variables[0].assign(made.trainable_variables[0] * np.nan)
    with pytest.raises(ValueError, match='not finite'):
        made.save(str(tmp_path))
    assert (tmp_path / 'weights.npz').read_bytes() == before


def test_prior_moves_the_loss_by_its_divergence_only():
    """The same divergence in training and validation, with any prior."""
    held = small.springs(n_run=8)
    plain, sparse = small.model(held), small.model(held, no_edge_prior=0.9)
    seed = tf.constant([5, 6])
    for is_training in (True, False):
        a, b = (m.losses(held.features, seed, is_training=is_training) for m in (plain, sparse))
        assert float(a['nll']) == pytest.approx(float(b['nll']), rel=1e-6)
        assert float(a['kl']) != float(b['kl']) and min(float(a['kl']), float(b['kl'])) >= 0
        assert float(a['loss']) == pytest.approx(float(a['nll']) + float(a['kl']), rel=1e-6)


def test_mutual_types_are_one_for_both_directions(monkeypatch):
    """Logits are the mean of the two; the sample is one, and so counts once in the divergence."""
    held = small.springs(n_run=4, n_objects=4)
    plain, mutual = small.model(held), small.model(held, symmetric=True)
    frames = mutual.normalized(held.features)
    receivers, senders = networks.pair_indices(4)
    back = [list(zip(receivers, senders)).index((j, i)) for i, j in zip(receivers, senders)]

    def wanted(is_training):
        logits = plain.logits(frames, is_training).numpy()
        return tf.nn.softmax(0.5 * (logits + logits[:, back])).numpy()

    np.testing.assert_allclose(mutual.edge_probabilities(held.features), wanted(False), rtol=1e-5)
    want = wanted(True)
    kl = (want * np.log(2.0 * want)).sum(-1).sum(1).mean() / 4
    seen, predict = [], model.unroll
    monkeypatch.setattr(model, 'unroll', lambda *a: (seen.append(a[2].numpy()), predict(*a))[1])
    values = mutual.losses(held.features, tf.constant([1, 2]), is_training=True)
    assert float(values['kl']) == pytest.approx(0.5 * kl, rel=1e-4)
    np.testing.assert_array_equal(seen[0], seen[0][:, back])
    assert (seen[0][0, 0] != seen[0][0, 1]).all()
