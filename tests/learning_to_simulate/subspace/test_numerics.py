"""Settings, and statistics against plain numpy; noise and losses: `test_trainer`."""

import dataclasses

import numpy as np
import pytest

from learning_to_simulate import normalization, presets
from learning_to_simulate.subspace.trainer import Trainer
from tests.learning_to_simulate import models, synthetic


def test_our_statistics_are_those_of_each_class(tmp_path):
    model, groups, _ = models.make(tmp_path, rigid_counts=(4, 6), overrides={'rigid_particles': 0})
    assert len(groups) == 2
    s, r = model.simulator.statistics, synthetic.N_MODES
    runs = [g.position[i] for g in groups for i in range(len(g.position))]

    def floored(std):
        return np.maximum(std, normalization.STD_FLOOR * std.max())

    for k in range(r):
        x = np.concatenate([run[:, k - r] for run in runs])
        v = np.concatenate([np.diff(run[:, k - r], axis=0) for run in runs])
        a = np.concatenate([np.diff(run[:, k - r], n=2, axis=0) for run in runs])
        np.testing.assert_allclose(s.origin[1 + k], x.mean(axis=0))
        np.testing.assert_allclose(s.velocity_mean[1 + k], v.mean(axis=0))
        np.testing.assert_allclose(s.velocity_std[1 + k], floored(v.std(axis=0)))
        np.testing.assert_allclose(s.acceleration_std[1 + k], floored(a.std(axis=0)))
        np.testing.assert_allclose(s.position_range[:, 1 + k], [x.min(axis=0), x.max(axis=0)])
    pairs = np.concatenate([(run[:, :-r] - run[:, -r:][:, 1:2]).reshape(-1, 3) for run in runs])
    np.testing.assert_allclose(s.displacement_mean[2, 0], pairs.mean(axis=0), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(s.displacement_std[2, 0], floored(pairs.std(axis=0)), rtol=1e-6)


def test_published_statistics_come_from_the_metadata_with_the_noise(tmp_path):
    model, _, metadata = models.make(tmp_path, preset='fcg_original')
    s = model.simulator.statistics
    expected = np.hypot(metadata['acc_std'], 6.7e-4)
    np.testing.assert_allclose(s.acceleration_std[1], expected, rtol=1e-3)  # still axes are floored
    assert (s.displacement_std == 0.025).all()


def test_statistics_survive_json_and_know_their_shapes(tmp_path):
    model, _, _ = models.make(tmp_path, motion='driven', context=True)
    scene, values = model.simulator.scene, model.simulator.statistics.to_json()
    again = normalization.Statistics.from_json(values)
    again.check(scene)
    for name, value in vars(model.simulator.statistics).items():
        np.testing.assert_equal(getattr(again, name), value)
    for name, wrong in (
        ('origin', [0.0]), ('height_std', [0.0]), ('target_std', None), ('force_mean', None),
        ('context_range', [[1.0, 1.0], [0.0, 0.0]]), ('log_context_mean', [1.0]),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=f'statistics.{name}'):
            normalization.Statistics.from_json(values | {name: wrong}).check(scene)


def test_presets_are_the_published_settings():
    fcg, pcg = presets.PRESETS['fcg_original'], presets.PRESETS['pcg_thesis']
    assert (fcg.noise_std, pcg.noise_std) == (6.7e-4, 6.7e-6)
    assert (fcg.adjacency, pcg.adjacency) == ('fully_connected', 'algorithm2')
    for c in (fcg, pcg):
        sizes = c.latent_size, c.message_passing_steps, c.learning_rate, c.batch_size
        assert sizes == (128, 1, 1e-4, 2)


GATED = {'gate_weight': 0.1}


@pytest.mark.parametrize(
    ('preset', 'fields', 'words'),
    [
        ('gns', {}, 'unknown preset'),
        ('mlp', {'model': 'path_ridge'}, "preset 'mlp' is one of .*, not of 'path_ridge'"),
        ('path_ridge', {'model': 'gns'}, "preset 'path_ridge' is one of .*, not of 'gns'"),
        ('pcg', {'rate_scaled': True, 'mode_order': 2}, 'rate_scaled'),
        ('pcg', {'weight_average': 1.0}, 'weight_average'),
        ('pcg', {'mode_order': 3}, 'mode_order'),
        ('pcg', {'batch_size': 0}, 'batch_size'),
        ('pcg', {'num_steps': 30, 'unroll_steps': 50}, 'unroll_steps is 50, more than all 30'),
        ('pcg', {'mode_order': 0, 'rate_scaled': False}, 'only an MLP of the style ours'),
        ('mlp_driven', {'style': 'published'}, 'only an MLP of the style ours'),
        ('pcg', {'model': 'lstm'}, "unknown model 'lstm'; there are gns, mlp"),
        ('pcg', {'model': 'mlp'}, "adjacency is 'algorithm2' with model 'mlp'"),
        ('pcg', {'adjacency': 'none'}, "adjacency is 'none' with model 'gns'"),
        ('pcg', {'modes': -1}, 'modes'),
        ('full_space', {'modes': 2}, 'modes'),
        ('pcg', GATED | {'gate_steps': 3000}, 'gates must close'),
        ('pcg', GATED | {'gate_steps': 30, 'num_steps': 30}, 'gates must close'),
        ('pcg', GATED | {'adjacency': 'fully_connected'}, 'leave one of them out'),
        ('pcg', GATED | {'gate_steps': 0}, 'gate_steps is 0'),
        ('pcg', {'gate_weight': -1.0}, 'gate_weight is -1'),
    ],
)
def test_impossible_settings_are_refused(preset, fields, words):
    with pytest.raises(ValueError, match=words):
        presets.make_config(preset, **fields)
    assert presets.make_config('mixer_se', model='mixer_scse').model == 'mixer_scse'


@pytest.mark.parametrize('force', [0.0, 37.5])
def test_force_that_never_changes_divides_by_no_round_off(tmp_path, monkeypatch, force):
    """A body in the air: its runs train, and their weights are finite."""
    made = synthetic.make_trajectory

    def still(*arguments):
        run = made(*arguments)
        return dataclasses.replace(run, force=np.full_like(run.force, force))

    monkeypatch.setattr(synthetic, 'make_trajectory', still)
    model, groups, _ = models.make(tmp_path)
    np.testing.assert_array_equal(model.simulator.statistics.force_std, 1.0)
    tensors = Trainer(model, groups)._tensors[0]
    assert np.isfinite(tensors.force_weight).all() and not tensors.force.numpy().any()
