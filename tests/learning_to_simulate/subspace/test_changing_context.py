"""A context that changes in time: every way to run a model takes that of the coming frame."""

import dataclasses

import numpy as np
import pytest
import tensorflow as tf

import learning_to_simulate as lts
from learning_to_simulate import rollout, rollout_status
from learning_to_simulate.live.stepper import Stepper
from learning_to_simulate.native import library
from learning_to_simulate.native.binding import CSubspace
from learning_to_simulate.reading_utils import contexts_by_frame
from learning_to_simulate.rollout_status import RolloutStatus
from learning_to_simulate.subspace.trainer import Trainer
from tests.learning_to_simulate import models
from tests.learning_to_simulate.twins.numpy_twin import Twin

H = 6
# m; float32 offsets of 0.1 m after a few steps. What the context does is hundreds of times that.
TOLERANCE = 1e-6
CHANGING = {'motion': 'driven', 'context': 'changing'}


@pytest.fixture(scope='module')
def made(tmp_path_factory):
    """An untrained model of a driven body that looks at its context closely, and its runs."""
    model, (group,), _ = models.make(tmp_path_factory.mktemp('model'), **CHANGING)
    weights = model.simulator.network.weights().node_encoder.layers[0][0]
    weights[-4:].assign(30 * weights[-4:])  # its rows: two values, two logarithms
    return model, group


def _rolled(model, group, n_frame=8):
    """Positions [S, n_frame, V, D]. Eagerly, to save the compilation."""
    layout = model.layout(group.n_rigid)
    state, known, context, _ = rollout.rollout_inputs(group, layout, model.simulator.scene)
    known = known.at(slice(n_frame))
    context = context if context.ndim == 2 else context[:n_frame]
    function = rollout.RolloutFunction(model.simulator, layout)
    tf.config.run_functions_eagerly(True)
    try:
        offsets, _ = function(state, known, context, n_frame)
    finally:
        tf.config.run_functions_eagerly(False)
    return np.moveaxis(offsets.numpy(), 0, 1) + layout.origin


def _by_steps(model, group, run, n_frame):
    """Positions [n_frame, V, D] of single steps, each with the context of its own frame."""
    layout, simulator = model.layout(group.n_rigid), model.simulator
    state, known, _, _ = rollout.rollout_inputs(group.select(run), layout, simulator.scene)
    frames = []
    for k in range(n_frame):
        coming = type(known)(known.offset[k], known.velocity[k])
        context = tf.constant(group.context[run, H + k][None], tf.float32)
        state, _ = simulator.step(state, coming, context, layout)
        frames.append(state.offset[0].numpy() + layout.origin)
    return np.stack(frames)


def test_groups_hold_it_by_frame_and_what_is_constant_once(tmp_path, made):
    _, group = made
    assert group.context.shape == (*group.position.shape[:2], 2)
    np.testing.assert_array_equal(group.context_at(9), group.context[:, 9])
    _, (constant,), _ = models.make(tmp_path, motion='driven', context=True)
    assert constant.context.shape == (len(constant.position), 2)
    both = contexts_by_frame([group, constant])
    assert [c.ndim for c in both] == [3, 3]
    assert contexts_by_frame([constant]) == [constant.context]


def test_statistics_are_those_of_all_frames(made):
    model, group = made
    s = model.simulator.statistics
    flat = group.context.reshape(-1, 2)
    np.testing.assert_allclose(s.context_mean, flat.mean(axis=0))
    np.testing.assert_allclose(s.log_context_std[1], np.log(flat[:, 1]).std())
    np.testing.assert_array_equal(s.context_range, [flat.min(axis=0), flat.max(axis=0)])


def test_single_step_is_that_of_the_numpy_twin(made):
    model, group = made
    twin = Twin(model, group.n_rigid)
    expected, _ = twin.step(
        group.position[0, :H], group.position[0, H, : group.n_rigid], group.context[0, H]
    )
    got = _by_steps(model, group, 0, 1)[0]
    np.testing.assert_allclose(got, expected, atol=TOLERANCE)


def test_rollouts_are_the_single_steps(made):
    """All runs as a batch."""
    model, group = made
    expected = _by_steps(model, group, 1, 8)
    np.testing.assert_allclose(_rolled(model, group)[1], expected, atol=TOLERANCE)
    frozen = dataclasses.replace(group, context=group.context[:, 0])
    assert np.abs(_rolled(model, frozen)[1] - expected).max() > 100 * TOLERANCE
    repeated = dataclasses.replace(group, context=0 * group.context + group.context[:, :1])
    np.testing.assert_array_equal(_rolled(model, frozen), _rolled(model, repeated))


def test_training_takes_it_of_the_frame_that_is_predicted(made):
    """A trainer's windows against the records; the loss of one is that of the numpy values."""
    model, group = made
    trainer = Trainer(model, [group])
    (tensors,) = trainer._tensors
    seed = tf.constant([3, 4])
    run, start = (x.numpy() for x in tensors.picks(16, H + 3, seed))
    context = tensors.windows(16, H + 3, seed)[3]
    for k in (0, H, H + 2):
        expected = group.context[run, start + k].astype(np.float32)
        np.testing.assert_array_equal(context(k), expected)


