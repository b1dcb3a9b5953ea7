"""The status of rollouts whose fault is known, and the ranges that it rests on."""

import dataclasses
import json

import numpy as np
import pytest

from learning_to_simulate import evaluation, registry
from learning_to_simulate.live import starts
from learning_to_simulate.live.stepper import Stepper
from learning_to_simulate.rollout_status import RolloutStatus, judge, widened
from pca_tools import files
from tests.learning_to_simulate import models

H = 6


@pytest.fixture(scope='module')
def made(tmp_path_factory):
    """(model, its one group of training runs, metadata) of a driven body with a context."""
    return models.make(tmp_path_factory.mktemp('data'), motion='driven', context=True)


def judged(made, position=None, force=None, group=None):
    """Judgement of the first run; what is not given is the truth of the training run."""
    model, (whole,), _ = made
    s = model.simulator
    group = whole.select(0) if group is None else group
    position = group.position[:, H:] if position is None else position
    return judge(group, position, force, s.statistics, s.scene, force_limit=100.0)[0]


def changed(made, **fields):
    """The first run with some arrays changed by functions."""
    one = made[1][0].select(0)
    arrays = {name: getattr(one, name).copy() for name in fields}
    for name, change in fields.items():
        change(arrays[name])
    return dataclasses.replace(one, **arrays)


def add(index, value):
    def change(array):
        array[index] += value

    return change


PREDICTED = {
    'NaN position': ('position', add((0, 3, 5, 1), np.nan), ('non_finite', 9, 5)),
    'infinite force': ('force', add((0, 7, 2), np.inf), ('non_finite', 13, -1)),
    'force above twice the largest': ('force', add((0, 7, 2), 201.0), ('left_bounds', 13, -1)),
    'force whose square is infinite': ('force', add((0, 7, 0), 1e20), ('left_bounds', 13, -1)),
    'mode far away': ('position', add((0, 20, 6, 0), 1e3), ('left_bounds', 26, 6)),
    'predicted height': ('position', add((0, 4, 0, 1), -9.0), ('left_bounds', 10, 0)),
    'NaN after far away': ('position', add((0, 2), np.inf), ('non_finite', 8, 0)),
}


@pytest.mark.parametrize('case', PREDICTED.values(), ids=PREDICTED)
def test_fault_of_a_prediction_is_found_where_it_is(made, case):
    which, change, expected = case
    group = made[1][0].select(0)
    force = np.zeros_like(group.force[:, H:], dtype=np.float32)
    force[:, :7, 1] = 199.0  # less than twice the largest
    arrays = {'position': group.position[:, H:].copy(), 'force': force}
    change(arrays[which])
    found = judged(made, **arrays)
    assert (str(found.status), found.frame, found.node) == expected
    assert found.reason


def faster(position):
    """The body's travel from frame 20 on at three times its speed; same shape, inside its place."""
    travel = position[:, :, :4].mean(axis=2, keepdims=True)
    step = np.diff(travel, axis=1, prepend=travel[:, :1])
    step[:, 20:25] *= [3.0, 1.0, 1.0]
    position[:, :, :4] += np.cumsum(step, axis=1) - (travel - travel[:, :1])


def wider(position):
    body = position[:, 30:, :4]
    middle = body.mean(axis=2, keepdims=True)
    body += 0.5 * (body - middle) * [1.0, 0.0, 0.0]


GIVEN = {
    'friction angle': ({'context': add((0, 1), 60.0)}, 0, 'context|friction_angle'),
    'start': ({'position': add((0, 2, 5, 0), 50.0)}, 2, 'coordinate x'),
    'place of the body': ({'position': add((0, slice(35, None), slice(4), 0), 9.0)}, 35, 'x'),
    'speed': ({'position': faster}, 20, 'displacement x'),
    'shape or lean': ({'position': wider}, 30, 'coordinate x|extent of the body x'),
}


