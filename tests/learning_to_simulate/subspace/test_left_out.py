"""Nodes that a config leaves out: modes, and particles of a body."""

import numpy as np
import pytest

from learning_to_simulate import checkpoints, evaluation, reading_utils, registry
from pca_tools import dataset, files
from tests.learning_to_simulate import models, synthetic
from tests.learning_to_simulate.native import worlds

H = 6
TWO_MODES = {'overrides': {'modes': 2, 'mode_edges': 4}}


def test_fewer_modes_are_judged_against_all_of_the_dataset(tmp_path):
    model, (group, *_), metadata = models.make(tmp_path, **TWO_MODES)
    assert model.simulator.scene.n_modes == 2 and group.position.shape[2] == 4 + 2
    run = dataset.read_split(str(tmp_path), 'train')[0]
    result = models.rolled(model, group.select(0))
    summary = evaluation.summarise([(0, group.select(0), result)], model, metadata, 'train')
    # By hand: errors of the two modes, and all of the third.
    truth = run.position[H:].astype(np.float64)
    error = (result.position[0, :, 4:] - truth[:, 4:6], truth[:, 6:])
    expected = sum((e**2).sum() for e in error) / (len(truth) * 3 * synthetic.N_SOIL)
    np.testing.assert_allclose(summary['mean']['model']['soil_mse'], expected, rtol=1e-12)
    # The trivial predictors know all modes: they are the same for every model of the dataset.
    still = ((truth - run.position[H - 1].astype(np.float64))[:, 4:] ** 2).sum()
    still /= len(truth) * 3 * synthetic.N_SOIL
    np.testing.assert_allclose(summary['mean']['stay_still']['soil_mse'], still, rtol=1e-12)
    (path, _) = evaluation.save_rollouts(
        str(tmp_path / 'out'), 'train', [(0, group.select(0), result)], summary, metadata
    )
    written = files.read_npz(path)
    np.testing.assert_array_equal(written['ground_truth_rollout'], run.position[H:])
    assert written['predicted_rollout'].shape == truth.shape
    assert not written['predicted_rollout'][:, 6].any()
    np.testing.assert_array_equal(written['particle_types'], run.particle_type)


def test_fewer_modes_make_particles_and_are_loaded_again(tmp_path):
    model, (group, *_), metadata = models.make(tmp_path / 'data', **TWO_MODES)
    space = worlds.space()
    stepper = models.stepper(model, group.n_rigid, space)
    stepper.reset(group.position[0, :H])
    modes = stepper.step(group.position[0, H, : group.n_rigid]).modes
    full = np.concatenate([modes, np.zeros((1, 3))])
    np.testing.assert_allclose(stepper.particles(), space.decode(full), atol=1e-4)
    folder = tmp_path / 'model'
    folder.mkdir()
    checkpoints.save_config(str(folder), model, group.n_rigid, {})
    checkpoints.save_weights(str(folder), checkpoints.weights_of(model))
    opened = registry.open_model(str(folder), str(tmp_path / 'data'), 'test')
    again, (test, *_) = opened.model, opened.groups
    assert again.simulator.scene.n_modes == 2 and test.position.shape[2] == group.position.shape[2]
    with pytest.raises(ValueError, match='has 1 modes, the model in .* the first 2'):
        checkpoints.check_dataset(str(folder), again, 'other', metadata | {'mode_number': 1})
    with pytest.raises(ValueError, match='has 3 modes, not 4'):
        reading_utils.read_groups(str(tmp_path / 'data'), 'test', metadata, modes=4)


def test_thinned_blade_keeps_its_lowest_particles_and_comes_back_whole(tmp_path):
    folder = synthetic.write_dataset(tmp_path, rigid_counts=(4, 6))
    metadata = dataset.read_metadata(folder)
    (group,) = reading_utils.read_groups(folder, 'train', metadata, rigid_particles=2)
    runs = dataset.read_split(folder, 'train')
    assert len(group.position) == len(runs) and group.n_rigid == 2
    for run, whole, kept in zip(runs, group.all_particles(group.position), group.kept):
        np.testing.assert_array_equal(whole, run.position)
        lowest = np.sort(run.position[0, : run.n_rigid, 1])[:2]
        np.testing.assert_array_equal(np.sort(run.position[0, kept, 1]), lowest)
    again = group.all_particles(group.position[:, 6:] + 1.0)[1]
    moved = again - runs[1].position[6:]
    assert np.isclose(moved[:, group.kept[1]], 1).all()
    assert np.isclose(moved, 0).sum() == moved[:, :4].size  # the other four rigid particles
