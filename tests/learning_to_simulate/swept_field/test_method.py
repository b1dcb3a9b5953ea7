"""Training, evaluation and files of the method on a small dataset of made-up soil."""

import os
import shutil

import numpy as np
import pytest

import learning_to_simulate as lts
from learning_to_simulate import evaluation, registry
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live import paths
from learning_to_simulate.native import c_values, field_data
from learning_to_simulate.swept_field import method, settings, training
from pca_tools import dataset, files, particles
from reports.protocol import rollouts
from tests.learning_to_simulate.swept_field import small_wheel
from tests.learning_to_simulate.swept_field import small_world as world

SMALL = {
    'members': 2, 'latent_size': 16, 'hidden_layers': 2,
    'num_steps': 250, 'batch_size': 32, 'start_every': 40,
}  # fmt: skip


@pytest.fixture(scope='module')
def data_path(tmp_path_factory):
    folder = tmp_path_factory.mktemp('made_up')
    depths = [(0.03, 'train'), (0.045, 'train'), (0.06, 'train'), (0.04, 'valid'), (0.05, 'test')]
    world.write_dataset(folder, depths)
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
    # Two starts in each run of train, and none of valid, whose records have the same numbers.
    assert (summary['training']['runs'], summary['training']['episodes']) == (3, 6)
    assert summary['reliability']['soil']['weights_of_this_split'][0] > 0
    # What is said to rest does so in the training runs.
    assert summary['training']['left_out_share'] > 0.3
    assert summary['training']['left_out_motion'] < 1e-3


