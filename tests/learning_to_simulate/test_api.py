"""The public door: the lines of the README, poses, starts, status, what is refused."""

import os
import pathlib
import shutil
import subprocess
import sys

import numpy as np
import pytest

import learning_to_simulate as lts
from learning_to_simulate import registry
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live import poses
from learning_to_simulate.live import starts as starts_lib
from learning_to_simulate.live.paths import velocity_between
from learning_to_simulate.rendering import rollout_frames
from learning_to_simulate.rollout_status import RolloutStatus
from pca_tools import dataset, files
from tests.learning_to_simulate import models, synthetic

ROOT = pathlib.Path(__file__).resolve().parents[2]
DT = 1 / 60
VELOCITY = np.array([-0.05, -0.03, 0.0])


@pytest.fixture(scope='module')
def blade():
    """The shipped graph network of the blade, its stepper and a path within the training runs."""
    model = lts.load('excavation/pcg')
    path = np.tile(model.starts.pose[0], (90, 1))
    path[:, :3] += np.arange(90)[:, None] * VELOCITY * DT
    return model, model.stepper(), path


def test_public_names_need_no_tensorflow():
    code = (
        'import sys; sys.modules["tensorflow"] = None\n'
        'import learning_to_simulate as lts\n'
        'lts.preset("pcg", latent_size=32); lts.Dataset("excavation"); print(lts.__version__)'
    )
    done = subprocess.run([sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert 'excavation/soil_field' in lts.list() and set(lts.__all__) < set(dir(lts))
    with pytest.raises(AttributeError, match='no attribute'):
        lts.stpper  # noqa: B018


def test_live_frames_are_those_of_the_whole_path(blade):
    model, live, path = blade
    whole, short = model.rollout(path), model.rollout(path[:20])
    np.testing.assert_array_equal(short.modes, whole.modes[:19])
    assert live.start(path[0], VELOCITY).status == RolloutStatus.OK
    frames = [live.step(pose) for pose in path[1:]]
    modes = np.stack([frame.modes for frame in frames])
    motion = np.ptp(whole.modes, axis=0).max()
    np.testing.assert_allclose(modes, whole.modes, atol=1e-5 * motion)
    force = np.stack([frame.force for frame in frames])
    np.testing.assert_allclose(force, whole.force, atol=1e-5 * np.abs(whole.force).max())
    assert frames[-1].status == whole.status == RolloutStatus.OK
    np.testing.assert_allclose(frames[-1].particles(), whole.particles(-1), atol=1e-5)
    np.testing.assert_allclose(frames[-1].pose, path[-1], atol=1e-12)
    assert whole.force[-1, 0] > 0  # it moves against x: the soil holds it back


def test_a_rollout_is_drawn_from_its_file(blade, tmp_path):
    model, _, path = blade
    data = lts.Dataset('excavation')
    for rollout in (model.rollout(data.test[0]), model.rollout(path[:20])):
        name = str(tmp_path / f'{rollout.name}.npz')
        rollout.save(name)
        frames, truth = rollout_frames.load(name, data.path), rollout.soil_truth
        soil = model.subspace.decode(rollout.modes)
        np.testing.assert_allclose(rollout.particles(-1), soil[-1], atol=1e-6)
        soil = soil[frames.frames - H]
        assert frames.has_truth == (rollout.truth is not None) == (truth is not None)
        if truth is not None:
            soil = soil[:, truth.indices]
            assert frames.soil_mm == pytest.approx(rollout.soil_mm, rel=1e-5)
        np.testing.assert_allclose(frames.soil['prediction'], soil, atol=1e-5)
        np.testing.assert_allclose(frames.force['prediction'][H:], rollout.force, atol=1e-4)


def test_a_split_is_opened_once_and_that_of_a_new_dataset_anew(tmp_path, monkeypatch):
    path, data_path = models.saved(tmp_path)
    model, opened, open_model = lts.load(path), [], registry.open_model
    monkeypatch.setattr(registry, 'open_model', lambda *a: opened.append(a) or open_model(*a))
    data = lts.Dataset(data_path)
    truths = [model.rollout(data.test[i]).truth[0] for i in (0, 1)]
    assert len(opened) == 1 and data.test[-1].index == len(data.test) - 1
    with pytest.raises(ValueError, match='its own velocity'):
        model.rollout(data.test[0], case=1)
    with pytest.raises(ValueError, match='only a soil field takes more'):
        model.evaluate([data.test, data.test])
    with pytest.raises(IndexError, match=f'has {len(data.test)} runs'):
        data.test[len(data.test)]
    shutil.copy(f'{data_path}/valid.tfrecord', f'{data_path}/test.tfrecord')
    truths.append(model.rollout(lts.Dataset(data_path).test[0]).truth[0])
    assert len(opened) == 2
    recorded = [*data.test.records[:2], dataset.read_split(data_path, 'valid')[0]]
    for run, truth in zip(recorded, truths, strict=True):
        np.testing.assert_allclose(truth, run.position[:, run.n_rigid :], atol=1e-6)


def test_a_jump_is_flagged_in_every_later_frame(blade):
    model, live, path = blade
    live.start(path[0], VELOCITY)
    assert live.step(path[1]).now.status == RolloutStatus.OK
    away = path[2] + [0.5, 0, 0, 0, 0, 0, 0]
    frames = [live.step(away) for _ in range(2)]
    assert all(f.status != RolloutStatus.OK and 'is outside' in f.reason for f in frames)
    # A whole history of zeros is no bed.
    stepper = models.stepper(model.model, 10)
    assert stepper.reset(np.zeros((H, 18, 3))).status == RolloutStatus.EXTRAPOLATING


def test_what_is_no_pose_is_refused():
    for pose, message in (
        (np.full(7, 1e39), 'finite in float32'),
        (np.full(7, np.nan), 'finite in float32'),
        (np.ma.masked_array(np.ones(7), [True] + 6 * [False]), 'masked'),
        (np.ones(7, complex), 'complex'),
        (np.ones(7, bool), 'bool'),
        (np.array(['1'] * 7), 'not an array of numbers'),
        (np.array([0] * 7, 'datetime64[s]'), 'datetime64'),
        (np.array([0.8, 0.4, 0.4, 2, 0, 0, 0]), 'length 2, must be 1'),
        ((0.8, 0.4), r'position has shape \(\)'),
        (np.zeros((10, 3)), 'must be'),
    ):
        with pytest.raises(ValueError, match=message):
            poses.read_pose(pose, 1, 0.4)


def test_frames_cannot_be_written_to_and_one_thread_at_a_time(blade):
    model, live, path = blade
    live.start(path[0], VELOCITY)
    frame, at_rest = live.step(path[1]), model.starts
    for values in (frame.modes, frame.force, frame.rigid_pose, frame.pose, at_rest.pose[0],
                   at_rest.modes, at_rest.body[0]):  # fmt: skip
        with pytest.raises(ValueError, match='read-only'):
            values[:] = 0
    with live._lock:  # as while another thread is at work
        for call in (live.step, live.start, live.propose, lambda _: live.clone()):
            with pytest.raises(RuntimeError, match='another thread'):
                call(path[2])
    live.step(path[2])


def test_wheel_has_its_cases_and_its_context():
    model = lts.load('wheel/pcg')
    live, starts = model.stepper(), model.starts
    case = starts.cases[3]['case']
    assert live.start(case=case).status == RolloutStatus.OK
    pose = starts.pose[3].copy()
    pose[:2] += 3e-4, 1.0  # of a driven body the height is not the user's
    frame = live.step(pose)
    assert abs(frame.pose[1] - starts.pose[3, 1]) < 5e-3 and frame.pose[0] == pose[0]
    context = dict(zip(model.scene.context_names, starts.context[3]))
    assert live.start(context=context).status == RolloutStatus.OK
    far = context | {'load': 1e4}
    found = live.start(context=far)
    assert found.status == RolloutStatus.EXTRAPOLATING and 'load' in found.reason
    with pytest.raises(ValueError, match='context names'):
        live.start(context={'gravity': 9.81})
    with pytest.raises(ValueError, match='no start of case 1000'):
        live.start(case=1000)
    name = next(c['case'] for c in starts.cases if isinstance(c['case'], str))
    start = starts.index(name)
    assert live.start(case=name).pose[1] == pytest.approx(starts.pose[start, 1], abs=1e-6)
    numbered = next(c['case'] for c in starts.cases if isinstance(c['case'], int))
    assert starts.index(str(numbered)) == starts.index(numbered)


def test_predicted_body_takes_no_pose_and_says_where_it_is(tmp_path):
    path, _ = models.saved(tmp_path, 'pcg_thesis', motion='predicted')
    model = lts.load(path)
    live = model.stepper()
    live.start(velocity=(2e-2, 0, 0))
    frame = live.step()
    assert np.linalg.norm(frame.pose[:3] - model.starts.pose[0, :3]) < 5e-3
    assert np.linalg.norm(frame.pose[3:]) == pytest.approx(1)
    with pytest.raises(ValueError, match='does not take a pose'):
        live.step(model.starts.pose[0])


def test_poses_in_all_forms_and_planes():
    turn = np.array([np.cos(0.1), 0, 0, np.sin(0.1)])
    flat = poses.read_pose((0.8, 0.3, 0.2), 1, 0.4)
    np.testing.assert_allclose(flat, [0.8, 0.3, 0.4, *turn])
    np.testing.assert_allclose(poses.read_pose(((0.8, 0.3, 0.4), turn), 1, 0.4), flat)
    # The drive axis turns towards the height axis, whichever that is.
    for drive, up, across in ((0, 1, 2), (0, 2, 1), (1, 0, 2)):
        values = poses.read_pose((0.8, 0.3, np.pi / 2), up, 0.4)
        matrix = poses.rotation_matrix(values[3:])
        np.testing.assert_allclose(matrix @ np.eye(3)[drive], np.eye(3)[up], atol=1e-12)
        assert values[[drive, up, across]].tolist() == [0.8, 0.3, 0.4]
    matrix = poses.rotation_matrix(np.array([0.5, 0.5, 0.5, 0.5]))
    np.testing.assert_allclose(poses.quaternion_of(matrix), [0.5] * 4, atol=1e-12)
    # A constant turn, undone in two halves.
    velocity = np.array([1.0, 2.0, 3.0, 0.3, -0.4, 0.5])
    twice = poses.moved_back(poses.moved_back(flat, velocity, 0.5), velocity, 0.5)
    np.testing.assert_allclose(poses.moved_back(flat, velocity, 1.0), twice, atol=1e-12)
    before = poses.moved_back(flat, velocity, DT)
    np.testing.assert_allclose(velocity_between(before, flat, DT), velocity, atol=1e-9)


def test_height_map_is_the_highest_particle_of_each_cell(blade):
    model, live, path = blade
    frame = live.start(path[0], VELOCITY)
    heights, points = frame.height_map(7, 5), frame.particles()
    plan = model.subspace.initial[:, ::2]
    low, high = plan.min(axis=0), plan.max(axis=0)
    cells = np.clip(((points[:, ::2] - low) / (high - low) * (7, 5)).astype(int), 0, (6, 4))
    for cell in ((0, 0), (3, 2), (6, 4)):
        assert heights[cell] == points[(cells == cell).all(axis=1), 1].max()


def test_trained_model_is_self_contained(tmp_path):
    """The dataset is gone before the model is used."""
    folder = synthetic.write_dataset(tmp_path / 'data')
    synthetic.write_subspace(folder)
    os.remove(dataset.split_path(folder, 'valid'))  # the test runs are rolled out below
    config = lts.preset(
        'pcg', latent_size=8, num_steps=2, unroll_steps=0, mode_edges=4, rigid_particles=3
    )
    path = str(tmp_path / 'model')
    with models.eagerly():
        model = lts.train(config, lts.Dataset(folder), tmp_path / 'model')
    assert 'soil within the subspace' in str(model.evaluate(lts.Dataset(folder).test))
    shutil.rmtree(folder)
    starts = model.starts
    # Plates of one shape: the same body, wherever it stands; beds do not differ either.
    assert len(starts) == 1 and len(starts.body[0]) == 4 and len(starts.kept[0]) == 3
    rollout = model.rollout(starts.pose[0] + np.outer(np.arange(5), [1e-3, 0, 0, 0, 0, 0, 0]))
    assert rollout.particles().shape == (4, synthetic.N_SOIL, 3) and rollout.body.shape[1] == 4
    values = files.read_json(f'{path}/config.json')
    files.write_json(f'{path}/config.json', {k: v for k, v in values.items() if k != 'files'})
    with pytest.raises(FileNotFoundError, match='holds no start.npz'):
        lts.load(path).stepper()
    files.write_json(f'{path}/config.json', values)
    with open(f'{path}/start.npz', 'ab') as file:
        file.write(b' ')
    with pytest.raises(ValueError, match='not the file of this model'):
        starts_lib.read(path)
