"""A soil field as a user trains, opens, judges and steps it; on datasets of a few runs."""

import dataclasses
import shutil
import subprocess

import numpy as np
import pytest
from tensorboard.backend.event_processing import event_accumulator
from tensorboard.util import tensor_util

import learning_to_simulate as lts
from learning_to_simulate import api, checkpoints, registry
from learning_to_simulate.live import roll_out_path
from learning_to_simulate.soil_field import method, samples, training
from pca_tools import files
from tests.learning_to_simulate.native.worlds import needs_c
from tests.learning_to_simulate.soil_field import worlds
from tests.learning_to_simulate.soil_field.scenes import poses

FEW = {'members': 1, 'num_steps': 6}


@pytest.fixture(scope='module')
def folders(tmp_path_factory):
    """Two datasets with runs 5 to 7 and 8 to 10; not to be changed."""
    base = tmp_path_factory.mktemp('soil')
    return [worlds.write_dataset(base / str(first), range(first, first + 3)) for first in (5, 8)]


@pytest.fixture(scope='module')
def model(folders, tmp_path_factory):
    path, data = str(tmp_path_factory.mktemp('model') / 'field'), [lts.Dataset(f) for f in folders]
    return lts.train(lts.preset('soil_field', **FEW), data, path)


def weights(path):
    return files.read_npz(f'{path}/{checkpoints.WEIGHTS_FILE}')


def same(one, other):
    return all((weights(one)[name] == value).all() for name, value in weights(other).items())


def test_a_model_says_what_it_learned_from(model, folders, capsys):
    stored = checkpoints.read_config(model.path)
    assert stored['data']['runs'] == ['cut 5', 'cut 8']
    assert [len(found) for found in stored['data']['sha256']] == [4, 4]
    deepest = max((worlds.TOOL.radius - worlds.path(s)[:, 1]).max() for s in (5, 8))
    assert model.model.ranges['depth'][1] == pytest.approx(deepest, abs=1e-4)
    assert len(model.model.bounds['force']) == 3
    metrics = files.read_json(f'{model.path}/metrics.json')
    assert [row['case'] for row in metrics['runs']['model']] == ['6', '9']
    assert set(metrics['training']) == {'loss_load', 'loss_surface', 'loss_soil'}
    events = event_accumulator.EventAccumulator(model.path).Reload()
    seen = {tag: tensor_util.make_ndarray(events.Tensors(tag)[-1].tensor_proto).item()
            for tag in events.Tags()['tensors']}  # fmt: skip
    mean = metrics['mean']['model']
    for tag, value in (('valid/soil_mm', mean['soil_mm']), ('load/loss', None), ('soil/loss', None),
                       ('valid/force_relative_l2', mean['force_relative_l2'])):  # fmt: skip
        assert seen[tag] == pytest.approx(value, rel=1e-6) if value else seen[tag] > 0
    again = lts.train(model.config, [lts.Dataset(f) for f in folders], model.path)
    assert type(again) is type(model) is type(lts.load(model.path)) is api.TerrainModel
    assert 'persistence' in capsys.readouterr().out
    assert repr(model) == f'<soil field {model.path!r} of a blade>'


def test_a_killed_training_goes_on_to_the_same_weights(model, folders, tmp_path, monkeypatch):
    path, calls, keep = str(tmp_path / 'killed'), [], method.Saved.keep
    read = method.runs_lib.read_all
    monkeypatch.setattr(
        method.runs_lib, 'read_all', lambda f, s, **more: read(f, s) if s == 'train' else []
    )

    def killed(saved, name, step, *rest):
        keep(saved, name, step, *rest)
        calls.append((name, step))
        if len(calls) == 15:  # within the second network
            raise KeyboardInterrupt

    monkeypatch.setattr(method.Saved, 'keep', killed)
    with pytest.raises(KeyboardInterrupt):
        registry.train(','.join(folders), path, model.config, save_every=2)
    stored = files.read_npz(f'{path}/training.npz')
    assert (stored['load/step'], stored['surface/step']) == (12, 2)
    with pytest.raises(ValueError, match='with other settings or data'):
        other = dataclasses.replace(model.config, seed=1)
        registry.train(','.join(folders), path, other, save_every=2)
    registry.train(','.join(folders), path, model.config, save_every=2)
    assert calls[15] == ('surface', 3) and calls.count(('load', 12)) == 1
    assert same(path, model.path) and not (tmp_path / 'killed' / 'training.npz').exists()


