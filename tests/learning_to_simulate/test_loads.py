"""The torque beside the force, where the data have it: statistics, what a model learns of it, where
it comes out, and what is refused.
"""

import json
import os

import numpy as np
import pytest

from learning_to_simulate import (
    api,
    checkpoints,
    evaluation,
    loads,
    presets,
    registry,
)
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.export import exporting
from learning_to_simulate.live import paths
from learning_to_simulate.rollout import RolloutFunction, roll_out
from learning_to_simulate.rollout_status import NodeRanges, RolloutStatus, judge
from learning_to_simulate.subspace import subspace_model
from pca_tools import files
from tests.learning_to_simulate import models, synthetic

TORQUE = {'predict_torque': True}


def relative(predicted, truth):
    return np.linalg.norm(predicted - truth) / np.linalg.norm(truth)


@pytest.fixture(scope='module')
def trained(tmp_path_factory):
    """A model folder trained for a second on soil that turns its body, and its data."""
    folder = tmp_path_factory.mktemp('torque')
    data = synthetic.write_dataset(folder / 'data', n_run=8, torque=True)
    synthetic.write_subspace(data)
    config = presets.make_config(
        'mlp', latent_size=32, num_steps=800, unroll_steps=0, learning_rate=3e-3, noise_std=0.1,
        batch_size=32, **TORQUE,
    )  # fmt: skip
    path = str(folder / 'model')
    registry.train(data, path, config, save_every=800)
    return path, data


@pytest.fixture(scope='module')
def rolled(trained):
    """Its rollouts of the test runs: (record, group, rollout) and metrics."""
    opened = registry.open_model(*trained, 'test')
    return opened, *opened.evaluator.run(opened.groups, 'test')


@pytest.mark.parametrize(
    ('preset', 'last'), [('pcg', 'decoder/linear_2'), ('mixer_scse', 'output')]
)
def test_with_the_same_weights_the_torque_changes_nothing_else(tmp_path, preset, last):
    """A head with more columns: the others give the same soil and force."""
    wide, (group,), _ = models.make(tmp_path / 'a', preset, torque=True, overrides=TORQUE)
    narrow, _, _ = models.make(tmp_path / 'b', preset, torque=True)
    pairs = zip(*(m.simulator.trainable_variables for m in (narrow, wide)), strict=True)
    widened = 0
    for mine, theirs in pairs:
        if mine.shape != theirs.shape:
            assert last in mine.name and theirs.shape[-1] - mine.shape[-1] == 3
            widened += 1
        mine.assign(theirs[..., : mine.shape[-1]])
    assert widened == 2  # w and b
    a, b = (models.rolled(model, group.select(0)) for model in (wide, narrow))
    scale = np.ptp(b.position)
    np.testing.assert_allclose(a.position, b.position, atol=1e-6 * scale)
    np.testing.assert_allclose(a.force, b.force, atol=1e-5 * np.abs(b.force).max())
    assert b.torque is None and a.torque.shape == a.force.shape and np.isfinite(a.torque).all()
    stepper = models.stepper(narrow, group.n_rigid)
    stepper.reset(group.position[0, :H])
    assert stepper.step(group.position[0, H, : group.n_rigid]).torque is None
    summary = evaluation.summarise([(0, group.select(0), b)], narrow, {}, 'train')
    assert not any('torque' in key for key in summary['mean']['model'])
    assert not any('torque' in key for key in evaluation._arrays(group.select(0), b))


def test_a_trained_model_follows_a_known_torque(rolled):
    """The torque is the lever times the force, which carries 0.1 N of noise."""
    _, results, summary = rolled
    for record, group, rollout in results:
        true = np.cross(synthetic.LEVER, group.force[0, H:])
        assert relative(rollout.torque[0], true) < 0.1
        assert relative(rollout.torque[0], np.cross(synthetic.LEVER, rollout.force[0])) < 0.1
        row = summary['runs']['model'][record]
        assert row['torque_relative_l2'] == pytest.approx(relative(rollout.torque[0], true), 1e-4)
        square = ((rollout.torque[0] - true) ** 2).mean()
        assert row['torque_rmse'] == pytest.approx(np.sqrt(square), rel=1e-4)
        held = group.torque[0, H - 1]
        still = summary['runs']['stay_still'][record]['torque_relative_l2']
        assert still == pytest.approx(relative(held, group.torque[0, H:]), rel=1e-6)
    assert 'torque in the plane of travel' in evaluation.table(summary)


def test_rollout_files_hold_it_and_metrics_say_it(rolled, tmp_path):
    opened, results, summary = rolled
    evaluation.save_rollouts(str(tmp_path), 'test', results, summary, opened.metadata)
    said = files.read_json(str(tmp_path / 'metrics.json'))['runs']['model']
    for (record, group, rollout), errors in zip(results, said, strict=True):
        share = relative(rollout.torque[0], group.torque[0, H:])
        assert errors['torque_relative_l2'] == pytest.approx(share, rel=1e-4)
        arrays = files.read_npz(str(tmp_path / f'rollout_test_{record}.npz'))
        np.testing.assert_array_equal(arrays['predicted_torques'], rollout.torque[0])
        both = np.concatenate([arrays['initial_torques'], arrays['ground_truth_torques']])
        np.testing.assert_array_equal(both, group.torque[0].astype(np.float32))