def _step_through(stepper, group, run, count):
    stepper.reset(group.position[run, :H], group.context_at(H - 1, run))
    frames = []
    for k in range(H, H + count):
        frames.append(stepper.step(group.position[run, k, : group.n_rigid], group.context[run, k]))
    return frames


@pytest.fixture(scope='module')
def stepper(made):
    """Of TensorFlow, compiled once."""
    model, group = made
    return models.stepper(model, group.n_rigid)


def test_live_steps_are_the_rollout(made, stepper):
    model, group = made
    frames = _step_through(stepper, group, 1, 12)
    expected = _by_steps(model, group, 1, 12)
    got = np.stack([np.concatenate([f.rigid_pose, f.modes]) for f in frames])
    np.testing.assert_allclose(got, expected, atol=TOLERANCE)


@pytest.mark.skipif(
    not any(map(library.shutil.which, ('cc', 'gcc', 'clang'))), reason='no C compiler'
)
def test_live_steps_in_c_are_those_of_tensorflow(made, stepper):
    model, group = made
    soil = CSubspace.of(model, group.n_rigid)
    with pytest.raises(ValueError, match='not started'):
        soil.call('set_context', group.context[0, 0])
    frames = _step_through(soil, group, 1, 12)
    expected = _step_through(stepper, group, 1, 12)
    for got, frame in zip(frames, expected, strict=True):
        np.testing.assert_allclose(got.modes, frame.modes, atol=TOLERANCE)
    soil.call('prepare')  # what was computed ahead with the old context is computed again
    pose, context = group.position[1, H + 12, : group.n_rigid], 1.3 * group.context[1, H]
    twin = CSubspace.of(model, group.n_rigid)
    _step_through(twin, group, 1, 12)
    np.testing.assert_array_equal(soil.step(pose, context).modes, twin.step(pose, context).modes)
    with pytest.raises(ValueError, match='shape'):
        soil.step(pose, [1.0])


def test_live_steps_keep_the_last_one_and_flag_one_outside(made, stepper):
    model, group = made
    poses = group.position[0, H:, : group.n_rigid]
    held, given = [], []
    for frames, contexts in (
        (held, [group.context[0, H], None]),
        (given, 2 * [group.context[0, H]]),
    ):
        stepper.reset(group.position[0, :H], group.context[0, 0])
        frames += [stepper.step(pose, context).modes for pose, context in zip(poses, contexts)]
    np.testing.assert_array_equal(held, given)
    frame = stepper.step(poses[2], [9.81, 80.0])
    assert frame.now == RolloutStatus.EXTRAPOLATING and 'friction_angle_deg 80' in frame.reason
    assert frame.judgement.frame == H + 2
    with pytest.raises(ValueError, match='context'):
        stepper.step(poses[3], [9.81])
    careful = Stepper(stepper.computing, 'raise')
    careful.reset(group.position[0, :H], group.context[0, 0])
    with pytest.raises(ValueError, match='friction_angle_deg 80'):
        careful.step(poses[0], [9.81, 80.0])


def test_a_rollout_says_in_which_frame_it_leaves_the_training_runs(made):
    model, group = made
    context = group.context.copy()
    context[1, 20, 1] = 99.0
    changed = dataclasses.replace(group, context=context)
    simulator = model.simulator
    judgements = rollout_status.judge(
        changed, group.position[:, H:], None, simulator.statistics, simulator.scene
    )
    assert judgements[0].status == RolloutStatus.OK
    assert judgements[1].frame == 20 and 'friction_angle_deg 99' in judgements[1].reason


def test_paths_and_live_poses_take_a_load_that_changes():
    """The shipped wheel under 120 N, then under 180 N."""
    model = lts.load('wheel')
    names = model.scene.context_names
    path = model.starts.pose[0] + np.arange(9)[:, None] * [1e-3, 0, 0, 0, 0, 0, 0]
    context = np.tile(model.starts.context[0], (9, 1))
    context[:, names.index('load')] = [120.0] * 4 + [180.0] * 5
    whole = model.rollout(path, context=context)
    live = model.stepper()
    live.start(path[0], (path[1] - path[0])[:3] / model.scene.dt, context=context[0])
    frames = [
        live.step(pose, dict(zip(names, values)))
        for pose, values in zip(path[1:], context[1:], strict=True)
    ]
    moved = np.ptp(whole.modes, axis=0).max()
    np.testing.assert_allclose([f.modes for f in frames], whole.modes, atol=1e-4 * moved)
    live.start(path[0], (path[1] - path[0])[:3] / model.scene.dt, context=context[0])
    steady = [live.step(pose).modes for pose in path[1:]]
    np.testing.assert_array_equal([f.modes for f in frames[:3]], steady[:3])
    assert np.abs(frames[-1].modes - steady[-1]).max() > 1e-2 * moved
    with pytest.raises(ValueError, match='shape'):
        model.rollout(path, context=context[:5])