def test_a_training_goes_on_from_the_same_first_weights_alone(model, folders, tmp_path):
    path, own = str(tmp_path / 'next'), registry.train
    made = own(folders[0], path, model.config, initial_weights=model.path)
    assert made['training'] and not same(path, model.path)
    assert own(folders[0], path, model.config, initial_weights=model.path) == made
    with pytest.raises(ValueError, match='initial_weights'):
        own(folders[0], path, model.config, initial_weights=path)
    with pytest.raises(ValueError, match='for a soil field, not for mlp'):
        own(folders[0], path, lts.preset('mlp'), initial_weights=model.path)


def test_evaluations_of_several_datasets_are_one(model, folders):
    splits = [lts.Dataset(folder).test for folder in folders]
    whole = model.evaluate(splits)
    rows = whole.summary['runs']['model']
    assert [(row['record'], row['case']) for row in rows] == [(0, '7'), (1, '10')]
    recorded = model.rollout(splits[1][0])
    off = (recorded.force - recorded.run.force)[6:]
    share = np.linalg.norm(off) / np.linalg.norm(recorded.run.force[6:])
    assert share == pytest.approx(rows[1]['force_relative_l2'])
    with pytest.raises(ValueError, match='run 10 does not record what moved its tool'):
        model.rollout(splits[1][0], under_load=True)
    with pytest.raises(ValueError, match='has its own terrain'):
        model.rollout(splits[1][0], lts.Terrain.flat((1, 1)))
    with pytest.raises(ValueError, match='some of one name'):
        model.evaluate([splits[0], lts.Dataset(folders[0]).valid])


def test_files_of_an_evaluation_hold_the_rollouts(model, folders, tmp_path):
    from learning_to_simulate import evaluation

    opened = registry.open_model(model.path, folders[0], 'test', {'members': 1})
    assert set(opened.one_step_errors()) == {'one_step_force_mse', 'one_step_torque_mse'}
    results, summary = opened.evaluator.run(opened.groups, 'test')
    path = str(tmp_path / 'rollouts')
    evaluation.save_rollouts(path, 'test', results, summary, opened.metadata, 'digest')
    stored = files.read_npz(f'{path}/rollout_test_0.npz')
    assert (stored['ground_truth_forces'] == opened.groups[0].force).all()
    assert str(stored['case']) == '7' and str(stored['model_digest']) == 'digest'
    assert files.read_json(f'{path}/metrics.json')['method'] == 'soil_field'


def test_one_step_errors_are_of_the_mean_of_the_members():
    field = training.make_field(worlds.CONFIG, 'blade', worlds.SMALL)
    runs, squares = [worlds.run(3), worlds.run(4)], []
    for run in runs:
        first, second = field.loads(samples.episode_of(run).frames) * run.tool.units(run.soil)
        said = (first + second) / 2 * [-1, 1, -1, -1, 1, -1]  # along is -x, across is -z
        off = said - np.concatenate([run.force, run.torque], axis=1)
        squares.append([np.mean(off[:, :3] ** 2), np.mean(off[:, 3:] ** 2)])
    found = method._one_step_errors(field, runs)
    assert list(found.values()) == pytest.approx(np.mean(squares, axis=0), rel=1e-5)


@needs_c
def test_a_model_goes_to_c(model, folders, tmp_path):
    path = tmp_path / 'c'
    found = model.export(str(path), lts.Dataset(folders[0]), 'c')
    assert found['compared']['relative_difference']['force'] < 1e-4
    assert found['compared']['heights_difference_m'] < 1e-6 and found['tool'] == 'blade'
    if shutil.which('c++'):
        parts = [str(p) for p in (path / 'src').glob('*.c')]
        build = ['cc', '-O1', '-c', f'-I{path}/include', *parts]
        assert not subprocess.run(build, cwd=path).returncode
        objects = [str(p) for p in path.glob('*.o')]
        build = ['c++', f'-I{path}/include', str(path / 'examples/example.cpp'), *objects]
        assert not subprocess.run([*build, '-o', 'example', '-lm'], cwd=path).returncode
        done = subprocess.run([path / 'example'], capture_output=True, text=True)
        assert done.returncode == 0 and 'heights from -0.0' in done.stdout, done.stderr


