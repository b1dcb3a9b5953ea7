"""Errors of closed-loop rollouts, against plain formulas on the arrays of runs, and against a soil
whose law is known."""

import dataclasses
import json
import types

import numpy as np
import pytest

from learning_to_simulate import evaluation as tables
from learning_to_simulate.baselines import earthmoving
from learning_to_simulate.soil_field import evaluation
from learning_to_simulate.soil_field.runs import Machine
from learning_to_simulate.soil_field.tools import Wheel
from tests.learning_to_simulate.soil_field import worlds
from tests.learning_to_simulate.soil_field.scenes import DT, poses

H = 6


def rms(values):
    return 1e3 * np.sqrt(np.mean(np.square(values)))


def machine(mass, axis, force, target, stiffness=0.0, damping=0.0):
    """Of a tool that is free along an axis, where a force [T] acts beside soil and actuators."""
    load, only = np.zeros((len(target), 6)), np.arange(3) == axis
    load[:, axis] = force
    return Machine(mass, 0.0, tuple(only), stiffness * only, damping * only, target, load)


def free_run():
    """A blade that its load presses down while it goes along: 2000 N per m of depth bear it. It is
    not lifted again: in the air no load says how high it is."""
    way = worlds.path(3)[:41]
    load = 2000.0 * np.maximum(worlds.TOOL.radius - way[:, 1], 0.0)
    # So light that it does not swing on a soil of 2000 N/m.
    pressed = machine(0.05, 1, -load, poses(way * [1, 0, 1]))
    return worlds.run(3, way=way, machine=pressed, kind='free')


def jumping_run():
    run = worlds.run(4, kind='jumps')
    run.pose[30:, 0] -= 2.0
    return run


@pytest.fixture(scope='module')
def judged():
    """Runs, results and summary; not to be changed."""
    runs = [worlds.run(17), worlds.run(21), free_run(), jumping_run()]
    judge = evaluation.SoilEvaluator(worlds.trained()[0])
    return runs, *judge.run(runs, 'test')


def test_errors_are_those_of_the_arrays(judged):
    runs, results, summary = judged
    assert json.loads(json.dumps(summary)) == summary
    for run, (number, _, rollout), row in zip(runs[:2], results, summary['runs']['model']):
        assert (row['case'], row['record']) == (run.case, number)
        off, late = rollout.force - run.force, rollout.heights[2:] - run.heights[2:]
        size = np.linalg.norm(run.force[H:])
        assert row['force_relative_l2'] == pytest.approx(np.linalg.norm(off[H:]) / size)
        share = np.linalg.norm(off[H:, 0]) / np.linalg.norm(run.force[H:, 0])
        assert row['drawbar_relative_l2'] == pytest.approx(share)
        share = np.linalg.norm(off[H:, 1]) / np.linalg.norm(run.force[H:, 1])
        assert row['vertical_relative_l2'] == pytest.approx(share)
        assert row['pitch_rmse'] == pytest.approx(rms((rollout.torque - run.torque)[H:, 2]) / 1e3)
        assert row['side_rmse'] == pytest.approx(rms(off[H:, 2]) / 1e3)
        assert row['surface_mm'] == pytest.approx(rms(late))
        assert row['soil_mm'] == pytest.approx(rms((rollout.particles - run.particles)[2:]))
        assert row['surface_mm'] < row['near_mm']
        # The model stands beside what it knows: a soil that it has learned.
        still = summary['runs']['stay_still'][number]
        assert still['soil_mm'] == pytest.approx(rms(run.particles[2:] - run.particles[1]))
        assert row['force_relative_l2'] < 0.25 < still['force_relative_l2']
        assert row['near_mm'] < 0.6 * still['near_mm'] and row['soil_mm'] < 0.6 * still['soil_mm']
        assert row['status'] == 'ok' and row['flagged_share'] == 0


def test_a_run_without_a_load_counts_as_one_of_five_newtons_of_the_field():
    run = worlds.run(17)
    none = run._replace(force=0.0 * run.force)  # its parts have no number
    of_field = run.tool.units(run.soil)[0]
    force = np.full((len(run.pose) - H, 3), of_field) * [3.0, 4.0, 0.0]
    errors = evaluation.load_errors(none, force)
    assert errors['force_relative_l2'] == pytest.approx(1.0)
    assert not np.isfinite(errors['drawbar_relative_l2'])
    heavy = none._replace(soil=dataclasses.replace(run.soil, density=2 * run.soil.density))
    assert evaluation.load_errors(heavy, force)['force_relative_l2'] == pytest.approx(0.5)


