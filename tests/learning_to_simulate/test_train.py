"""The command line as a user runs it, and what it refuses."""

import json
import pathlib
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate import checkpoints, evaluation, presets, registry
from learning_to_simulate.subspace import subspace_model
from learning_to_simulate.subspace.trainer import Trainer
from pca_tools import files
from tests.learning_to_simulate import synthetic

ROOT = pathlib.Path(__file__).resolve().parents[2]
SHORT = {'latent_size': 16, 'num_steps': 30, 'unroll_steps': 6, 'unroll_length': 2, 'mode_edges': 5}


def command(*args):
    return [sys.executable, '-m', 'learning_to_simulate.train', '--num_threads=1', *args]


def run(*args):
    """Runs the command line; returns the finished process."""
    return subprocess.run(command(*args), cwd=ROOT, capture_output=True, text=True)


@pytest.fixture(scope='module')
def data(tmp_path_factory):
    return synthetic.write_dataset(tmp_path_factory.mktemp('data'), rigid_counts=(4, 6))


@pytest.fixture(scope='module')
def trained(data, tmp_path_factory):
    """A model trained for a few steps in this process. Not to be changed."""
    path = str(tmp_path_factory.mktemp('model') / 'pcg')
    registry.train(data, path, presets.make_config('pcg', **SHORT), save_every=12)
    return path


def test_short_training_beats_the_trivial_predictors(tmp_path):
    """The synthetic soil follows the body by a linear law, so 600 steps suffice: 0.05 of
    trivial."""
    folder = synthetic.write_dataset(tmp_path / 'data', n_run=8)
    config = presets.make_config(
        'pcg',
        **SHORT | {'num_steps': 600, 'unroll_steps': 0, 'latent_size': 32, 'learning_rate': 3e-3},
    )
    summary = registry.train(folder, str(tmp_path / 'model'), config, save_every=600)
    assert summary['soil_mse_over_best_trivial'] < 0.5