def test_live_steps_paths_and_batches_hand_out_the_same_torque(trained, rolled):
    opened, results, _ = rolled
    _, group, rollout = results[0]
    function = RolloutFunction(opened.model.simulator, opened.model.layout(group.n_rigid))
    batch = roll_out(function, opened.groups[0])
    close = {'rtol': 1e-3, 'atol': 1e-3 * np.abs(rollout.torque).max()}
    np.testing.assert_allclose(batch.torque[0], rollout.torque[0], **close)
    stepper = models.stepper(opened.model, group.n_rigid)
    stepper.reset(group.position[0, :H])
    for k in range(10):
        frame = stepper.step(group.position[0, H + k, : group.n_rigid])
        np.testing.assert_allclose(frame.torque, rollout.torque[0, k], **close)
        np.testing.assert_allclose(frame.force, rollout.force[0, k], rtol=1e-3, atol=1e-2)
        assert not frame.torque.flags.writeable
    model = api.load(trained[0])
    recorded = model.rollout(api.Dataset(trained[1]).test[0])
    np.testing.assert_array_equal(recorded.torque, rollout.torque[0])
    live = model.stepper()
    pose = model.starts.pose[0]
    path = [pose + [-1e-3 * k, -3e-4 * k, 0, 0, 0, 0, 0] for k in range(12)]
    whole = model.rollout(path)
    live.start(path[0], (np.subtract(path[1], path[0]) / live.dt)[:3])
    torque = np.stack([live.step(p).torque for p in path[1:]])
    np.testing.assert_allclose(torque, whole.torque, rtol=1e-3, atol=1e-3 * np.abs(torque).max())


def test_a_saved_path_has_its_torque(trained, tmp_path):
    model = api.load(trained[0])
    recorded = model.rollout(api.Dataset(trained[1]).test[1])
    name = str(tmp_path / 'run.npz')
    recorded.save(name)
    arrays = files.read_npz(name)
    np.testing.assert_array_equal(arrays['predicted_torques'], recorded.torque)
    both = np.concatenate([arrays['initial_torques'], arrays['ground_truth_torques']])
    np.testing.assert_array_equal(both, recorded.true_torque.astype(np.float32))
    assert isinstance(recorded, paths.SoilRollout) and len(both) == synthetic.N_FRAMES


def test_a_torque_that_is_not_finite_is_found(rolled):
    opened, results, _ = rolled
    _, group, rollout = results[0]
    s, scene = opened.model.simulator.statistics, opened.model.simulator.scene
    load = np.concatenate([rollout.force, rollout.torque], axis=-1)
    load[0, 4, 5] = np.nan
    (found,) = judge(group, rollout.position, load, s, scene)
    assert found[:3] == (RolloutStatus.NON_FINITE, H + 4, -1)
    live = NodeRanges(group.n_rigid, s, scene)
    now = live.judge(H + 4, rollout.position[0, 4], *loads.split(load[0, 4], s))
    assert found.reason == now.reason == 'torque is not finite'
    load[0, 4, 1] = np.inf
    assert judge(group, rollout.position, load, s, scene)[0].reason == 'force is not finite'


def test_a_saved_model_and_litert_carry_it_and_c_refuses_it(trained, tmp_path):
    path, data = trained
    for kind in ('savedmodel', 'tflite'):
        description = exporting.export(path, data, str(tmp_path / kind), kind)
        apart = description['compared']['relative_difference']
        assert set(apart) == {'modes', 'rigid', 'force', 'torque'}
        assert 'N m' in description['signatures']['step']['outputs']['torque'][2]
    for kind in ('c', 'fmu'):
        with pytest.raises(ValueError, match='predict_torque: the C form has no torque'):
            exporting.export(path, data, str(tmp_path / kind), kind)
        assert not (tmp_path / kind).exists()


def test_data_without_a_torque_is_refused_at_the_door(trained, tmp_path):
    data = synthetic.write_dataset(tmp_path / 'data')
    synthetic.write_subspace(data)
    config = presets.make_config('mlp', num_steps=4, **TORQUE)
    with pytest.raises(ValueError, match=f'predict_torque: {data} does not hold'):
        registry.train(data, str(tmp_path / 'model'), config)
    assert not (tmp_path / 'model').exists() or not os.listdir(tmp_path / 'model')
    with pytest.raises(ValueError, match='lacks rigid_body_torque_mean'):
        registry.open_model(trained[0], data, 'test')
    with pytest.raises(ValueError, match="no settings .'predict_torque'."):
        presets.make_config('full_space', **TORQUE)


@pytest.mark.parametrize(
    ('name', 'value', 'message'),
    [
        ('torque_mean', None, 'presence of statistics.torque_mean'),
        ('torque_std', [1.0, 0.0, 1.0], 'torque_std'),
        ('torque_std', [1.0], 'torque_std of shape'),
    ],
)
def test_damaged_statistics_are_refused(trained, tmp_path, name, value, message):
    source = os.path.join(trained[0], checkpoints.CONFIG_FILE)
    values = files.read_json(source)
    values['statistics'][name] = value
    (tmp_path / checkpoints.CONFIG_FILE).write_text(json.dumps(values))
    with pytest.raises(ValueError, match=message):
        subspace_model.load(str(tmp_path))
