"""Training, evaluation and files of the method on a small dataset of made-up soil."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from learning_to_simulate.methods import registry
from learning_to_simulate.methods.swept_field import fitting, method, settings
from learning_to_simulate.methods.swept_field.live import LiveField
from pca_tools import convert, dataset, files, raw_writer
from reports.protocol import rollouts
from tests.learning_to_simulate.methods.swept_field import small_world as world

SMALL = {
    'members': 2, 'latent_size': 16, 'hidden_layers': 2, 'force_latent_size': 16,
    'num_steps': 150, 'batch_size': 32, 'particles_per_frame': 32, 'start_every': 40,
}  # fmt: skip


def made_up_run(depth, split):
    """Soil above the deepest cut goes along with the blade; the force is that of a depth."""
    plane = world.path(depth=depth)
    frames = world.frames(plane)
    points = world.bed_points()
    local = world.AXES.points(points)
    u = local[:, 0] - plane[0, 0, 0]
    cut = np.stack([np.interp(u, world.GRID.offsets, b[:, 0]) for b in frames.bins])
    went = np.clip(frames.scalars[:, :1] - u, 0.0, 0.1)
    share = np.clip((cut - (world.SURFACE - local[:, 1])) / 0.03, 0.0, 1.0)
    moved = np.zeros((len(plane), len(points), 3))
    moved[..., 0], moved[..., 1] = share * went, 0.2 * share * went
    below = np.clip(world.SURFACE - plane[:, 0, 1] + world.BLADE.radius, 0, None)
    load = np.stack([-3e4 * below**2, 5e3 * below**2, 10 * below], axis=1)
    force, torque = world.AXES.world_loads(load)
    pose = world.world_pose(plane[:, 0])
    body = np.array([[-0.014, y, z] for y in (0.0, 0.1, 0.2) for z in (-0.2, 0.0, 0.2)])
    return {
        'positions': points + world.AXES.world(moved),
        'rigid_positions': pose[:, None, :3] + body,
        'force': force, 'torque': torque, 'pose': pose, 'split': split, 'kind': 'made_up',
        'parameters': {'blade_width_m': 0.457},
    }  # fmt: skip


@pytest.fixture(scope='module')
def data_path(tmp_path_factory):
    folder = tmp_path_factory.mktemp('made_up')
    depths = [(0.03, 'train'), (0.045, 'train'), (0.06, 'train'), (0.04, 'valid'), (0.05, 'test')]
    raw_writer.write_raw(
        str(folder / 'raw'),
        [made_up_run(*pair) for pair in depths],
        world.DT,
        up_axis=1,
        body='prescribed',
    )
    convert.convert(str(folder / 'raw'), str(folder / 'data'), modes=2)
    return str(folder / 'data')


@pytest.fixture(scope='module')
def model_path(data_path, tmp_path_factory):
    path = str(tmp_path_factory.mktemp('model') / 'field')
    config = settings.SweptFieldConfig('swept_field', **SMALL)
    registry.train(data_path, path, config)
    return path


def test_training_learns_soil_and_force(data_path, model_path):
    summary = files.read_json(os.path.join(model_path, 'metrics.json'))
    (run,) = summary['field']
    assert run['soil_mm'] < 0.5 * run['still_mm']
    assert run['force_l2'] < 0.5
    assert run['air_force_N'] < 1.0
    assert summary['training']['runs'] == 3 and summary['training']['episodes'] > 3
    assert summary['reliability']['soil']['factor_of_this_split'] > 0
    # What is said to rest does so in the training runs.
    assert summary['training']['left_out_share'] > 0.3
    assert summary['training']['left_out_motion'] < 1e-3


def test_rollouts_are_written_as_the_protocol_reads_them(data_path, model_path, tmp_path):
    """Through the command, for `reports.protocol`: particles, force and torque of the test run."""
    done = subprocess.run(
        [sys.executable, '-m', 'learning_to_simulate.train', '--mode=eval_rollout',
         f'--data_path={data_path}', f'--model_path={model_path}', '--eval_split=test',
         f'--output_path={tmp_path}'],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    metadata = dataset.read_metadata(data_path)
    (prediction,) = rollouts.read(str(tmp_path), 'test', 1, metadata)
    summary = json.loads((tmp_path / 'metrics.json').read_text())
    sample = method._evaluator(
        method.load(model_path).field, data_path, metadata, 'test', np.zeros(3)
    )._reader.sample('test')  # fmt: skip
    frames = np.arange(8, 61, 4)
    truth = sample[0][frames // 4]
    predicted = prediction.particles(frames, np.asarray(sample.indices))
    error = 1e3 * np.sqrt(((predicted - truth) ** 2).mean())
    assert error == pytest.approx(summary['field'][0]['soil_mm'], rel=1e-3)
    run = dataset.read_split(data_path, 'test')[0]
    for found, recorded in ((prediction.force, run.force), (prediction.torque, run.torque)):
        relative = np.linalg.norm(found - recorded[6:]) / np.linalg.norm(recorded[6:])
        assert relative < 0.6
    # The modes in the file, for pictures, are those of the particles.
    assert summary['mean']['model']['soil_rms_mm'] < summary['mean']['stay_still']['soil_rms_mm']


def test_a_second_call_finds_it_done_and_other_settings_are_refused(data_path, model_path):
    before = files.sha256_of_file(os.path.join(model_path, 'weights.npz'))
    config = settings.SweptFieldConfig('swept_field', **SMALL)
    registry.train(data_path, model_path, config)
    assert files.sha256_of_file(os.path.join(model_path, 'weights.npz')) == before
    other = settings.SweptFieldConfig('swept_field', **(SMALL | {'num_steps': 7}))
    with pytest.raises(ValueError, match='another config'):
        registry.train(data_path, model_path, other)
    with pytest.raises(ValueError, match='contradicts'):
        method.open_model(model_path, data_path, 'test', {'members': 1})


def test_training_is_the_same_again(data_path):
    config = settings.SweptFieldConfig('swept_field', **(SMALL | {'num_steps': 5}))
    metadata = dataset.read_metadata(data_path)
    one, other = (fitting.fit(config, data_path, metadata)[0] for _ in range(2))
    for a, b in zip(one.network.trainable_variables, other.network.trainable_variables):
        np.testing.assert_array_equal(a.numpy(), b.numpy())


def test_a_model_folder_is_enough_for_live_use(model_path):
    live = LiveField.load(model_path)
    poses = world.world_pose(world.path(depth=0.05)[:, 0])
    live.start(poses[0])
    bounds = [live.step(pose).force_bound for pose in poses[1:31]]
    assert np.isfinite(bounds).all() and min(bounds) > 0
    assert np.abs(live.particles() - live.particles()[0]).max() > 0
    assert registry.of_folder(model_path).load_code() is method


def test_settings_are_checked():
    with pytest.raises(ValueError, match='members is 0'):
        settings.SweptFieldConfig('swept_field', members=0)
    with pytest.raises(ValueError, match='learning_rate'):
        settings.SweptFieldConfig('swept_field', learning_rate=2.0)
