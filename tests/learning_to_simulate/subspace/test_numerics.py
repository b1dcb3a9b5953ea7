"""Noise, statistics and losses against plain numpy."""

import dataclasses

import numpy as np
import pytest

from learning_to_simulate import normalization, presets, reading_utils
from learning_to_simulate.subspace import noise_utils, trainer
from learning_to_simulate.subspace.trainer import Trainer
from pca_tools import dataset
from tests.learning_to_simulate import models, synthetic


def test_noise_walks_to_the_asked_deviation():
    std = np.array([[1e-3, 2e-5, 0.0]], np.float32)
    noise = noise_utils.random_walk_velocity_noise([20_000, 1, 5, 3], std, [1, 2]).numpy()
    # Standard error of a deviation from 20,000 draws is 0.5 %: four of them.
    np.testing.assert_allclose(noise.std(axis=0)[0, -1], std[0], rtol=2e-2)
    np.testing.assert_allclose(noise.std(axis=0)[0, 0], std[0] / 5**0.5, rtol=2e-2)
    assert (noise[..., 2] == 0).all()
    np.testing.assert_allclose(noise_utils.position_noise(noise), noise.sum(axis=2), rtol=1e-6)


def test_our_statistics_are_those_of_each_class(tmp_path):
    model, groups, _ = models.make(tmp_path, rigid_counts=(4, 6), overrides={'velocity_inputs': 5})
    s, r = model.simulator.statistics, synthetic.N_MODES
    runs = [g.position[i] for g in groups for i in range(len(g.position))]
    for k in range(r):
        x = np.concatenate([run[:, k - r] for run in runs])
        v = np.concatenate([np.diff(run[:, k - r], axis=0) for run in runs])
        np.testing.assert_allclose(s.origin[1 + k], x.mean(axis=0))
        floor = normalization.STD_FLOOR * v.std(axis=0).max()
        np.testing.assert_allclose(s.velocity_std[1 + k], np.maximum(v.std(axis=0), floor))
    pairs = np.concatenate([(run[:, :-r] - run[:, -r:][:, 1:2]).reshape(-1, 3) for run in runs])
    np.testing.assert_allclose(s.displacement_mean[2, 0], pairs.mean(axis=0), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        s.displacement_std[2, 0],
        np.maximum(pairs.std(axis=0), 1e-3 * pairs.std(axis=0).max()),
        rtol=1e-6,
    )


def test_published_statistics_come_from_the_metadata_with_the_noise(tmp_path):
    model, _, metadata = models.make(tmp_path, preset='fcg_original')
    s = model.simulator.statistics
    expected = np.hypot(metadata['acc_std'], 6.7e-4)
    np.testing.assert_allclose(s.acceleration_std[1], expected, rtol=1e-3)  # still axes are floored
    assert (s.displacement_std == 0.025).all()


def test_statistics_survive_json(tmp_path):
    model, _, _ = models.make(tmp_path, motion='driven', context=True)
    s = model.simulator.statistics
    again = normalization.Statistics.from_json(s.to_json())
    for name, value in vars(s).items():
        other = getattr(again, name)
        assert (value is None and other is None) or (value == other).all(), name


def test_one_step_loss_is_equation_13():
    """Sum over moving nodes of |a - â|² over their number, plus |F - F̂|², mean over graphs."""
    rng = np.random.default_rng(0)
    target, predicted = rng.normal(size=(2, 4, 5, 3)).astype(np.float32)
    force, predicted_force = rng.normal(size=(2, 4, 3)).astype(np.float32)
    moving = np.ones((5, 3), np.float32)
    moving[:2] = 0
    expected = np.mean([((p - t)[2:] ** 2).sum() / 3 for p, t in zip(predicted, target)]) + np.mean(
        [((p - t) ** 2).sum() for p, t in zip(predicted_force, force)]
    )
    error, loads = (predicted - target)[:, None], (predicted_force[:, None], force[:, None])
    values = trainer.training_loss(error, moving, *loads, [1.0])
    np.testing.assert_allclose(values['loss'], expected, rtol=1e-5)
    without = trainer.training_loss(error, moving, None, None, [])
    assert set(without) == {'loss', 'loss_mse'}


def test_thinned_body_keeps_its_lowest_particles_and_comes_back_whole(tmp_path):
    folder = synthetic.write_dataset(tmp_path, rigid_counts=(4, 6))
    metadata = dataset.read_metadata(folder)
    (group,) = reading_utils.read_groups(folder, 'train', metadata, rigid_particles=2)
    runs = dataset.read_split(folder, 'train')
    assert len(group.position) == len(runs) and group.n_rigid == 2
    for run, whole, kept in zip(runs, group.all_particles(group.position), group.kept):
        np.testing.assert_array_equal(whole, run.position)
        lowest = np.sort(run.position[0, : run.n_rigid, 1])[:2]
        np.testing.assert_array_equal(np.sort(run.position[0, kept, 1]), lowest)
    predicted = group.position[:, 6:] + 1.0
    again = group.all_particles(predicted)[1]
    moved = again - runs[1].position[6:]
    assert np.isclose(moved[:, group.kept[1]], 1).all()
    assert np.isclose(moved, 0).sum() == moved[:, :4].size  # the other four rigid particles


def test_presets_are_the_published_settings():
    fcg, pcg = presets.PRESETS['fcg_original'], presets.PRESETS['pcg_thesis']
    assert (fcg.noise_std, pcg.noise_std) == (6.7e-4, 6.7e-6)
    assert (fcg.adjacency, pcg.adjacency) == ('fully_connected', 'algorithm2')
    for c in (fcg, pcg):
        assert (c.latent_size, c.message_passing_steps, c.learning_rate, c.batch_size) == (
            128,
            1,
            1e-4,
            2,
        )


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
    assert np.isfinite(tensors.load_weights).all() and not tensors.load.numpy().any()
