"""A context that changes in time: every way to run a model takes that of the coming frame."""

import dataclasses

import numpy as np
import pytest
import tensorflow as tf

import learning_to_simulate as lts
from learning_to_simulate import rollout_status
from learning_to_simulate.live.stepper import Stepper
from learning_to_simulate.native.binding import CSubspace
from learning_to_simulate.normalization import compute_statistics
from learning_to_simulate.rollout_status import RolloutStatus
from learning_to_simulate.subspace.trainer import Trainer
from tests.learning_to_simulate import models
from tests.learning_to_simulate.native.worlds import needs_c

H = 6
# m; float32 offsets of 0.1 m after a few steps. What the context does is hundreds of times that.
TOLERANCE = 1e-6


@pytest.fixture(scope='module')
def made(tmp_path_factory):
    """An untrained model of a driven body that looks at its context closely, and its runs."""
    folder = tmp_path_factory.mktemp('model')
    model, (group,), _ = models.make(folder, motion='driven', context='changing')
    weights = model.simulator.network.weights().node_encoder.layers[0][0]
    weights[-4:].assign(30 * weights[-4:])  # its rows: two values, two logarithms
    return model, group


def test_groups_hold_it_by_frame_and_statistics_are_those_of_all_frames(tmp_path, made):
    """What is constant is held once."""
    changing, group = made
    assert group.context.shape == (*group.position.shape[:2], 2)
    np.testing.assert_array_equal(group.context_at(9, 1), group.context[1, 9])
    model, (constant,), metadata = models.make(tmp_path, motion='driven', context=True)
    assert constant.context.shape == (len(constant.position), 2)
    s, flat = changing.simulator.statistics, group.context.reshape(-1, 2)
    np.testing.assert_allclose(s.context_mean, flat.mean(axis=0))
    np.testing.assert_allclose(s.log_context_std[1], np.log(flat[:, 1]).std())
    np.testing.assert_array_equal(s.context_range, [flat.min(axis=0), flat.max(axis=0)])
    # Side by side both count by frame.
    s = compute_statistics(
        [group, constant], metadata, model.simulator.scene, model.simulator.config
    )
    by_frame = np.repeat(constant.context, group.position.shape[1], axis=0)
    both = np.concatenate([flat, by_frame])
    np.testing.assert_allclose(s.context_mean, both.mean(axis=0))


def test_training_takes_it_of_the_frame_that_is_predicted(made):
    """A trainer's windows against the records."""
    model, group = made
    (tensors,) = Trainer(model, [group])._tensors
    seed = tf.constant([3, 4])
    run, start = (x.numpy() for x in tensors.picks(16, H + 3, seed))
    windows = tensors.windows(16, H + 3, seed)
    for k in (0, H, H + 2):
        expected = group.context[run, start + k].astype(np.float32)
        np.testing.assert_array_equal(windows.context_at(k), expected)


def _step_through(stepper, group):
    stepper.reset(group.position[1, :H], group.context_at(H - 1, 1))
    for k in range(H, H + 11):
        stepper.step(group.position[1, k, : group.n_rigid], group.context[1, k])


@needs_c
def test_c_computes_again_what_it_computed_ahead_with_the_old_context(made):
    model, group = made
    soil = CSubspace.of(model, group.n_rigid)
    with pytest.raises(ValueError, match='not started'):
        soil.call('set_context', group.context[0, 0])
    _step_through(soil, group)
    soil.call('prepare')
    pose, context = group.position[1, H + 11, : group.n_rigid], 1.3 * group.context[1, H]
    other = CSubspace.of(model, group.n_rigid)
    _step_through(other, group)
    np.testing.assert_array_equal(soil.step(pose, context).modes, other.step(pose, context).modes)
    with pytest.raises(ValueError, match='shape'):
        soil.step(pose, [1.0])


def test_live_steps_keep_the_last_one_and_flag_one_outside(made):
    model, group = made
    n = group.n_rigid
    stepper = models.stepper(model, n)
    poses = group.position[0, H:, :n]
    held, given = [], []
    for frames, contexts in (
        (held, [group.context[0, H], None]),
        (given, 2 * [group.context[0, H]]),
    ):
        stepper.reset(group.position[0, :H], group.context[0, 0])
        frames += [stepper.step(pose, context).modes for pose, context in zip(poses, contexts)]
    np.testing.assert_array_equal(held, given)
    frame = stepper.step(poses[2], [9.81, 80.0])
    assert frame.now.status == RolloutStatus.EXTRAPOLATING
    assert 'friction_angle_deg 80' in frame.now.reason
    assert frame.judgement.frame == H + 2
    with pytest.raises(ValueError, match='context'):
        stepper.step(poses[3], [9.81])
    careful = Stepper(model, n_rigid=n, outside='raise', make_step=lambda *_: stepper.computing)
    careful.reset(group.position[0, :H], group.context[0, 0])
    with pytest.raises(ValueError, match='friction_angle_deg 80'):
        careful.step(poses[0], [9.81, 80.0])


def test_a_rollout_says_in_which_frame_it_leaves_the_training_runs(made):
    model, group = made
    context = group.context.copy()
    context[1, 15, 1] = 99.0
    changed, s = dataclasses.replace(group, context=context), model.simulator
    judgements = rollout_status.judge(changed, group.position[:, H:], None, s.statistics, s.scene)
    assert judgements[0].status == RolloutStatus.OK
    assert judgements[1].frame == 15 and 'friction_angle_deg 99' in judgements[1].reason


def test_paths_and_live_poses_take_a_load_that_changes():
    """The shipped wheel under 120 N, then under 180 N."""
    model = lts.load('wheel/pcg')
    path = model.starts.pose[0] + np.arange(9)[:, None] * [1e-3, 0, 0, 0, 0, 0, 0]
    context = np.tile(model.starts.context[0], (9, 1))
    context[:, model.scene.context_names.index('load')] = [120.0] * 4 + [180.0] * 5
    whole, live = model.rollout(path, context=context), model.stepper()

    def modes(contexts):
        live.start(path[0], (path[1] - path[0])[:3] / model.scene.dt, context=context[0])
        return [live.step(pose, c).modes for pose, c in zip(path[1:], contexts, strict=True)]

    stepped = modes([dict(zip(model.scene.context_names, values)) for values in context[1:]])
    moved = np.ptp(whole.modes, axis=0).max()
    np.testing.assert_allclose(stepped, whole.modes, atol=1e-4 * moved)
    steady = modes([None] * 8)
    np.testing.assert_array_equal(stepped[:3], steady[:3])
    assert np.abs(stepped[-1] - steady[-1]).max() > 1e-2 * moved
    with pytest.raises(ValueError, match='shape'):
        model.rollout(path, context=context[:5])
