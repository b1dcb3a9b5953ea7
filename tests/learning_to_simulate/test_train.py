"""The command line as a user runs it, and what it refuses."""

import json
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from learning_to_simulate import checkpoints, evaluation, presets, registry, rollout
from learning_to_simulate.rollout_status import RolloutStatus
from learning_to_simulate.subspace import subspace_model
from learning_to_simulate.subspace.trainer import Trainer
from pca_tools import dataset, files
from tests.learning_to_simulate import models, synthetic
from tests.pca_tools.commands import call_command

ROOT = pathlib.Path(__file__).resolve().parents[2]
# Few operations, which take long to compile.
SHORT = {
    'latent_size': 8, 'hidden_layers': 1, 'num_steps': 8, 'unroll_steps': 2, 'unroll_length': 2,
    'mode_edges': 5,
}  # fmt: skip


def command(*args):
    return [sys.executable, '-m', 'learning_to_simulate.train', '--num_threads=1', *args]


@pytest.fixture(scope='module')
def data(tmp_path_factory):
    return synthetic.write_dataset(tmp_path_factory.mktemp('data'), rigid_counts=(4, 6))


@pytest.fixture(scope='module')
def trained(data, tmp_path_factory):
    """A model trained for a few steps in this process. Not to be changed."""
    path = str(tmp_path_factory.mktemp('model') / 'pcg')
    with models.eagerly():
        registry.train(data, path, presets.make_config('pcg', **SHORT), save_every=3)
    return path


def weights(path):
    return files.read_npz(f'{path}/{checkpoints.WEIGHTS_FILE}')


@pytest.mark.xla
def test_short_training_beats_the_trivial_predictors(tmp_path):
    """The synthetic soil follows the body by a linear law, so 300 steps suffice: 0.1 of
    trivial."""
    folder = synthetic.write_dataset(tmp_path / 'data', n_run=8)
    settings = {'num_steps': 300, 'unroll_steps': 0, 'latent_size': 32, 'learning_rate': 3e-3}
    config = presets.make_config('pcg', mode_edges=5, **settings)
    summary = registry.train(folder, str(tmp_path / 'model'), config, save_every=300)
    assert summary['soil_mse_over_best_trivial'] < 0.5


