"""Networks without a graph, against numpy and against closed forms."""

import os

import numpy as np
import pytest

from learning_to_simulate import checkpoints, evaluation, presets, registry
from learning_to_simulate.export import step_functions
from learning_to_simulate.native import model_data
from learning_to_simulate.rollout import rollout_inputs
from learning_to_simulate.subspace import method
from learning_to_simulate.subspace.trainer import Trainer
from pca_tools import dataset, files
from tests.learning_to_simulate import models, synthetic
from tests.learning_to_simulate.twins.whole_state_twin import WholeStateTwin

MODELS = ('mlp', 'mixer_se', 'mixer_scse')
SHORT = {'num_steps': 6, 'unroll_steps': 1, 'unroll_length': 2, 'latent_size': 8, 'batch_size': 4}


def make(folder, model, motion='prescribed', rigid_motion=None, **data):
    """An untrained model with its runs, every weight random so that nothing hides behind a zero."""
    overrides = {'mode_edges': 0, 'predict_torque': data.get('torque', False)}
    made, groups, metadata = models.make(folder, model, motion, rigid_motion, overrides, **data)
    rng = np.random.default_rng(0)
    for variable in made.simulator.trainable_variables:
        variable.assign(rng.normal(0.0, 0.3, variable.shape))
    return made, groups, metadata


@pytest.mark.parametrize('model', MODELS)
@pytest.mark.parametrize(
    ('motion', 'context', 'torque'),
    [('prescribed', False, False), ('driven', True, True), ('predicted', True, False)],
)
def test_step_equals_the_numpy_twin(tmp_path, model, motion, context, torque):
    """float32 against float64 on scores of 9 m; their frame steps are 1e-3 m, 1e-6 is measured."""
    made, (group,), _ = make(tmp_path, model, motion, context=context, torque=torque)
    layout = made.layout(group.n_rigid)
    state, known, values, _ = rollout_inputs(group, layout, made.simulator.scene)
    coming = None if known is None else type(known)(known.offset[0], known.velocity[0])
    after, force = made.simulator.step(state, coming, values, layout)
    twin = WholeStateTwin(made, group.n_rigid)
    for i in range(len(group.position)):
        position, true_force = twin.step(
            group.position[i, :6],
            group.position[i, 6, : group.n_rigid],
            None if group.context is None else group.context[i],
        )
        np.testing.assert_allclose(after.offset[i] + layout.origin, position, atol=1e-5)
        np.testing.assert_allclose(force[i], true_force, rtol=1e-3, atol=1e-3)


def test_a_place_is_a_function_of_path_and_start_alone(tmp_path):
    """Against numpy, with the path that `PathMemory` reads; other soil on the way is not seen."""
    made, (group,), _ = make(tmp_path, 'mlp_driven')
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
        rows = twin._mlp_output(np.zeros(0), inputs).reshape(-1, 3)
        place = run[5, n:] + rows[:r] * s.target_std[1:] + s.target_mean[1:]
        np.testing.assert_allclose(after.offset[i, n:] + layout.origin[n:], place, atol=1e-5)
        np.testing.assert_allclose(
            force[i], rows[-1] * s.force_std + s.force_mean, rtol=1e-3, atol=1e-3
        )
        # What training asks of it is where the modes are, whatever noise the state carries.
    moved = group.position[:, 6] - layout.origin - elsewhere.offset
    target = made.simulator.normalized_target(moved, elsewhere, known.at(0), layout)
    since = group.position[:, 6, n:] - group.position[:, 5, n:]
    expected = (since - s.target_mean[1:]) / s.target_std[1:]
    np.testing.assert_allclose(target[:, n:], expected, atol=1e-3)


@pytest.mark.parametrize(
    ('preset', 'fields', 'words'),
    [
        ('pcg', {'mode_order': 0, 'rate_scaled': False}, 'need path_inputs'),
        ('mlp', {'state_inputs': False}, 'need path_inputs'),
        ('pcg', {'path_inputs': True, 'state_inputs': False}, 'only the MLP'),
        ('pcg', {'path_inputs': True, 'style': 'published'}, 'needs the style ours'),
    ],
)
def test_configs_without_a_path_to_follow_are_refused(preset, fields, words):
    with pytest.raises(ValueError, match=words):
        presets.make_config(preset, **fields)


