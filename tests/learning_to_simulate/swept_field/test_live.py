"""Live steps against whole rollouts; beds that are given; bad input."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from learning_to_simulate.live.path_rollout import velocity_between
from learning_to_simulate.rollout_status import RolloutStatus
from learning_to_simulate.swept_field.live import FieldRoller, LiveField
from learning_to_simulate.tool.bed import HeightMap
from tests.learning_to_simulate.swept_field import small_wheel
from tests.learning_to_simulate.swept_field import small_world as world


@pytest.fixture(scope='module')
def field():
    return world.make_field()


@pytest.fixture(scope='module')
def wheel_field():
    return small_wheel.make_field()


def whole(field, plane, points):
    """Loads [T, 3] and particles [T, N, 3] of a path, all frames at once."""
    ground = field.ground(plane[0, 0, 0], np.array([field.blade.width]), points)
    speed = (plane[1, 0] - plane[0, 0]) / world.DT
    _, frames = field.frames(ground, plane[:, 0], world.DT, speed)
    moved = field.displacement(frames, ground.local).mean(axis=0)
    return field.loads(frames).mean(axis=0), ground.places + moved


def test_steps_are_the_frames_of_a_rollout(field):
    plane = world.path()
    loads, points = whole(field, plane, field.rest)
    live = world.make_live(field)
    first, second = world.world_pose(plane[:2, 0])
    live.start(first, velocity_between(first, second, world.DT))
    for t, pose in enumerate(world.world_pose(plane[1:, 0]), start=1):
        answer = live.step(pose)
        force, torque = field.axes.world_loads(loads[t])
        np.testing.assert_allclose(answer.force, force, atol=1e-2)
        np.testing.assert_allclose(answer.torque, torque, atol=1e-3)
        if t % 20 == 0:
            size = np.array([field.blade.width])
            out = points[t] + field.blade.inside(points[t], plane[t, 0], size)[1]
            there = field.axes.points(live.particles())
            np.testing.assert_allclose(there, out, atol=1e-5)
            assert field.blade.inside(there, plane[t, 0], size)[0].max() < 1e-6
    assert np.abs(loads).max() > 10


def test_a_kept_state_holds_its_bed_and_its_body(field):
    """Put back after a start on another bed with another body, it goes on to the same bits."""
    poses = world.world_pose(world.path()[:, 0])
    live = world.make_live(field)
    live.start(poses[0])
    for pose in poses[1:20]:
        live.step(pose)
    kept = live.state
    first = [live.step(pose) for pose in poses[20:40]]
    live.start(poses[0], bed=HeightMap([0.1, 0.9], [0.22, 0.22]), blade_width=0.3)
    live.state = kept
    again = [live.step(pose) for pose in poses[20:40]]
    np.testing.assert_array_equal([f.force for f in again], [f.force for f in first])
    np.testing.assert_array_equal(again[-1].particles(), first[-1].particles())


def test_what_a_frame_shows_cannot_be_written_to(field, wheel_field):
    plane = small_wheel.path()[:, 0]
    for live, poses in (
        (world.make_live(field, outside='hold'), world.world_pose(world.path()[:, 0])),
        (small_wheel.make_live(wheel_field), small_wheel.world_pose(plane)),
    ):
        live.start(poses[0])
        for frame in (live.state.frame, live.step(poses[1])):
            swept = frame.modes
            shown = (frame.force, frame.torque, frame.pose, frame.rigid_pose)
            for values in (*shown, *swept.frame, swept.pose, *swept.ground[:4]):
                with pytest.raises(ValueError, match='read-only'):
                    values += 1.0
        for part in (*live.state.ground.bed, live.state.frame.pose):
            assert not part.flags.writeable
    # What the model has, and others share, is as it was.
    assert field.rest.flags.writeable


def test_two_threads_are_told_so(field, monkeypatch):
    """The second one is refused while the first is at work; nothing of the first is lost."""
    poses = world.world_pose(world.path()[:, 0])
    live = world.make_live(field)
    live.start(poses[0])
    first = live.state
    begun, answered = threading.Event(), threading.Event()
    whole = field.loads

    def slow(*args):
        begun.set()
        assert answered.wait(60)
        return whole(*args)

    monkeypatch.setattr(field, 'loads', slow)
    with ThreadPoolExecutor(1) as pool:
        step = pool.submit(live.step, poses[1])
        assert begun.wait(60)
        for call in (
            lambda: live.step(poses[1]),
            lambda: live.start(poses[0]),
            lambda: setattr(live, 'state', first),
        ):
            with pytest.raises(RuntimeError, match='another thread'):
                call()
        answered.set()
        frame = step.result(60)
    assert live.state.frame is frame and live.state.count == 1
    live.step(poses[2])


def test_the_state_does_not_grow(field):
    poses = world.world_pose(world.path()[:, 0])
    live = world.make_live(field)
    live.start(poses[0])

    def size():
        tool = live.state.tool
        arrays = [*tool.swept, *tool[1:]]
        return sum(a.nbytes for a in arrays)

    before = size()
    for _ in range(5):
        for pose in [*poses[1:], *poses[-2::-1]]:
            live.step(pose)
    assert size() == before


def test_a_bed_may_be_given_as_particles_or_as_heights(field):
    plane = world.path()
    poses = world.world_pose(plane[:, 0])
    live = world.make_live(field)

    def force_on(bed):
        live.start(poses[0], bed=bed)
        return np.array([live.step(pose).force for pose in poses[1:40]])

    flat = force_on(None)
    np.testing.assert_array_equal(force_on(field.rest), flat)
    places = np.linspace(0.1, 0.9, 9)
    level = HeightMap(places, np.full(9, world.SURFACE))
    np.testing.assert_allclose(force_on(level), flat, atol=0.5)
    lower = force_on(HeightMap(places, np.full(9, world.SURFACE - 0.03)))
    assert np.abs(lower - flat).max() > 5


def test_height_map_and_what_is_left_out(field):
    poses = world.world_pose(world.path()[:, 0])
    live = world.make_live(field)
    live.start(poses[0])
    heights = live.state.frame.height_map(8, 4)
    np.testing.assert_allclose(heights, field.rest[:, 1].max(), atol=1e-7)
    assert live.explain().startswith(f'0 of {len(field.rest)}')
    for pose in poses[1:]:
        live.step(pose)
    assert np.nanmax(np.abs(live.state.frame.height_map(8, 4) - heights)) > 1e-3


def test_status_says_what_is_unlike_training(field):
    poses = world.world_pose(world.path()[:, 0])
    live = world.make_live(field)
    assert live.start(poses[0]).status == RolloutStatus.OK
    ranges = dict(field.ranges)
    try:
        field.ranges['lean'] = [0.0, 0.1]
        judged = live.step(poses[1]).judgement
    finally:
        field.ranges = ranges
    assert judged.status == RolloutStatus.EXTRAPOLATING and 'lean' in judged.reason


def test_what_the_field_does_not_know_is_said_and_may_be_refused(field):
    """A turn, a way across, a start beside the bed; steps, starts and whole paths."""
    poses = world.world_pose(world.path()[:, 0])
    live = world.make_live(field)
    roller = FieldRoller(field, live._starts)
    aside = poses + [0, 0, 0.5, 0, 0, 0, 0]
    assert live.start(aside[30]).status == RolloutStatus.EXTRAPOLATING
    assert live.start(aside[0] + [0, 0.2, 0, 0, 0, 0, 0]).status == RolloutStatus.OK
    across = poses + np.linspace(0, 0.012, len(poses))[:, None] * [0, 0, 1, 0, 0, 0, 0]
    (rollout,) = roller.roll_out([roller.beginning(across)])
    live.start(across[0])
    now = [live.step(pose).now for pose in across[1:]]
    assert now == list(rollout.frame_status) and RolloutStatus.EXTRAPOLATING in now
    assert 'drift' in rollout.reason
    strict = world.make_live(field, outside='raise')
    strict.start(poses[0])
    for pose in poses[1:30]:
        strict.step(pose)
    with pytest.raises(ValueError, match='aside 0.5 is outside'):
        strict.step(aside[30])


@pytest.mark.parametrize(
    'change, message',
    [
        (lambda p: p + [0.2, 0, 0, 0, 0, 0, 0], 'jumps'),
        (lambda p: p - [0, 0.04, 0, 0, 0, 0, 0], 'floor'),
        (lambda p: p * np.nan, 'nan at'),
        (lambda p: p[:4], 'shape'),
        (lambda p: np.array([*p[:3], 2, 0, 0, 0]), 'must be 1'),
    ],
)
def test_bad_poses_are_refused_and_the_state_stays(field, change, message):
    plane = world.path()
    if message == 'floor':
        plane = world.path(depth=0.13)
    poses = world.world_pose(plane[:, 0])
    live = world.make_live(field)
    live.start(poses[0])
    for pose in poses[1:31]:
        live.step(pose)
    kept = live.state
    with pytest.raises(ValueError, match=message):
        live.step(change(poses[31]))
    assert live.state is kept


def test_bad_starts_are_refused(field):
    pose = world.world_pose(world.path()[0, 0])
    live = world.make_live(field)
    with pytest.raises(ValueError, match='start'):
        live.step(pose)
    for bed, message in (
        (np.zeros((4, 2)), 'shape'),
        (HeightMap([0.0, 1.0], [0.2]), 'height map'),
        (HeightMap([0.0, 1.0], [0.2, np.nan]), 'height map holds NaN'),
        (HeightMap([0.0, 1.0], [0.2, -3.0]), 'floor'),
    ):
        with pytest.raises(ValueError, match=message):
            live.start(pose, bed=bed)
    with pytest.raises(ValueError, match='blade_width'):
        live.start(pose, blade_width=-1.0)
    live.start(pose)
    with pytest.raises(ValueError, match='time must go on'):
        live.step(pose, dt=-0.1)
    with pytest.raises(ValueError, match='members'):
        world.make_live(field, members=9)


def test_a_wheel_finds_its_own_height_as_in_a_rollout(wheel_field):
    """Whatever height the user gives after the start; force, torque and soil with it."""
    field, plane = wheel_field, small_wheel.path()[:, 0]
    poses, contexts = small_wheel.world_pose(plane), small_wheel.contexts(plane)
    live = small_wheel.make_live(field)
    live.start(poses[0])
    ground, size = live.state.ground, small_wheel.SIZE
    np.testing.assert_allclose(ground.size, size)
    whole, frames = field.frames(ground, plane, small_wheel.DT)
    loads = field.loads(frames).mean(axis=0)
    for t in range(1, len(poses)):
        asked = poses[t] + [0, 0.03, 0, 0, 0, 0, 0]
        answer = live.step(asked, context=contexts[t])
        force, torque = field.axes.world_loads(loads[t, :3])
        np.testing.assert_allclose(answer.force, force, atol=1e-2)
        np.testing.assert_allclose(answer.torque, torque, atol=1e-3)
        assert answer.pose[1] == pytest.approx(whole[t, 1], abs=1e-6)
    assert np.abs(whole[:, 1] - plane[:, 1]).max() > 1e-3
    points = field.axes.points(live.particles())
    assert np.abs(points - ground.places).max() > 1e-3
    assert field.tool.inside(points, whole[-1], size)[0].max() < 1e-6


def test_only_the_load_of_a_wheel_may_change(wheel_field):
    poses = small_wheel.world_pose(small_wheel.path()[:, 0])
    live = small_wheel.make_live(wheel_field)
    live.start(poses[0])
    context = dict(zip(small_wheel.NAMES, small_wheel.CONTEXT))
    force = live.step(poses[1], context=context | {'load': 150.0}).force
    kept = live.state
    for changed, message in (
        ({'gravity': 9.81}, 'gravity'),
        ({'load': -1.0}, 'load is -1'),
        ({'slip': 0.2}, 'must name'),
    ):
        with pytest.raises(ValueError, match=message):
            live.step(poses[2], context=context | changed)
        assert live.state is kept
    # What was said of the load holds on.
    assert live.step(poses[2]).modes.pose[3] == 150.0 and np.isfinite(force).all()
    with pytest.raises(ValueError, match='a blade is asked for, the tool of this field is a wheel'):
        live.start(poses[0], blade_width=0.3)


def test_a_kept_state_of_a_wheel_holds_its_start(wheel_field):
    """Wheel, bed and soil of the other start are not those of the state."""
    plane = small_wheel.path()[:, 0]
    poses = small_wheel.world_pose(plane)
    live = LiveField(wheel_field, **small_wheel.two_starts(wheel_field))
    live.start(poses[0], case=7)
    for pose in poses[1:15]:
        live.step(pose)
    kept = live.state
    first = [live.step(pose) for pose in poses[15:30]]
    live.start(case=8)
    assert live.start_index == 1
    live.state = kept
    assert live.start_index == 0
    again = [live.step(pose) for pose in poses[15:30]]
    for name in ('force', 'torque', 'pose', 'rigid_pose'):
        np.testing.assert_array_equal(*([getattr(f, name) for f in x] for x in (again, first)))
    np.testing.assert_array_equal(again[-1].particles(), first[-1].particles())


def test_a_path_takes_no_other_context_than_steps_do(wheel_field):
    plane = small_wheel.path()[:, 0]
    poses, contexts = small_wheel.world_pose(plane), small_wheel.contexts(plane)
    parts = small_wheel.two_starts(wheel_field)
    roller, live = FieldRoller(wheel_field, **parts), LiveField(wheel_field, **parts)
    roller.beginning(poses, context=contexts)
    for name, first, value, message in (
        ('gravity', 1, 9.81, 'gravity cannot change on the way, from 3.72 to 9.81'),
        ('friction_angle_deg', 20, 30.0, 'friction_angle_deg cannot change'),
        ('load', 60, -8.0, 'the load is -8, must be positive'),
        ('load', 0, 0.0, 'the load is 0, must be positive'),
        ('gravity', 0, 0.0, 'the gravity is 0, must be positive'),
    ):
        wrong = contexts.copy()
        wrong[first:, small_wheel.NAMES.index(name)] = value
        with pytest.raises(ValueError, match=message):
            roller.beginning(poses, context=wrong)
        if not first:
            with pytest.raises(ValueError, match=message):
                roller.beginning(poses, context=wrong[0])
            with pytest.raises(ValueError, match=message):
                live.start(poses[0], context=wrong[0])
            continue
        live.start(poses[0], context=wrong[0])
        with pytest.raises(ValueError, match=message):
            for pose, context in zip(poses[1:], wrong[1:]):
                live.step(pose, context=context)
