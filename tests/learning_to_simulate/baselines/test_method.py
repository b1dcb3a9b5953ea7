"""The regression on the path through the same command, folders and files as the networks."""

import json
import os
import shutil

import numpy as np
import pytest

import learning_to_simulate as lts
from learning_to_simulate import evaluation, presets, registry
from learning_to_simulate.baselines import method as method_lib
from learning_to_simulate.baselines import path_ridge
from learning_to_simulate.export import exporting
from pca_tools import files
from tests.learning_to_simulate import synthetic


@pytest.fixture(scope='module')
def trained(tmp_path_factory):
    """(data folder, model folder) of a ridge. Not to be changed."""
    folder = tmp_path_factory.mktemp('open_loop')
    data = synthetic.write_dataset(folder / 'data', n_run=6)
    synthetic.write_subspace(data)
    model = str(folder / 'model')
    config = presets.make_config('path_ridge', max_samples=60)
    registry.train(data, model, config)
    return data, model


def test_a_model_folder_rolls_out_to_the_files_of_every_method(trained, tmp_path):
    data, path = trained
    opened = registry.open_model(path, data, 'test')
    results, summary = opened.evaluator.run(opened.groups, 'test')
    evaluation.save_rollouts(str(tmp_path), 'test', results, summary, opened.metadata)
    stored = files.read_npz(str(tmp_path / 'rollout_test_0.npz'))
    assert stored['predicted_rollout'].shape == stored['ground_truth_rollout'].shape
    assert {'predicted_forces', 'status'} <= stored.keys()
    assert summary['soil_mse_over_best_trivial'] < 0.5
    assert 'model' in evaluation.table(summary)
    assert set(opened.one_step_errors()) == {'one_step_position_mse', 'one_step_force_mse'}
    # The API rolls recorded runs out though the folder has no start.
    model, runs = lts.load(path), lts.Dataset(data).test
    rollout = model.rollout(runs[0])
    n = rollout.history.shape[1] - rollout.modes.shape[1]
    np.testing.assert_array_equal(rollout.modes, results[0][2].position[0, :, n:])
    assert rollout.particles(0).shape == (synthetic.N_SOIL, 3)
    with pytest.raises(ValueError, match='path_ridge is a baseline .* no live stepping'):
        model.stepper()


def test_a_second_call_finds_the_model_done_and_another_one_is_refused(trained):
    data, model = trained
    path = os.path.join(model, method_lib.ARRAYS_FILE)
    before = os.stat(path).st_mtime_ns
    registry.train(data, model, presets.make_config('path_ridge', max_samples=60))
    assert os.stat(path).st_mtime_ns == before
    with pytest.raises(ValueError, match='another config'):
        registry.train(data, model, presets.make_config('path_ridge', max_samples=61))
    config, how = presets.make_config('path_ridge', max_samples=60), {'rigid_motion': 'driven'}
    with pytest.raises(ValueError, match='another scene'):
        registry.train(data, model, config, **how)
    with pytest.raises(ValueError, match='has no exported form'):
        exporting.export(model, data, f'{model}_exported', 'savedmodel')


@pytest.mark.parametrize('part', ['scene', 'outputs', 'arrays'])
def test_damaged_folders_are_refused(trained, tmp_path, part):
    copy = shutil.copytree(trained[1], tmp_path / 'copy')
    config = json.loads((copy / 'config.json').read_text())
    if part == 'scene':
        del config['scene']['dt']
    elif part == 'outputs':
        config['method']['outputs']['soil'] = []
    else:
        path = str(copy / method_lib.ARRAYS_FILE)
        arrays = files.read_npz(path)
        files.write_npz(path, **arrays | {'soil/0/scale': arrays['soil/0/scale'][:-1]})
    (copy / 'config.json').write_text(json.dumps(config))
    with pytest.raises(ValueError, match='missing, unknown or wrong'):
        method_lib.load(str(copy))


def test_a_fit_to_the_valid_runs_says_that_they_judge_no_more(
    trained, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(path_ridge, 'GAMMAS', (0.1,))
    monkeypatch.setattr(path_ridge, 'ALPHAS', (1e-6, 1e-3))
    config = presets.make_config('path_ridge_few_runs', max_samples=60)
    registry.train(trained[0], str(tmp_path / 'model'), config)
    printed = capsys.readouterr().out
    assert 'valid was trained on' in printed
    method = method_lib.load(str(tmp_path / 'model')).method
    left_out = min(c['error'] for c in method.choices if c['output'] == 'force')
    assert f'force {left_out:.3g} N' in printed