def test_rollouts_are_written_as_the_protocol_reads_them(data_path, model_path, tmp_path):
    """Particles, force and torque of the test run, for `reports.protocol`."""
    opened = registry.open_model(model_path, data_path, 'test')
    results, summary = opened.evaluator.run(opened.groups, 'test')
    evaluation.save_rollouts(str(tmp_path), 'test', results, summary, opened.metadata)
    (errors,) = rollouts.read(str(tmp_path))
    arrays = files.read_npz(str(tmp_path / 'rollout_test_0.npz'))
    frames = np.arange(8, 61, 4)
    truth = particles.read_sample(data_path, 'test')[0][frames // 4]
    predicted = arrays['predicted_particles'].astype(float)
    np.testing.assert_array_equal(arrays['particle_frames'], frames)
    error = 1e3 * np.sqrt(((predicted - truth) ** 2).mean())
    assert error == pytest.approx(summary['field'][0]['soil_mm'], rel=1e-3)
    assert error == pytest.approx(errors['soil_mm'], rel=1e-3)
    run = dataset.read_split(data_path, 'test')[0]
    for name, recorded in (('force', run.force), ('torque', run.torque)):
        off = arrays[f'predicted_{name}s'] - recorded[6:]
        relative = np.linalg.norm(off) / np.linalg.norm(recorded[6:])
        assert errors[f'{name}_l2'] == pytest.approx(relative, rel=1e-3) and relative < 0.6
    # The modes in the file, for pictures, are those of the particles.
    assert summary['mean']['model']['soil_mm'] < summary['mean']['stay_still']['soil_mm']


def test_training_is_the_same_again_and_is_found_done(data_path, model_path):
    before = files.sha256_of_file(os.path.join(model_path, 'weights.npz'))
    registry.train(data_path, model_path, settings.SweptFieldConfig('swept_field', **SMALL))
    assert files.sha256_of_file(os.path.join(model_path, 'weights.npz')) == before
    other = settings.SweptFieldConfig('swept_field', **(SMALL | {'num_steps': 5}))
    with pytest.raises(ValueError, match='another config'):
        registry.train(data_path, model_path, other)
    with pytest.raises(ValueError, match='contradicts'):
        method.open_model(model_path, data_path, 'test', {'members': 1})
    metadata = dataset.read_metadata(data_path)
    one, other = (training.fit(other, data_path, metadata)[0] for _ in range(2))
    for a, b in zip(one.network.trainable_variables, other.network.trainable_variables):
        np.testing.assert_array_equal(a.numpy(), b.numpy())


def test_a_model_folder_is_enough_for_live_use(model_path):
    """Steps are the frames of the same path rolled out at once."""
    model = lts.load(model_path)
    poses = world.world_pose(world.path(depth=0.05)[:, 0])
    rollout = model.rollout(poses[:31])
    live = model.stepper()
    live.start(poses[0], paths.velocity_between(poses[0], poses[1], live.dt))
    frames = [live.step(pose) for pose in poses[1:31]]
    np.testing.assert_allclose([f.force for f in frames], rollout.force, atol=1e-3)
    np.testing.assert_allclose([f.torque for f in frames], rollout.torque, atol=1e-3)
    assert [f.now for f in frames] == list(rollout.frame_status)
    np.testing.assert_allclose(frames[-1].particles(), rollout.particles(-1), atol=1e-6)
    np.testing.assert_allclose(frames[-1].height_map(6, 4), rollout.height_map(6, 4), atol=1e-6)
    assert np.abs(frames[-1].particles() - rollout.particles(0)).max() > 1e-3
    assert min(f.bound for f in frames) > 0
    np.testing.assert_allclose(rollout.body[-1], live.body(poses[30]), atol=1e-9)


def test_rollouts_of_runs_and_paths_can_be_saved(data_path, model_path, tmp_path):
    model, data = lts.load(model_path), lts.Dataset(data_path)
    recorded = model.rollout(data.test[0])
    assert recorded.modes.shape == recorded.truth[0][6:].shape
    assert 0 < model.evaluate(data.test).summary['field'][0]['soil_mm'] < 20
    several = model.rollout([world.world_pose(world.path(depth=d)[:20, 0]) for d in (0.03, 0.05)])
    assert len(several) == 2 and several[0].force.shape == (19, 3)
    for rollout in (recorded, several[0]):
        rollout.save(str(tmp_path / 'rollout.npz'))
        arrays = files.read_npz(str(tmp_path / 'rollout.npz'))
        assert len(arrays['predicted_rollout']) == len(rollout.modes)


def test_the_evaluation_is_what_steps_say_in_the_same_frames(data_path, model_path):
    """Of all members, and pushed out: an evaluation one frame late, or of one member, differs."""
    opened = registry.open_model(model_path, data_path, 'test')
    rollout = opened.evaluator.roll_out(opened.groups[0].select(0))
    episode = opened.evaluator.episode(0)
    run = dataset.read_split(data_path, 'test')[0]
    live = lts.load(model_path).stepper(engine='tensorflow')
    live.start(run.rigid_pose[0].astype(float), bed=opened.evaluator.reader.points(run, 0))
    compared = dict(zip(rollout.arrays['particle_frames'].tolist(),
                        rollout.arrays['predicted_particles']))  # fmt: skip
    for frame, pose in enumerate(run.rigid_pose.astype(float)[1:], start=1):
        force = live.step(pose).force
        if frame in compared:
            soil = live.state.frame.soil
            soil.ground = episode.ground
            np.testing.assert_allclose(soil.particles(), compared[frame], atol=1e-5)
        if frame >= H:
            np.testing.assert_allclose(rollout.force[0, frame - H], force, atol=1e-2)
    moves = np.diff(rollout.arrays['predicted_particles'], axis=0)
    assert len(compared) > 10 and np.abs(moves).max() > 1e-3


@pytest.mark.parametrize(
    'setting, message',
    [
        ({'members': 0}, 'members is 0'),
        ({'learning_rate': 2.0}, 'learning_rate'),
        ({'num_steps': 10.5}, 'num_steps is 10.5, must be of type int'),
    ],
)
def test_settings_are_checked(setting, message):
    with pytest.raises(ValueError, match=message):
        settings.SweptFieldConfig('swept_field', **setting)


def test_without_valid_runs_a_field_has_no_bound(tmp_path, capsys):
    """It is kept, steps in Python and has a C form."""
    world.write_dataset(tmp_path, [(0.03, 'train'), (0.05, 'train'), (0.04, 'test')])
    data_path, path = str(tmp_path / 'data'), str(tmp_path / 'model')
    assert not os.path.exists(dataset.split_path(data_path, 'valid'))
    config = settings.SweptFieldConfig('swept_field', **(SMALL | {'num_steps': 5}))
    for _ in range(2):
        assert registry.train(data_path, path, config) == {}
        assert 'no valid runs' in capsys.readouterr().out
    model = lts.load(path)
    live, pose = model.stepper(), world.world_pose(world.path()[:, 0])
    live.start(pose[0])
    assert live.step(pose[1]).bound is None
    values = field_data.values(model.model.field)
    assert not len(values['bound']) and c_values.Structure('lts_field_model', values)
    summary = model.evaluate(lts.Dataset(data_path).test).summary
    assert summary['reliability']['force']['groups'] == []


def test_valid_runs_without_particles_are_refused_before_the_training(
    data_path, tmp_path, monkeypatch
):
    data = shutil.copytree(data_path, tmp_path / 'data')
    (data / 'particles_valid.npz').unlink()
    monkeypatch.setattr(training, 'fit', lambda *_: pytest.fail('it trains'))
    config = settings.SweptFieldConfig('swept_field', **SMALL)
    with pytest.raises(FileNotFoundError, match='particles_valid'):
        registry.train(str(data), str(tmp_path / 'model'), config)


@pytest.fixture(scope='module')
def wheel_paths(tmp_path_factory):
    folder = tmp_path_factory.mktemp('made_up_wheel')
    sinkages = [(0.004, 'train'), (0.006, 'train'), (0.008, 'train'), (0.005, 'valid'),
                (0.007, 'test')]  # fmt: skip
    small_wheel.write_dataset(folder, sinkages)
    config = settings.SweptFieldConfig('swept_field', **(SMALL | {'start_every': 0}))
    registry.train(str(folder / 'data'), str(folder / 'model'), config)
    return str(folder / 'data'), str(folder / 'model')


def test_training_learns_sinkage_soil_and_force_of_a_wheel(wheel_paths):
    data, model = wheel_paths
    (run,) = files.read_json(os.path.join(model, 'metrics.json'))['field']
    assert run['soil_mm'] < 0.5 * run['still_mm']
    assert run['force_l2'] < 0.5 * run['held_force_l2'] and run['torque_l2'] < 0.2
    assert run['height_mm'] < 0.3 * run['held_height_mm']
    assert 0 < run['height_over_radius'] < 0.05
    test = lts.load(model).evaluate(lts.Dataset(data).test).summary
    assert test['field'][0]['height_mm'] < 0.5 * test['field'][0]['held_height_mm']
    # The body in the rollout stands at the height that was predicted.
    assert test['mean']['model']['rigid_mse'] < 0.1 * test['mean']['stay_still']['rigid_mse']


def test_a_model_folder_of_a_wheel_is_enough_for_paths_and_steps(wheel_paths):
    data, path = wheel_paths
    model, run = lts.load(path), dataset.read_split(data, 'test')[0]
    poses, contexts = run.rigid_pose.astype(float), run.step_context.astype(float)
    case = model.starts.cases[-1].get('case')
    rollout = model.rollout(poses, case=case, context=contexts)
    live = model.stepper()
    velocity = paths.velocity_between(poses[0], poses[1], live.dt)
    live.start(poses[0], velocity, case=case, context=contexts[0])
    frames = [live.step(p, context=c) for p, c in zip(poses[1:], contexts[1:])]
    np.testing.assert_allclose([f.force for f in frames], rollout.force, atol=2e-3)
    assert [f.now for f in frames] == list(rollout.frame_status)
    heights = [f.pose[1] for f in frames]
    np.testing.assert_allclose(heights, rollout.body[6:, :, 1].mean(axis=1), atol=1e-6)
    assert heights[-1] < poses[0, 1] - 1e-3
    np.testing.assert_allclose(frames[-1].particles(), rollout.particles(-1), atol=1e-6)
    recorded = model.rollout(lts.Dataset(data).test[0])
    assert len(recorded.modes) == len(poses) - 6