def test_rollout_command_writes_results_that_agree(data, trained, tmp_path):
    out = tmp_path / 'rollouts'
    done = call_command(
        'learning_to_simulate.train', '--mode=eval_rollout', '--eval_split=test',
        f'--data_path={data}', f'--model_path={trained}', f'--output_path={out}',
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
        off = (values['predicted_rollout'] - values['ground_truth_rollout'])[:, n_rigid:]
        errors.append((off.astype(float) ** 2).sum(axis=(1, 2)).mean() / (3 * synthetic.N_SOIL))
        # Files hold float32 positions of up to 9 m: 1e-6 m of round-off.
        assert row['soil_mse'] == pytest.approx(errors[-1], rel=1e-2, abs=1e-12)
        assert row['status'] != 'non_finite'
    assert summary['mean']['model']['soil_mse'] == pytest.approx(np.mean(errors), rel=1e-2)


@pytest.mark.xla
def test_killed_training_resumes_to_the_same_weights(tmp_path):
    """SIGKILL after a checkpoint, then the same command again: bit-equal to the run without a
    kill. The network that is compiled soonest, one stage and no validation."""
    data = synthetic.write_dataset(tmp_path / 'data')
    os.remove(dataset.split_path(data, 'valid'))
    settings = {'latent_size': 4, 'num_steps': 400, 'unroll_steps': 0}
    path, straight = tmp_path / 'killed', str(tmp_path / 'straight')
    flags = ['--preset=mlp', *(f'--set={k}={v}' for k, v in settings.items())]
    args = (f'--data_path={data}', f'--model_path={path}', '--save_every=50', *flags)
    process = subprocess.Popen(
        command(*args), cwd=ROOT, stderr=subprocess.PIPE, stdout=subprocess.PIPE
    )
    while not list(path.glob('ckpt-*.npz')) and process.poll() is None:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert not (path / 'ckpt-400.npz').exists()
    done = call_command('learning_to_simulate.train', *args)
    assert done.returncode == 0 and 'resumed' in done.stdout, done.stderr
    registry.train(data, straight, presets.make_config('mlp', **settings), save_every=400)
    for name, value in weights(straight).items():
        np.testing.assert_array_equal(weights(path)[name], value)


def test_the_averages_are_what_is_saved(trained):
    """And not the weights that the last step left, which the checkpoint holds beside them."""
    stored = weights(trained)
    checkpoint = files.read_npz(f'{trained}/ckpt-{SHORT["num_steps"]}.npz')
    for i, (name, value) in enumerate(stored.items()):
        np.testing.assert_array_equal(value, checkpoint[f'average/{i}'])
        if 'embedding' in name:
            assert np.abs(value - checkpoint[f'weight/{i}']).max() > 0


def test_model_folder_of_something_else_is_refused_and_left_alone(data, trained, tmp_path):
    path = tmp_path / 'model'
    shutil.copytree(trained, path)
    before = {p.name: p.read_bytes() for p in path.iterdir()}
    other = presets.make_config('pcg', **SHORT | {'latent_size': 4})
    with pytest.raises(ValueError, match='another config .*latent_size: 8 there, 4 now'):
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


def test_bad_input_is_a_message_and_not_a_traceback(data, trained, tmp_path):
    """Missing data; a flag that contradicts the model."""
    contradicts = f'contradicts the model in {trained}, which has prescribed: '
    given = f'--data_path={data}', f'--model_path={trained}', '--rigid_motion=driven'
    done = call_command('learning_to_simulate.train', '--mode=eval', *given)
    assert done.returncode != 0 and 'Traceback' not in done.stderr
    assert f'--rigid_motion=driven {contradicts}' in done.stderr
    with pytest.raises(FileNotFoundError, match='no such dataset folder'):
        registry.train(str(tmp_path / 'gone'), str(tmp_path / 'new'), presets.make_config('pcg'))
    assert not (tmp_path / 'new').exists()


def test_bad_training_input_is_refused_before_anything_is_written(data, tmp_path):
    np.save(tmp_path / 'mask.npy', np.eye(5, dtype=bool))
    for message, overrides in (
        ('5 x 5.*7 nodes', {'adjacency': str(tmp_path / 'mask.npy')}),
        ('shorter than the training window', {'unroll_length': 100}),
    ):
        config = presets.make_config('pcg', **SHORT | overrides)
        with pytest.raises(ValueError, match=message):
            registry.train(data, str(tmp_path / 'new'), config)
        assert not (tmp_path / 'new').exists()


def test_bad_evaluation_input_is_refused(data, trained, tmp_path):
    with pytest.raises(FileNotFoundError, match='holds no model'):
        registry.open_model(str(tmp_path), data, 'test', {})
    with pytest.raises(ValueError, match='--raw_path is for --model=full_space only'):
        registry.open_model(trained, data, 'test', raw_path='raw')
    for field, message in (
        ('noise_std', 'contradicts the model'), ('members', 'is no setting'),
        ('preset', '--preset=0.1 contradicts the model in .*, which has pcg: '),
    ):  # fmt: skip
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


def test_number_of_steps_is_that_of_both_stages():
    config = presets.make_config('pcg', num_steps=300)
    assert (config.single_steps, config.unroll_steps) == (180, 120)
    assert presets.make_config('pcg', num_steps=300, unroll_steps=50).single_steps == 250


def test_steps_between_checkpoints():
    """A tenth of all, 100 at least, or what is asked for."""
    for num_steps, save_every, expected in ((8000, None, 800), (300, None, 100), (8000, 3, 3)):
        options = registry.TrainOptions(save_every=save_every)
        assert options.steps_between_saves(num_steps) == expected


def test_validation_rollout_that_blows_up_does_not_stop_training(data, tmp_path, monkeypatch):
    """Its errors have no number in the summary; the weights are saved all the same. It is judged on
    valid runs, which are in no batch, by the limit of the force that lies beside the weights."""
    trained_on, limits = [], set()

    def blown_up(self, group):
        limits.add(self._force_limit)
        nothing, status = np.full_like(group.position[:, 6:], np.nan), RolloutStatus.NON_FINITE
        return rollout.Rollout(nothing, group.force[:, 6:], [rollout.Judgement(status)], 1.0)

    def noting(self, model, groups, make=Trainer.__init__):
        trained_on.extend(groups)
        make(self, model, groups)

    monkeypatch.setattr(evaluation.Evaluator, 'roll_out', blown_up)
    monkeypatch.setattr(Trainer, '__init__', noting)
    config = presets.make_config('pcg', **SHORT | {'num_steps': 3, 'unroll_steps': 0})
    with models.eagerly():
        summary = registry.train(data, str(tmp_path / 'model'), config, save_every=3)
    assert summary['mean']['model']['soil_mse'] is None
    subspace_model.load(str(tmp_path / 'model'))
    runs = dataset.read_split(data, 'train')
    largest = max(np.linalg.norm(run.force, axis=1).max() for run in runs)
    assert list(limits) == [pytest.approx(largest)]
    assert sum(len(group.position) for group in trained_on) == len(runs)
    for group in trained_on:
        for record, position in zip(group.record, group.position):
            np.testing.assert_array_equal(position, runs[record].position)