@pytest.mark.parametrize('case', GIVEN.values(), ids=GIVEN)
def test_input_outside_the_training_range_is_extrapolation(made, case):
    changes, frame, words = case
    # The prediction itself is unremarkable.
    position = made[1][0].select(0).position[:, H:]
    found = judged(made, position, group=changed(made, **changes))
    assert found.status is RolloutStatus.EXTRAPOLATING
    assert found.frame == frame
    assert any(word in found.reason for word in words.split('|'))


def test_training_runs_are_inside_their_range_and_a_driven_height_is_no_input(made):
    """It is predicted, so a true height far away in the record says nothing about the rollout."""
    assert judged(made).status is RolloutStatus.OK
    position = made[1][0].select(0).position[:, H:]
    group = changed(made, position=add((0, slice(H, None), slice(4), 1), 5.0))
    assert judged(made, position, group=group).status is RolloutStatus.OK


def test_range_is_doubled_about_its_middle_and_still_axes_have_a_floor():
    low, high = widened(np.array([1.0, 0.0, 2.0]), np.array([3.0, 0.0, 2.0]), 2.0)
    np.testing.assert_allclose(low, [0.0, -0.1, 1.9])
    np.testing.assert_allclose(high, [4.0, 0.1, 2.1])


def test_ranges_are_those_of_the_training_runs(made, tmp_path):
    model, (group,), _ = made
    s = model.simulator.statistics
    for k in range(3):
        values = group.position[:, :, 4 + k].reshape(-1, 3)
        np.testing.assert_array_equal(s.position_range[:, 1 + k], [values.min(0), values.max(0)])
    np.testing.assert_array_equal(
        s.context_range, [group.context.min(axis=0), group.context.max(axis=0)]
    )
    # A turning ring of radius 0.1 whose height is not given.
    np.testing.assert_allclose(s.given_range[:, 1], [-0.1, 0.1], atol=5e-3)
    free, _, _ = models.make(tmp_path, motion='predicted')
    assert free.simulator.statistics.given_range is None


def test_status_reaches_metrics_table_and_rollout_files(made, tmp_path):
    model, (group,), metadata = made
    evaluator = evaluation.Evaluator(model, metadata)
    outside = changed(made, context=add((0, 1), 60.0))
    results, summary = evaluator.run([outside], 'test')
    evaluation.save_rollouts(str(tmp_path), 'test', results, summary, metadata)
    row = json.loads((tmp_path / 'metrics.json').read_text())['runs']['model'][0]
    arrays = files.read_npz(str(tmp_path / 'rollout_test_0.npz'))
    # An untrained network may leave the bounds as well, which is the worse of the two.
    assert row['status'] in ('extrapolating', 'left_bounds')
    for key in ('status', 'first_bad_frame', 'first_bad_node', 'status_reason'):
        assert arrays[key].item() == row[key]
    assert f'warning: record 0 is {row["status"]} from frame' in evaluation.table(summary)


def test_force_above_its_limit_is_told_by_live_steps_and_evaluation(tmp_path):
    """By the limit of the model folder: the same frame, node and words."""
    path, data = models.saved(tmp_path)
    own = f'{path}/{starts.START_FILE}'
    files.write_npz(own, **files.read_npz(own) | {'force_limit': np.array(40.0)})
    config = files.read_json(f'{path}/config.json')
    config['files'][starts.START_FILE] = files.sha256_of_file(own)
    files.write_json(f'{path}/config.json', config)
    opened = registry.open_model(path, data, 'train')
    one = opened.groups[0].select(0)
    (found,) = opened.evaluator.roll_out(one).judgements
    stepper = Stepper(opened.model, starts.read(path)[0])
    stepper.reset(one.position[0, :H])
    for pose in one.position[0, H:, : one.n_rigid]:
        frame = stepper.step(pose)
    assert found.status is RolloutStatus.LEFT_BOUNDS
    assert 'N is above 2 x the largest of training (80 N)' in found.reason
    assert frame.judgement == found
