"""Bounds on made-up errors, and the status of frames: what the field does not know is said."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from learning_to_simulate.rollout_status import RolloutStatus
from learning_to_simulate.swept_field import calibration
from learning_to_simulate.swept_field.calibration import CONDITIONS
from tests.learning_to_simulate.swept_field import small_wheel, small_world


def made_up_runs(rng, count):
    """Errors that grow with spread and size, each run with a luck of its own."""
    runs = []
    for _ in range(count):
        spreads, sizes = rng.uniform(0, 2, (2, 60))
        luck = rng.lognormal(sigma=0.3)
        errors = luck * (0.2 + spreads + 0.5 * sizes) * rng.lognormal(sigma=0.2, size=60)
        runs.append((errors, spreads, sizes))
    return runs


def kept(runs, weights):
    """Share [n] of the frames of each run within their bound."""
    return np.array([(e <= calibration.bound(s, z, weights)).mean() for e, s, z in runs])


@pytest.mark.parametrize('count', [11, 30])
def test_nine_of_ten_new_runs_have_95_percent_of_their_frames_within(count):
    rng = np.random.default_rng(0)
    held, ratio = [], []
    for _ in range(150):
        weights = calibration.calibrate(made_up_runs(rng, count), 'soil')
        fresh = made_up_runs(rng, 20)
        held.append((kept(fresh, weights) >= 0.95).mean())
        ratio.append([calibration.bound(s, z, weights).mean() / e.mean() for e, s, z in fresh])
    assert 0.88 < np.mean(held) < 0.96
    assert np.median(ratio) < 3  # no bound that says nothing


def test_few_runs_give_the_bound_of_the_worst_of_them():
    runs = made_up_runs(np.random.default_rng(1), 5)
    weights = calibration.calibrate(runs, 'soil')
    shares = kept(runs, weights)
    assert shares.min() >= 0.95 and (shares < 1.0).any()
    groups = calibration.reliability(runs, weights)
    assert len(groups) == 5 and min(g['within'] for g in groups) > 0.9
    bounds = [g['bound'] for g in groups]
    assert bounds == sorted(bounds)


SCALARS = small_world.BLADE.scalars


@pytest.mark.parametrize('name', SCALARS)
def test_each_scalar_of_each_frame_is_judged(name):
    ranges = calibration.limits_of({scalar: [-1.0, 1.0] for scalar in SCALARS}, SCALARS)
    scalars = np.zeros((3, len(SCALARS)))
    assert ranges.judge(scalars).status == RolloutStatus.OK
    scalars[1, SCALARS.index(name)] = 1.2
    assert ranges.outside(scalars).any(axis=1).tolist() == [False, True, False]
    judged = ranges.judge(scalars, 5)
    assert judged.status == RolloutStatus.EXTRAPOLATING and judged.frame == 6
    assert f'{name} 1.2 is outside' in judged.reason
    assert ranges.judge(scalars, 5, finite=False).status == RolloutStatus.NON_FINITE


def turned(pose, axis, degrees):
    """A pose [7] turned about an axis of the world."""
    turn = Rotation.from_rotvec(np.radians(degrees) * np.eye(3)[axis])
    now = Rotation.from_quat(np.roll(pose[3:], -1))
    return np.concatenate([pose[:3], np.roll((turn * now).as_quat(), 1)])


def moved(pose, **steps):
    """A pose [7] moved along axes of the world, m."""
    return pose + np.array([*(steps.get(name, 0.0) for name in 'xyz'), 0, 0, 0, 0])


# What is done to the poses of a frame in the soil -> what its status names; axes: x along, y up.
UNKNOWN = {
    'yaw': lambda was, now: (was, turned(now, 1, 5.0)),
    'roll': lambda was, now: (was, turned(now, 0, 5.0)),
    'aside': lambda was, now: (moved(was, z=0.5), moved(now, z=0.5)),
    'drift': lambda was, now: (was, moved(now, z=0.002)),
}


@pytest.mark.parametrize('world', [small_world, small_wheel], ids=['blade', 'wheel'])
@pytest.mark.parametrize('name', UNKNOWN)
def test_motion_out_of_the_plane_of_travel_is_not_ok(world, name):
    field = world.make_field()
    plane = world.path()
    path = world.world_pose(plane[:, 0])
    frame = world.frames(plane).at(slice(30, 31))
    was, now = UNKNOWN[name](path[29], path[30])
    assert field.limits.judge(field.judged(path[30:31], frame, world.DT, path[29])).status == 'ok'
    judged = field.limits.judge(field.judged(now[None], frame, world.DT, was))
    assert judged.status == RolloutStatus.EXTRAPOLATING and judged.reason.startswith(name)
    # A little of it is what motors and floats do.
    small = path[30] + 0.01 * (now - path[30])
    before = path[29] + 0.01 * (was - path[29])
    values = field.judged(small[None], frame, world.DT, before)
    assert field.limits.judge(values).status == RolloutStatus.OK


def test_a_bed_too_high_is_not_ok():
    world = small_world
    field, path = world.make_field(), world.world_pose(world.path()[:, 0])
    surface = np.full((1, len(world.GRID.offsets)), world.SURFACE)
    surface[0, 60:80] += 0.2
    frames = world.frames(world.path(), surface).at(slice(30, 31))
    judged = field.limits.judge(field.judged(path[30:31], frames, world.DT, path[29]))
    assert judged.reason.startswith('bed_high 0.2')


def test_in_the_air_a_blade_may_turn_and_move_as_it_likes():
    world = small_world
    field = world.make_field()
    plane = world.path()[:2] + [[0.0, 0.2, 0.0]]
    path = world.world_pose(plane[:, 0])
    frames = world.frames(plane)
    for change in UNKNOWN.values():
        was, now = change(*path)
        values = field.judged(np.stack([was, now]), frames, 5.0)
        assert field.limits.judge(values).status == RolloutStatus.OK
    assert set(UNKNOWN) < set(CONDITIONS)