def test_bounds_hold_on_the_runs_that_they_are_made_of(judged):
    runs, results, summary = judged
    rows = summary['runs']['model']
    bounds = evaluation.bounds_of(results, rows)
    for _, _, rollout in results[:3]:  # frames that are flagged promise nothing
        assert (evaluation._inside(rollout) == np.equal(rollout.frame_status[H:], 'ok')).all()
    field = dataclasses.replace(worlds.trained()[0], bounds=bounds)
    _, again = evaluation.SoilEvaluator(field, under_load=False).run(runs, 'test')
    lengths = []
    for run, (_, _, rollout), row in zip(runs[:3], results, again['runs']['model']):
        off = np.linalg.norm((rollout.force - run.force)[H:], axis=1)
        spread, size = (np.linalg.norm(x[H:], axis=1) for x in (rollout.spread, rollout.force))
        limit = np.stack([np.ones_like(size), spread, size], axis=1) @ bounds['force']
        # The bound is drawn through the error of a frame, which rounding may put on either side.
        least, most = ((off <= limit * (1.0 + way)).mean() for way in (-1e-5, 1e-5))
        assert least - 1e-9 <= row['bound_kept'] <= most + 1e-9 and least > 0.9
        assert row['bound_newton'] == pytest.approx(limit.mean())
        near = evaluation.near(run)
        maps = [
            rms((now - true)[near]) / (1 + rms((now - run.before().heights)[near]))
            for t, now, true in zip(rollout.frames, rollout.heights, run.heights)
            if t >= H and rollout.frame_status[t] == 'ok'
        ]
        assert row['near_95_mm'] == pytest.approx(np.quantile(maps, 0.95), rel=1e-5)
        lengths.append(row['near_95_mm'])
    assert bounds['near_mm'] == max(lengths)  # of three runs the worst
    assert 'bound_kept' not in rows[0]  # a field without bounds
    assert 'bound_kept' not in again['runs']['model'][3]  # a run that was refused


def test_summary_counts_by_run_and_kind(judged):
    _, _, summary = judged
    assert summary['status'] == {'ok': 3, 'non_finite': 1}
    assert set(summary['kinds']) == {'cut', 'free', 'jumps'}
    assert summary['kinds']['cut']['model']['runs'] == 2
    rows = summary['runs']['model']
    of_cut = np.median([rows[0]['soil_mm'], rows[1]['soil_mm']])
    assert summary['kinds']['cut']['model']['soil_mm'] == pytest.approx(of_cut)
    assert summary['wins']['stay_still']['soil_mm'] == [3, 4]
    assert 'under_load' not in summary['wins']
    text = tables.table(summary)
    for part in ('3 ok, 1 non_finite', 'cut, persistence', 'under its load', 'soil_mm 3 of 4'):
        assert part in text
    assert 'non_finite from frame 0: refused' in text  # a soil field has no nodes


def test_a_refused_run_is_no_number_and_stops_no_other(judged):
    row = judged[2]['runs']['model'][3]
    assert row['status'] == 'non_finite' and 'refused: the pose jumps' in row['status_reason']
    assert row['force_relative_l2'] is None and row['soil_mm'] is None
    assert judged[2]['mean']['model']['soil_mm'] is None
    errors = sorted(row['soil_mm'] for row in judged[2]['runs']['model'][:3])
    assert judged[2]['median']['model']['soil_mm'] == pytest.approx(sum(errors[1:]) / 2)


def test_a_tool_under_its_load_finds_its_height(judged):
    row = judged[2]['runs']['under_load'][0]
    depth = (worlds.TOOL.radius - worlds.path(3)[:, 1]).max()
    assert row['kind'] == 'free' and row['travel_mm'] < 1e-3
    assert row['height_mm'] < 0.2 * 1e3 * depth
    assert row['vertical_relative_l2'] < 0.15  # it is the load


def test_springs_and_dampers_pull_towards_a_target_that_moves():
    """In the air, at last: k (target - q) + c (target' - q') = 0 but for a push along x."""
    way = np.stack([0.3 * np.arange(41) * DT, np.full(41, 0.3), np.full(41, 0.1)], axis=1)
    pushed = machine(2.0, 0, 8.0, poses(way), 4e3, 400.0)
    run = worlds.run(0, way=way, machine=pushed)
    rollout = evaluation.SoilEvaluator(worlds.trained()[0]).roll_out(run, under_load=True)
    off = rollout.pose - run.pose
    assert off[-1, 0] == pytest.approx(8.0 / 4e3, abs=1e-5)
    np.testing.assert_allclose(off[:, 1:], 0.0, atol=1e-9)


