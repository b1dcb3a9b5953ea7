"""The status of frames: what the field does not know is said."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from learning_to_simulate.rollout_status import RolloutStatus
from learning_to_simulate.swept_field import calibration
from learning_to_simulate.swept_field.calibration import CONDITIONS
from tests.learning_to_simulate.swept_field import small_wheel, small_world

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