def test_rollout_command_writes_results_that_agree(data, trained, tmp_path):
    out = tmp_path / 'rollouts'
    done = run(
        '--mode=eval_rollout', '--eval_split=test', f'--data_path={data}',
        f'--model_path={trained}', f'--output_path={out}',
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert 'constant velocity' in done.stdout and 'ms per frame' in done.stdout
    summary = json.loads((out / 'metrics.json').read_text())
    errors = []
    for i, (row, size) in enumerate(zip(summary['runs']['model'], (4, 6), strict=True)):
        values = files.read_npz(str(out / f'rollout_test_{i}.npz'))
        n_rigid = (values['particle_types'] != 6).sum()
        assert n_rigid == size
        assert values['initial_positions'].shape == (6, n_rigid + synthetic.N_MODES, 3)
        assert values['predicted_forces'].shape == (synthetic.N_FRAMES - 6, 3)
        difference = (values['predicted_rollout'] - values['ground_truth_rollout'])[:, n_rigid:]
        errors.append(
            (difference.astype(float) ** 2).sum(axis=(1, 2)).mean() / (3 * synthetic.N_SOIL)
        )
        # Files hold float32 positions of up to 9 m: 1e-6 m of round-off.
        assert row['soil_mse'] == pytest.approx(errors[-1], rel=1e-2, abs=1e-12)
        assert row['status'] != 'non_finite'
    assert summary['mean']['model']['soil_mse'] == pytest.approx(np.mean(errors), rel=1e-2)


def test_killed_training_resumes_to_the_same_weights(data, trained, tmp_path):
    """SIGKILL after a checkpoint, then the same command again: bit-equal to the run without a
    kill."""
    path = tmp_path / 'killed'
    flags = [f'--set={k}={v}' for k, v in SHORT.items()]
    args = (f'--data_path={data}', f'--model_path={path}', '--save_every=12', *flags)
    process = subprocess.Popen(
        command(*args), cwd=ROOT, stderr=subprocess.PIPE, stdout=subprocess.PIPE
    )
    for _ in range(600):
        if list(path.glob('ckpt-12.index')) or process.poll() is not None:
            break
        time.sleep(0.1)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    done = run(*args)
    assert done.returncode == 0, done.stderr
    weights, straight = (files.read_npz(f'{p}/{checkpoints.WEIGHTS_FILE}') for p in (path, trained))
    for name in straight:
        np.testing.assert_array_equal(weights[name], straight[name])


def test_the_averages_are_what_is_saved(trained):
    """And not the weights that the last step left, which the checkpoint holds beside them."""
    weights = files.read_npz(f'{trained}/{checkpoints.WEIGHTS_FILE}')
    checkpoint = tf.train.load_checkpoint(f'{trained}/ckpt-{SHORT["num_steps"]}')
    for i, value in enumerate(weights.values()):
        average = checkpoint.get_tensor(f'averages/{i}/.ATTRIBUTES/VARIABLE_VALUE')
        np.testing.assert_array_equal(value, average)
    last = checkpoint.get_tensor('simulator/_embedding/.ATTRIBUTES/VARIABLE_VALUE')
    (stored,) = (v for k, v in weights.items() if 'embedding' in k)
    assert np.abs(stored - last).max() > 0


def test_model_folder_of_something_else_is_refused_and_left_alone(data, trained, tmp_path):
    path = tmp_path / 'model'
    shutil.copytree(trained, path)
    before = {p.name: p.read_bytes() for p in path.iterdir()}
    other = presets.make_config('pcg', **SHORT | {'latent_size': 8})
    with pytest.raises(ValueError, match='another config .*latent_size: 16 there, 8 now'):
        registry.train(data, str(path), other)
    assert {p.name: p.read_bytes() for p in path.iterdir()} == before
    (tmp_path / 'full').mkdir()
    (tmp_path / 'full' / 'thesis.txt').write_text('mine')
    with pytest.raises(ValueError, match='not empty and not a model folder'):
        registry.train(data, str(tmp_path / 'full'), other)
    assert [p.name for p in (tmp_path / 'full').iterdir()] == ['thesis.txt']


def test_exported_weights_are_not_mistaken_for_a_training_state(data, trained, tmp_path):
    for name in (checkpoints.CONFIG_FILE, checkpoints.WEIGHTS_FILE):
        shutil.copy(f'{trained}/{name}', tmp_path)
    subspace_model.load(str(tmp_path))
    with pytest.raises(ValueError, match='without training state'):
        registry.train(data, str(tmp_path), presets.make_config('pcg', **SHORT))


def test_bad_input_is_a_message_and_not_a_traceback(data, tmp_path):
    done = run(f'--data_path={tmp_path / "gone"}', f'--model_path={tmp_path / "new"}')
    assert done.returncode != 0
    assert 'no such dataset folder' in done.stderr and 'Traceback' not in done.stderr
    assert not (tmp_path / 'new').exists()


def test_bad_training_input_is_refused_before_anything_is_written(data, tmp_path):
    pointer = tmp_path / 'pointer'
    shutil.copytree(data, pointer)
    (pointer / 'train.tfrecord').write_text(
        'version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n'
    )
    cut = tmp_path / 'cut'
    shutil.copytree(data, cut)
    (cut / 'train.tfrecord').write_bytes((cut / 'train.tfrecord').read_bytes()[:-100])
    np.save(tmp_path / 'mask.npy', np.eye(5, dtype=bool))
    mask = {'adjacency': str(tmp_path / 'mask.npy')}
    too_long = {'unroll_length': 100}
    for message, folder, overrides in (
        ('git-lfs', pointer, {}),
        ('truncated|cut|ends', cut, {}),
        ('5 x 5.*7 nodes', data, mask),
        ('shorter than the training window', data, too_long),
    ):
        config = presets.make_config('pcg', **SHORT | overrides)
        with pytest.raises(ValueError, match=message):
            registry.train(str(folder), str(tmp_path / 'new'), config)
        assert not (tmp_path / 'new').exists()
    with pytest.raises(ValueError, match='unknown preset'):
        presets.make_config('gns')
    for preset, model in (('mlp', 'path_ridge'), ('swept_field', 'mlp'), ('path_ridge', 'gns')):
        with pytest.raises(ValueError, match=f"preset '{preset}' is one of .*, not of '{model}'"):
            presets.make_config(preset, model=model)
    assert presets.make_config('mixer_se', model='mixer_scse').model == 'mixer_scse'


def test_bad_evaluation_input_is_refused(data, trained, tmp_path):
    with pytest.raises(FileNotFoundError, match='holds no model'):
        registry.open_model(str(tmp_path), data, 'test', {})
    with pytest.raises(ValueError, match='--raw_path is for --model=full_space only'):
        registry.open_model(trained, data, 'test', raw_path='raw')
    for field, message in (('noise_std', 'contradicts the model'), ('members', 'is no setting')):
        with pytest.raises(ValueError, match=message):
            registry.open_model(trained, data, 'test', {field: 0.1})
    refit = synthetic.write_dataset(tmp_path / 'refit')
    metadata = files.read_json(f'{refit}/metadata.json')
    files.write_json(f'{refit}/metadata.json', metadata | {'pca': {'digest': 'f' * 64}})
    model = shutil.copytree(trained, tmp_path / 'model')
    config = files.read_json(str(model / 'config.json'))
    config['data']['subspace'] = '0' * 64
    files.write_json(str(model / 'config.json'), config)
    with pytest.raises(ValueError, match='subspace ffffffffffff.*modes of 000000000000'):
        registry.open_model(str(model), refit, 'test', {})
    other = synthetic.write_dataset(tmp_path / 'other', force=False)
    with pytest.raises(ValueError, match='lacks rigid_body_force_mean'):
        registry.open_model(trained, other, 'test', {})


@pytest.mark.parametrize(
    'flag, stored', [('--preset=mlp', 'pcg'), ('--rigid_motion=driven', 'prescribed')]
)
def test_flags_that_contradict_the_model_are_refused(data, trained, flag, stored):
    done = run('--mode=eval', f'--data_path={data}', f'--model_path={trained}', flag)
    assert done.returncode != 0 and 'Traceback' not in done.stderr
    assert f'{flag} contradicts the model in {trained}, which has {stored}: ' in done.stderr


def test_one_step_errors_are_those_of_the_rollouts_first_frame(data, trained):
    """Windows over all of a split, so only the size can agree: within a factor of ten."""
    opened = registry.open_model(trained, data, 'valid')
    model, metadata, groups = opened.model, opened.metadata, opened.groups
    errors = Trainer(model, groups).one_step_errors(n_batch=3)
    results, _ = evaluation.Evaluator(model, metadata).run(groups, 'valid')
    first = [
        ((rollout.position[0, 0] - group.position[0, 6])[group.n_rigid :] ** 2).mean()
        for _, group, rollout in results
    ]
    assert 0.1 < errors['one_step_position_mse'] / np.mean(first) < 10
    assert errors['loss'] == pytest.approx(errors['loss_mse'] + errors['loss_force_mse'])


@pytest.mark.parametrize('damage', ['shape', 'nan', 'missing'])
def test_damaged_weights_are_refused(trained, tmp_path, damage):
    shutil.copy(f'{trained}/{checkpoints.CONFIG_FILE}', tmp_path)
    values = files.read_npz(f'{trained}/{checkpoints.WEIGHTS_FILE}')
    name = next(iter(values))
    if damage == 'shape':
        values[name] = values[name][:-1]
    elif damage == 'nan':
        values[name] = np.full_like(values[name], np.nan)
    else:
        del values[name]
    files.write_npz(str(tmp_path / checkpoints.WEIGHTS_FILE), **values)
    with pytest.raises(ValueError, match='not finite' if damage == 'nan' else 'not the weights'):
        subspace_model.load(str(tmp_path))


def test_number_of_steps_is_that_of_both_stages():
    config = presets.make_config('pcg', num_steps=300)
    assert (config.single_steps, config.unroll_steps) == (180, 120)
    assert presets.make_config('pcg', num_steps=300, unroll_steps=50).single_steps == 250
    with pytest.raises(ValueError, match='unroll_steps is 50, more than all 30'):
        presets.make_config('pcg', num_steps=30, unroll_steps=50)


def test_impossible_settings_are_refused():
    for name, value in (
        ('rate_scaled', True),
        ('weight_average', 1.0),
        ('mode_order', 3),
        ('batch_size', 0),
    ):
        overrides = {name: value} | ({'mode_order': 2} if name == 'rate_scaled' else {})
        with pytest.raises(ValueError, match=name):
            presets.make_config('pcg', **overrides)


def test_validation_rollout_that_blows_up_does_not_stop_training(data, tmp_path, monkeypatch):
    """Its errors have no number in the summary; the weights are saved all the same."""
    whole = evaluation.Evaluator.roll_out

    def blown_up(self, group):
        rollout = whole(self, group)
        return rollout._replace(position=np.full_like(rollout.position, np.nan))

    monkeypatch.setattr(evaluation.Evaluator, 'roll_out', blown_up)
    config = presets.make_config('pcg', **SHORT | {'num_steps': 3, 'unroll_steps': 0})
    summary = registry.train(data, str(tmp_path / 'model'), config, save_every=3)
    assert summary['mean']['model']['soil_mse'] is None
    subspace_model.load(str(tmp_path / 'model'))
