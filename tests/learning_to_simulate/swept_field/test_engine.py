"""Steps of a swept field, by TensorFlow and by C: against whole paths; given beds; bad input."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from learning_to_simulate.live import paths
from learning_to_simulate.live.paths import velocity_between
from learning_to_simulate.live.stepper import Stepper
from learning_to_simulate.native import library
from learning_to_simulate.native.engines import CFieldEngine
from learning_to_simulate.rollout_status import RolloutStatus
from learning_to_simulate.swept_field.engine import FieldEngine
from learning_to_simulate.tool.bed import HeightMap
from tests.learning_to_simulate.swept_field import small_wheel
from tests.learning_to_simulate.swept_field import small_world as world

ENGINES = [
    FieldEngine,
    pytest.param(
        CFieldEngine,
        marks=pytest.mark.skipif(
            not any(map(library.shutil.which, ('cc', 'gcc', 'clang'))), reason='no C compiler'
        ),
    ),
]


def as_loaded(field):
    """As of a model folder: places on the edge of two slabs fall to the same side then."""
    field.rest = field.rest.astype(np.float32).astype(np.float64)
    return field


@pytest.fixture(scope='module')
def field():
    return as_loaded(world.make_field())


@pytest.fixture(scope='module')
def wheel_field():
    return as_loaded(small_wheel.make_field())


@pytest.fixture(scope='module', params=ENGINES, ids=['tensorflow', 'c'])
def engine(request):
    return request.param


@pytest.fixture(scope='module')
def live(field, engine):
    return Stepper(engine(field, world.make_starts(field)))


@pytest.fixture(scope='module')
def wheel(wheel_field, engine):
    """A stepper of two starts, cases 7 and 8."""
    return Stepper(engine(wheel_field, **small_wheel.two_starts(wheel_field)))


@pytest.fixture(scope='module')
def poses():
    return world.world_pose(world.path()[:, 0])


def whole(field, plane, points):
    """Loads [T, 3] and particles [T, N, 3] of a path, all frames at once."""
    ground = field.ground(plane[0, 0, 0], np.array([field.tool.width]), points)
    speed = (plane[1, 0] - plane[0, 0]) / world.DT
    _, frames = field.frames(ground, plane[:, 0], world.DT, speed)
    moved = field.displacement(frames, ground.local).mean(axis=0)
    return field.loads(frames).mean(axis=0), ground.places + moved


def test_steps_are_the_frames_of_a_whole_path(field, live, poses):
    plane = world.path()
    loads, points = whole(field, plane, field.rest)
    live.start(poses[0], velocity_between(*poses[:2], world.DT))
    frames = [live.step(pose) for pose in poses[1:]]
    size = np.array([field.tool.width])
    for t, frame in enumerate(frames, start=1):
        force, torque = field.axes.world_loads(loads[t])
        np.testing.assert_allclose(frame.force, force, atol=1e-2)
        np.testing.assert_allclose(frame.torque, torque, atol=1e-3)
        if t % 20 == 0:  # of frames that are long past, too
            out = points[t] + field.tool.inside(points[t], plane[t, 0], size)[1]
            there = field.axes.points(frame.particles())
            np.testing.assert_allclose(there, out, atol=1e-5)
            assert field.tool.inside(there, plane[t, 0], size)[0].max() < 1e-6
    assert np.abs(loads).max() > 10
    rollout = paths.roll_out(live, poses)
    np.testing.assert_array_equal(rollout.force, np.float32([frame.force for frame in frames]))
    np.testing.assert_array_equal(rollout.particles(-1), frames[-1].particles())


@pytest.mark.parametrize('tool', ['blade', 'wheel'])
def test_a_kept_state_holds_its_bed_and_its_body(live, wheel, poses, tool):
    """Put back after a start on another bed with another body, it goes on to the same bits."""
    if tool == 'blade':
        stepper, first = live, {'pose': poses[0]}
        other = {'pose': poses[0], 'bed': HeightMap([0.1, 0.9], [0.22, 0.22]), 'blade_width': 0.3}
    else:
        poses = small_wheel.world_pose(small_wheel.path()[:, 0])
        stepper, first, other = wheel, {'pose': poses[0], 'case': 7}, {'case': 8}
    stepper.start(**first)
    for pose in poses[1:15]:
        stepper.step(pose)
    kept = stepper.state
    shown = stepper.particles()
    frames = [stepper.step(pose) for pose in poses[15:30]]
    stepper.start(**other)
    stepper.state = kept
    assert stepper.state.start is kept.start
    np.testing.assert_array_equal(stepper.particles(), shown)
    again = [stepper.step(pose) for pose in poses[15:30]]
    for name in ('force', 'torque', 'pose', 'rigid_pose'):
        np.testing.assert_array_equal(*([getattr(f, name) for f in x] for x in (again, frames)))
    np.testing.assert_array_equal(again[-1].particles(), frames[-1].particles())


def test_what_a_frame_shows_cannot_be_written_to(field, live, wheel, poses):
    for stepper, pair in ((live, poses), (wheel, small_wheel.world_pose(small_wheel.path()[:, 0]))):
        stepper.start(pair[0])
        frame = stepper.step(pair[1])
        arrays = [frame.force, frame.torque, frame.pose]
        if hasattr(frame.soil, 'ground'):
            ground = frame.soil.ground
            arrays += [*frame.soil.frame, frame.soil.pose, *ground[:4], *ground.bed]
        assert not any(values.flags.writeable for values in arrays)
    # What the model has, and others share, is as it was.
    assert field.rest.flags.writeable


def test_the_state_does_not_grow(live, poses):
    def size(kept):
        if isinstance(kept, tuple):
            return sum(map(size, kept))
        return getattr(kept, 'nbytes', len(kept) if isinstance(kept, bytes) else 0)

    live.start(poses[0])
    before = size(live.state.of_engine)
    for pose in [*poses[1:], *poses[-2::-1]] * 2:
        live.step(pose)
    assert size(live.state.of_engine) == before > 0


def test_a_bed_may_be_given_as_particles_or_as_heights(field, live, poses):
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
    # Of another number of particles: C says who steps it, and comes back.
    force_on(field.rest[::2])
    assert live.engine.startswith('TensorFlow')
    kept, name = live.state, live.engine
    np.testing.assert_array_equal(force_on(None), flat)
    live.state = kept
    assert live.engine == name and len(live.step(poses[40]).particles()) == len(field.rest[::2])
    live.start(poses[0])


def test_height_map_and_what_is_left_out(field, live, poses):
    live.start(poses[0])
    heights = live.state.frame.height_map(8, 4)
    np.testing.assert_allclose(heights, field.rest[:, 1].max(), atol=1e-7)
    assert live.explain().startswith(f'0 of {len(field.rest)}')
    for pose in poses[1:]:
        frame = live.step(pose)
    assert np.nanmax(np.abs(frame.height_map(8, 4) - heights)) > 1e-3
    with pytest.raises(ValueError, match='subspace'):
        print(frame.modes)


def test_what_the_field_does_not_know_is_said_and_may_be_refused(field, engine, live, poses):
    """Ranges of training, a turn, a roll, a way across, a start beside the bed, a long frame."""

    def go(stepper):
        stepper.start(poses[0])
        for pose in poses[1:31]:
            stepper.step(pose)

    assert live.start(poses[0]).status == RolloutStatus.OK
    field.ranges, kept = field.ranges | {'room': [0.0, 0.1]}, field.ranges
    try:
        judged = Stepper(engine(field, world.make_starts(field))).start(poses[0])
    finally:
        field.ranges = kept
    assert judged.status == RolloutStatus.EXTRAPOLATING and judged.reason.startswith('room')
    strict = Stepper(engine(field, world.make_starts(field)), 'raise')
    turned, rolled, aside, across = (poses.copy() for _ in range(4))
    for path, axis in ((turned, 1), (rolled, 0)):
        for pose in path:
            now = Rotation.from_quat(np.roll(pose[3:], -1))
            turn = Rotation.from_rotvec(np.radians(10.0) * np.eye(3)[axis])
            pose[3:] = np.roll((turn * now).as_quat(), 1)
    aside[:, 2] += 0.5
    across[31, 2] += 0.003
    for path, name in ((aside, 'aside 0.5'), (across, 'drift'), (turned, 'yaw'), (rolled, 'roll')):
        go(live)
        go(strict)
        frame = live.step(path[31])
        assert frame.now == RolloutStatus.EXTRAPOLATING and name.split()[0] in frame.reason
        with pytest.raises(ValueError, match=f'{name}.* is outside'):
            strict.step(path[31])
        assert strict.step(poses[31]).now == RolloutStatus.OK
    assert live.start(aside[30]).status == RolloutStatus.EXTRAPOLATING
    assert live.start(aside[0] + [0, 0.2, 0, 0, 0, 0, 0]).status == RolloutStatus.OK
    go(live)
    assert 'frame_time 1000' in live.step(poses[31], dt=1000.0).reason


def test_a_press_is_no_cut(field, engine):
    """35 mm straight down, held, lifted, driven on, pressed again and lifted: flagged while it
    presses, alike in Python and in C; nowhere else."""
    down, level, still = np.array([0, -0.0011, 0]), np.array([0.003, 0, 0]), np.zeros(3)
    steps = 32 * [down] + 5 * [still] + 27 * [-down] + 40 * [level] + 25 * [down] + 10 * [-3 * down]
    plane = [-0.75, world.SURFACE + world.BLADE.radius, 0.4] + np.cumsum([still, *steps], axis=0)
    poses = world.world_pose(plane)
    field.ranges, kept = field.ranges | {'pressed': [0.0, 0.02]}, field.ranges
    try:
        live = Stepper(engine(field, world.make_starts(field)))
        live.start(poses[0])
        frames = [live.step(pose) for pose in poses[1:]]
    finally:
        field.ranges = kept
    flagged = np.array([frame.now != RolloutStatus.OK for frame in frames], int)
    assert np.flatnonzero(np.diff(flagged)).tolist() == [18, 37, 122, 128]
    assert 'pressed 0.022 is outside' in frames[-1].reason


@pytest.mark.parametrize(
    'change, message',
    [
        (lambda p: p + [0.2, 0, 0, 0, 0, 0, 0], 'jumps: .* at most 3.0 and 20.0 are taken'),
        (lambda p: p - [0, 0.04, 0, 0, 0, 0, 0], 'under the floor of the bed at'),
        (lambda p: None, 'takes a pose'),
    ],
)
def test_bad_poses_are_refused_and_the_state_stays(live, change, message):
    plane = world.path(depth=0.13 if 'floor' in message else 0.04)
    poses = world.world_pose(plane[:, 0])

    def go(bad):
        live.start(poses[0])
        for pose in poses[1:31]:
            live.step(pose)
        if bad:
            with pytest.raises(ValueError, match=message):
                live.step(change(poses[31]))
        return live.step(poses[30])

    one, other = go(True), go(False)
    np.testing.assert_array_equal(one.force, other.force)
    np.testing.assert_array_equal(one.particles(), other.particles())


def test_bad_starts_and_ways_beyond_the_bins_are_refused(field, live, poses):
    for start, message in (
        ({'bed': np.zeros((4, 2))}, 'shape'),
        ({'bed': HeightMap([0.0, 1.0], [0.2])}, 'height map'),
        ({'bed': HeightMap([0.0, 1.0], [0.2, np.nan])}, 'holds NaN'),
        ({'bed': HeightMap([0.0, 1.0], [0.2, -3.0])}, 'floor'),
        ({'blade_width': -1.0}, 'blade_width'),
    ):
        with pytest.raises(ValueError, match=message):
            live.start(poses[0], **start)
    with pytest.raises(ValueError, match='begins from a pose'):
        live.reset(np.zeros((6, 8, 3)))
    with pytest.raises(ValueError, match='members'):
        world.make_live(field, members=9)
    live.start(poses[0])
    with pytest.raises(ValueError, match='time must go on'):
        live.step(poses[1], dt=-0.1)
    along = world.world_pose(np.array([[-0.85 + 0.02 * t, 0.4, 0.4] for t in range(50)]))
    live.start(along[0])
    with pytest.raises(ValueError, match='from .*first'):
        for pose in along[1:]:
            live.step(pose)


def test_a_wheel_finds_its_own_height_as_on_a_whole_path(wheel_field, wheel):
    """Whatever height the user gives after the start; force, torque and soil with it."""
    field, plane = wheel_field, small_wheel.path()[:, 0]
    poses, contexts = small_wheel.world_pose(plane), small_wheel.contexts(plane)
    wheel.start(poses[0], case=7)
    size, decoded = small_wheel.SIZE, small_wheel.BentBeds(field.rest).decode(np.zeros((4, 3)))
    ground = field.ground(field.axes.plane(poses[:1])[0, 0], size, decoded)
    whole, frames = field.frames(ground, plane, small_wheel.DT, np.zeros(2))
    loads = field.loads(frames).mean(axis=0)
    for t in range(1, len(poses)):
        frame = wheel.step(poses[t] + [0, 0.03, 0, 0, 0, 0, 0], context=contexts[t])
        force, torque = field.axes.world_loads(loads[t, :3])
        np.testing.assert_allclose(frame.force, force, atol=1e-2)
        np.testing.assert_allclose(frame.torque, torque, atol=1e-3)
        assert frame.pose[1] == pytest.approx(whole[t, 1], abs=1e-6)
    assert np.abs(whole[:, 1] - plane[:, 1]).max() > 1e-3
    points = field.axes.points(wheel.particles())
    assert np.abs(points - ground.places).max() > 1e-3
    assert field.tool.inside(points, whole[-1], size)[0].max() < 1e-6


def test_only_the_load_of_a_wheel_may_change(wheel):
    """In steps, at the start and on whole paths."""
    plane = small_wheel.path()[:, 0]
    poses, contexts = small_wheel.world_pose(plane), small_wheel.contexts(plane)
    context = dict(zip(small_wheel.NAMES, small_wheel.CONTEXT))
    wheel.start(poses[0], case=7)
    wheel.step(poses[1], context=context | {'load': 150.0})
    for changed, message in (
        ({'gravity': 9.81}, 'gravity cannot change on the way, from 3.72 to 9.81'),
        ({'friction_angle_deg': 30.0}, 'friction_angle_deg cannot change'),
        ({'load': -1.0}, 'load is -1, must be positive'),
        ({'slip': 0.2}, 'must name'),
    ):
        with pytest.raises(ValueError, match=message):
            wheel.step(poses[2], context=context | changed)
    # What was said of the load holds on.
    heavy = wheel.step(poses[2]).force
    wheel.start(poses[0], case=7)
    wheel.step(poses[1])
    assert np.abs(heavy - wheel.step(poses[2]).force).max() > 1.0
    with pytest.raises(ValueError, match='blade_width'):
        wheel.start(poses[0], blade_width=0.3)
    for name, first, value, message in (
        ('gravity', 20, 9.81, 'gravity cannot change'),
        ('load', 60, -8.0, 'the load is -8'),
        ('load', 0, 0.0, 'the load is 0'),
    ):
        wrong = contexts.copy()
        wrong[first:, small_wheel.NAMES.index(name)] = value
        with pytest.raises(ValueError, match=message):
            paths.roll_out(wheel, poses, context=wrong)
