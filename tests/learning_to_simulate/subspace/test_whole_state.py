"""Networks without a graph: what they are made for, and what they refuse. Their steps are held
against numpy in `test_learned_simulator`."""

import os

import numpy as np
import pytest

from learning_to_simulate import presets, registry
from learning_to_simulate.export import step_functions
from learning_to_simulate.native import model_data
from learning_to_simulate.rollout import rollout_inputs
from learning_to_simulate.subspace import method
from learning_to_simulate.subspace.trainer import Trainer
from pca_tools import dataset
from tests.learning_to_simulate import models, synthetic
from tests.learning_to_simulate.twins.numpy_twin import WholeStateTwin

SHORT = {'num_steps': 6, 'unroll_steps': 1, 'unroll_length': 2, 'latent_size': 8, 'batch_size': 4}


@pytest.fixture(scope='module')
def driven(tmp_path_factory):
    """(model, group, folder) of an untrained `mlp_driven`. Not to be changed."""
    folder = tmp_path_factory.mktemp('driven')
    model, (group,), _ = models.make(folder, 'mlp_driven', shaken=0.3)
    return model, group, str(folder)


def test_a_place_is_a_function_of_path_and_start_alone(driven):
    """Against numpy, with the path that `PathMemory` reads; other soil on the way is not seen."""
    made, group, _ = driven
    layout, s = made.layout(group.n_rigid), made.simulator.statistics
    n, r = group.n_rigid, made.simulator.scene.n_modes
    state, known, _, _ = rollout_inputs(group, layout, made.simulator.scene)
    after, force = made.simulator.step(state, known.at(0), None, layout)
    elsewhere = state._replace(offset=state.offset + 0.1, velocity=3.0 * state.velocity)
    again, same = made.simulator.step(elsewhere, known.at(0), None, layout)
    np.testing.assert_allclose(again.offset, after.offset, atol=1e-6)
    np.testing.assert_array_equal(force, same)
    twin = WholeStateTwin(made, n)
    path = layout.memory.read(group.position[:, :7, :n])[:, 6]
    for i, run in enumerate(group.position):
        coming = (run[6, :n] - run[5, :n] - s.velocity_mean[0]) / s.velocity_std[0]
        start = (run[5, n:] - s.origin[1:]) / s.position_std[1:]
        inputs = np.concatenate([coming.ravel(), path[i], start.ravel()])
        rows = twin.mlp_output(np.zeros(0), inputs).reshape(-1, 3)
        place = run[5, n:] + rows[:r] * s.target_std[1:] + s.target_mean[1:]
        np.testing.assert_allclose(after.offset[i, n:] + layout.origin[n:], place, atol=1e-5)
        expected = rows[-1] * s.force_std + s.force_mean
        np.testing.assert_allclose(force[i], expected, rtol=1e-3, atol=1e-3)
    # What training asks of it is where the modes are, whatever noise the state carries.
    moved = group.position[:, 6] - layout.origin - elsewhere.offset
    target = made.simulator.normalized_target(moved, elsewhere, known.at(0), layout)
    since = group.position[:, 6, n:] - group.position[:, 5, n:]
    expected = (since - s.target_mean[1:]) / s.target_std[1:]
    np.testing.assert_allclose(target[:, n:], expected, atol=1e-3)


def test_copies_need_a_subspace_and_join_the_training(driven):
    made, group, folder = driven
    with pytest.raises(ValueError, match='subspace.npz'):
        method._with_copies(made, [group], folder)
    synthetic.write_subspace(folder)
    (more,) = method._with_copies(made, [group], folder)
    assert len(more.position) > len(group.position)


def test_exports_refuse_a_path_by_name(driven, tmp_path):
    made = driven[0]
    with pytest.raises(ValueError, match='no memory of the path'):
        step_functions.StepFunctions(*models.saved(tmp_path, 'mlp_driven'))
    with pytest.raises(ValueError, match="inputs .*'path', 'start'.* the C form knows"):
        model_data.refuse(made.simulator)


def test_a_body_whose_height_is_predicted_has_no_path_inputs(tmp_path):
    with pytest.raises(ValueError, match='whole motion is given'):
        models.make(tmp_path, motion='driven', preset='mlp_driven')


def test_a_mixer_is_trained_and_rolls_out(tmp_path):
    """Through the functions of the command line: train, load, evaluate."""
    folder = synthetic.write_dataset(tmp_path / 'data')
    os.remove(dataset.split_path(folder, 'valid'))  # the test runs are rolled out below
    path = str(tmp_path / 'model')
    config = presets.make_config('mixer_scse', **SHORT)
    with models.eagerly():
        registry.train(folder, path, config)
        opened = registry.open_model(path, folder, 'test')
        _, summary = opened.evaluator.run(opened.groups, 'test')
        errors = Trainer(opened.model, opened.groups).one_step_errors(2)
    assert summary['mean']['model']['soil_mse'] > 0
    assert all(row['edges'] == 0 for row in summary['runs']['model'])
    assert np.isfinite(errors['loss'])
    with pytest.raises(ValueError, match='model=gns contradicts the model'):
        registry.open_model(path, folder, 'test', {'model': 'gns'})
    other = synthetic.write_dataset(tmp_path / 'other', rigid_counts=(6,))
    with pytest.raises(ValueError, match='made for 4 rigid particles and cannot take 6'):
        registry.open_model(path, other, 'test', {})