def test_copies_need_a_subspace_and_join_the_training(tmp_path):
    made, groups, _ = make(tmp_path, 'mlp_driven')
    with pytest.raises(ValueError, match='subspace.npz'):
        method._with_copies(made, groups, str(tmp_path))
    synthetic.write_subspace(tmp_path)
    more = method._with_copies(made, groups, str(tmp_path))
    assert len(more[0].position) > len(groups[0].position)
    assert np.isfinite(float(Trainer(made, more).step(0)['loss']))


def test_exports_refuse_a_path_by_name(tmp_path):
    made, (group,), _ = make(tmp_path, 'mlp_driven')
    with pytest.raises(ValueError, match='no memory of the path'):
        step_functions.StepFunctions(made.simulator, made.layout(group.n_rigid), None)
    with pytest.raises(ValueError, match="inputs .*'path', 'start'.* the C form knows"):
        model_data.refuse(made.simulator)


def test_a_body_whose_height_is_predicted_has_no_path_inputs(tmp_path):
    with pytest.raises(ValueError, match='whole motion is given'):
        models.make(tmp_path, motion='driven', overrides={'path_inputs': True})


def test_no_edge_and_no_embedding_exist(tmp_path):
    graph, _, _ = models.make(tmp_path / 'gns')
    names = ' '.join(v.name for v in graph.simulator.trainable_variables)
    assert 'edge' in names and 'embedding' in names
    for model in MODELS:
        made, (group,), _ = make(tmp_path / model, model)
        names = ' '.join(v.name for v in made.simulator.trainable_variables)
        assert 'edge' not in names and 'embedding' not in names
        assert made.layout(group.n_rigid).n_edge == 0


@pytest.mark.parametrize('model', ['mlp', 'mixer_scse'])
def test_training_resumes_and_rolls_out(tmp_path, model):
    """Through the functions of the command line: train, train on, load, evaluate."""
    folder = synthetic.write_dataset(tmp_path / 'data')
    os.remove(dataset.split_path(folder, 'valid'))  # the test runs are rolled out below
    path = str(tmp_path / 'model')
    config = presets.make_config(model, **SHORT)
    registry.train(folder, path, config, save_every=7)
    before = files.read_npz(f'{path}/{checkpoints.WEIGHTS_FILE}')
    registry.train(folder, path, config, save_every=7)
    opened = registry.open_model(path, folder, 'test')
    loaded, metadata, groups = opened.model, opened.metadata, opened.groups
    for variable, stored in zip(loaded.simulator.trainable_variables, before.values()):
        np.testing.assert_array_equal(variable.numpy(), stored)
    _, summary = evaluation.Evaluator(loaded, metadata).run(groups, 'test')
    assert summary['mean']['model']['soil_mse'] > 0
    assert all(row['edges'] == 0 for row in summary['runs']['model'])
    assert np.isfinite(Trainer(loaded, groups).one_step_errors(2)['loss'])
    with pytest.raises(ValueError, match='model=gns contradicts the model'):
        registry.open_model(path, folder, 'test', {'model': 'gns'})
    other = synthetic.write_dataset(tmp_path / 'other', rigid_counts=(6,))
    with pytest.raises(ValueError, match='made for 4 rigid particles and cannot take 6'):
        registry.open_model(path, other, 'test', {})


def test_impossible_choices_are_refused():
    with pytest.raises(ValueError, match="unknown model 'lstm'; there are gns, mlp"):
        presets.make_config('pcg', model='lstm')
    with pytest.raises(ValueError, match="adjacency is 'algorithm2' with model 'mlp'"):
        presets.make_config('pcg', model='mlp')
    with pytest.raises(ValueError, match="adjacency is 'none' with model 'gns'"):
        presets.make_config('pcg', adjacency='none')
    assert presets.preset_of_model('mixer_se') == 'mixer_se'
    assert presets.preset_of_model(None) == presets.preset_of_model('gns') == 'pcg'
    with pytest.raises(ValueError, match='unknown model'):
        presets.preset_of_model('lstm')