def test_volumes_and_fronts_are_those_of_the_maps():
    run = worlds.run(5)
    before = run.before().heights
    assert not before.any()
    heights = np.repeat(before[None], len(run.heights), axis=0)
    heights[-1, 60:70, 10:30] -= 0.03  # 0.1 x 0.4 m: 1.2 litres
    heights[-1, 30:40, 10:30] += 0.02  # 0.8 litres, 0.3 m farther on
    found = evaluation.terrain_errors(run._replace(heights=heights), 0 * heights)
    assert found['true_cut_litre'] == pytest.approx(1.2)
    assert found['true_heap_litre'] == pytest.approx(0.8)
    assert found['net_error_litre'] == pytest.approx(0.4)
    tip = -run.pose[-1, 0]
    end = -(worlds.CORNER[0] + worlds.CELL[0] * 30)  # of the heap, along -x
    front = evaluation.front(run, before, heights)
    assert (front[:-1] == 0).all() and front[-1] == pytest.approx(end - tip, abs=0.006)
    near = evaluation.near(run)
    x = worlds.CORNER[0] + worlds.CELL[0] * (np.arange(len(near)) + 0.5)
    low = run.pose[:, 1] < worlds.TOOL.radius
    reach = evaluation.NEAR + worlds.TOOL.radius
    inside = (x > run.pose[low, 0].min() - reach) & (x < run.pose[low, 0].max() + reach)
    assert (near[:, 20] == inside).all() and not near[:, 0].any()


def test_the_formula_of_a_blade_is_that_of_its_depth_and_heap():
    """In a long straight cut the depth is the blade's, the heap what it has cut."""
    way = np.stack([np.linspace(0, 0.3, 61), np.full(61, -0.016), np.zeros(61)], axis=1)
    way[:4, 1] = 0.1, 0.08, 0.04, 0.014
    run = worlds.run(0, way=way)
    bucket = dataclasses.replace(run.tool, radius=0.004, bucket=1.0)
    assert evaluation.formula(run) and evaluation.formula(run._replace(tool=bucket)) is None
    force = evaluation._earthmoving(run)
    depth, heap = 0.03, 0.03 * (way[50, 0] + 0.01)
    soil = run.soil
    known = earthmoving.BladeSoil(
        soil.density * 9.81, np.arcsin(soil.friction), np.arctan(0.3), np.arctan(soil.friction),
        0.3, 0.277,
    )  # fmt: skip
    backward, up = earthmoving.cutting_force(depth, np.pi / 2, heap, known).sum(axis=0)
    np.testing.assert_allclose(force[50], [-backward, up, 0.0], rtol=0.05)


def test_the_formula_of_a_wheel_bears_its_load_and_pulls_where_it_slips():
    travel, slip = np.linspace(0, 0.1, 61), 0.4
    lean = -travel / (1 - slip) / 0.1  # rolls forward
    pose = poses(np.stack([travel, np.full(61, 0.1), lean], axis=1))
    wheel = worlds.run(0)._replace(
        tool=Wheel(0.08, 0.1), pose=pose, machine=machine(5.0, 1, -50.0, pose),
        force=0 * pose[:, :3] + 1, torque=0 * pose[:, :3] + 1,
    )  # fmt: skip
    place = evaluation.place_of(pose[0])
    force, torque = evaluation._terramechanics(wheel, place)
    np.testing.assert_allclose(force[6:, 1], 50.0, rtol=0.02)
    assert (force[20:, 0] > 0).all()  # forwards
    assert ((torque @ place.across)[20:] > 0).all()  # against the roll
    assert evaluation.formula(wheel._replace(machine=None)) is None


def test_what_a_bucket_holds_in_the_air_is_told_by_its_weight():
    way = worlds.path(3)[:30]
    up = np.linspace(way[-1], way[-1] + [0.0, 0.2, 0.3], 21)[1:]
    run = worlds.run(3, way=np.concatenate([way, up]))
    bucket = run._replace(tool=dataclasses.replace(run.tool, bucket=1.0))
    high = run.pose[:, 1] - run.tool.radius > run.tool.lifted
    assert 5 < high[30:].sum() < 20 and not high[1:30].any()
    unit = run.soil.density * run.soil.gravity * 1e-3  # N of a litre
    predicted = np.zeros_like(run.force)
    for force, litres in ((run.force, 0.5), (predicted, 2.0)):
        force[high] = [3.0, -litres * unit, 0.0]
    found = evaluation.payload_errors(types.SimpleNamespace(force=predicted), bucket)
    expected = {'payload_litre': 2.0, 'true_payload_litre': 0.5, 'payload_error_litre': 1.5}
    assert found == pytest.approx(expected)
    assert evaluation.payload_errors(types.SimpleNamespace(force=predicted), run) == {}
    stays = bucket._replace(pose=np.repeat(run.pose[20:21], 50, axis=0))
    assert evaluation.payload_errors(types.SimpleNamespace(force=predicted), stays) == {}