def test_a_tool_works_on_a_given_terrain(model, tmp_path):
    ground = lts.Terrain.flat((2.0, 1.0), corner=(-1.4, -0.5))
    path = worlds.path(7)
    live = model.stepper(ground.clone(), lts.Blade(0.3))
    live.start(poses(path)[0])
    frames = [live.step(pose) for pose in poses(path)[1:]]
    made = model.rollout(poses(path), ground.clone(), lts.Blade(0.3))
    assert (made.force[1:] == [frame.force for frame in frames]).all()
    # (x, height, angle about +z) in the middle of the terrain is the same path.
    plane = np.stack([-path[:, 0], path[:, 1], -path[:, 2]], axis=1)
    short = model.rollout(plane, ground.clone(), lts.Blade(0.3))
    np.testing.assert_allclose(short.force, made.force, atol=1e-4)
    for call, message in (
        (lambda: model.stepper('flat'), 'an lts.Terrain was expected'),
        (lambda: model.stepper(), r'is None: .* model.stepper\(lts.Terrain.flat\('),
        (lambda: model.stepper(ground, lts.Wheel()), 'knows a blade, not a wheel'),
        (lambda: model.rollout(plane), 'an lts.Terrain was expected'),
        (lambda: model.rollout(plane[:, :2], ground), 'path has shape'),
        (lambda: model.rollout(plane, ground, under_load=True), 'lts.LoadedTool moves others'),
        (lambda: model.scene, 'has no scene'),
        (lambda: model.starts, 'begins on a terrain'),
        (lambda: model.export(str(tmp_path / 'x'), lts.Dataset('excavation')), 'format=c and fmu'),
    ):
        with pytest.raises(ValueError, match=message):
            call()


def test_the_command_rolls_out_a_path_on_a_terrain(model, tmp_path, capsys):
    lts.Terrain.flat((2.0, 1.0), corner=(-1.4, -0.5)).save(str(tmp_path / 'ground.npz'))
    np.savetxt(tmp_path / 'path.csv', poses(worlds.path(7)), delimiter=',')

    class Flags:
        model, poses = '', str(tmp_path / 'path.csv')
        output_path, picture = str(tmp_path / 'dig.npz'), None
        case, terrain, tool = None, str(tmp_path / 'ground.npz'), ['width=0.3']

    Flags.model = model_path = model.path
    roll_out_path.run(Flags)
    assert '49 frames of 0.01667 s' in capsys.readouterr().out
    assert (files.read_npz(Flags.output_path)['predicted_heights'].shape[1:]) == (100, 50)
    Flags.tool = ['depth=1']
    with pytest.raises(ValueError, match='--tool=depth=1.*names are width, radius'):
        roll_out_path.run(Flags)
    Flags.terrain = None
    with pytest.raises(ValueError, match=f'{model_path} is a soil field: it takes --terrain'):
        roll_out_path.run(Flags)


def test_what_does_not_fit_is_refused_before_anything_is_written(model, folders, tmp_path):
    def without_heights(values):
        del values['heights']
        return values

    def of_a_wheel(values):
        values['parameters']['diameter_m'] = 0.2
        return values

    flat = worlds.write_dataset(tmp_path / 'flat', range(3), without_heights)
    wheel = worlds.write_dataset(tmp_path / 'wheel', range(3), of_a_wheel)
    path, config = str(tmp_path / 'model'), model.config
    for data, kind, message in (
        (flat, FileNotFoundError, 'this dataset holds no height map'),
        (f'{folders[0]},{wheel}', ValueError, 'runs of blade and wheel; a soil field knows one'),
        (f'{folders[0]},{tmp_path}/none', FileNotFoundError, 'none'),
    ):
        with pytest.raises(kind, match=message):
            registry.train(data, path, config)
    with pytest.raises(ValueError, match='takes no --rigid_motion'):
        registry.train(folders[0], path, config, rigid_motion='driven')
    with pytest.raises(ValueError, match='other models take records'):
        registry.train(folders[0], path, config, raw_path='raw')
    assert not (tmp_path / 'model' / 'config.json').exists()
    with pytest.raises(ValueError, match='runs of a wheel, the model in .* knows a blade'):
        registry.open_model(model.path, wheel, 'test')
    with pytest.raises(FileNotFoundError, match='this dataset holds no height map'):
        registry.open_model(model.path, flat, 'test')
    with pytest.raises(ValueError, match='--members=2 contradicts the model'):
        registry.open_model(model.path, folders[0], 'test', {'members': 2})
    with pytest.raises(ValueError, match='holds a model of another data'):
        registry.train(folders[0], model.path, config)
