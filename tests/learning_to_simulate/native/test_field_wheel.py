"""A wheel's swept field in C against its numpy and TensorFlow twins."""

import numpy as np
import pytest

from learning_to_simulate.live.stepper import Stepper
from learning_to_simulate.native import library
from learning_to_simulate.native.binding import KERNELS, CField, KernelLacks
from learning_to_simulate.swept_field.engine import FieldEngine
from learning_to_simulate.tool.bed import HeightMap
from tests.learning_to_simulate.swept_field import small_wheel as world

pytestmark = pytest.mark.skipif(
    not any(map(library.shutil.which, ('cc', 'gcc', 'clang'))), reason='no C compiler'
)
BOUND = [1.5, 2.0, 0.1]
FLAT = np.linspace(0.1, 0.5, 5)
MAP = HeightMap(FLAT, world.SURFACE + np.array([-0.004, 0.006, 0.0, 0.004, -0.002]))


@pytest.fixture(scope='module')
def parts():
    """The field, and its starts and subspace by name: two wheels on two beds."""
    field = world.make_field()
    field.calibration = {'force': BOUND}
    field.rest = field.rest.astype(np.float32).astype(np.float64)
    return field, world.two_starts(field)


def live(parts):
    """The stepper of Python."""
    field, of_start = parts
    return Stepper(FieldEngine(field, of_start['starts'], of_start['subspace']))


def play(soil, poses, given, dt=None):
    """Loads [T, 6], bounds [T], heights [T] and particles [T, N, 3] of steps, in C or in Python."""
    frames, points, heights = [], [], []
    for pose, context in zip(poses, given, strict=True):
        frame = soil.step(pose, context=context, dt=dt)
        frames.append(np.concatenate([frame.force, frame.torque]))
        heights.append([frame.bound, frame.point[1] if hasattr(frame, 'point') else frame.pose[1]])
        points.append(soil.particles())
    return np.array(frames), *np.array(heights, np.float64).T, np.array(points)


def assert_same(one, other):
    loads, bounds, heights, points = other
    assert np.abs(loads).max() > 10 and np.abs(points[-1] - points[0]).max() > 1e-3
    assert np.ptp(heights) > 1e-4
    np.testing.assert_allclose(one[0], loads, atol=1e-5 * np.abs(loads).max())
    np.testing.assert_allclose(one[1], bounds, rtol=1e-4)
    np.testing.assert_allclose(one[2], heights, atol=1e-7)
    np.testing.assert_allclose(one[3], points, atol=1e-6)


def poses_and_loads(n_frame=61, dt=world.DT):
    plane = world.path(n_frame, dt)[:, 0]
    return world.world_pose(plane), world.contexts(plane)


@pytest.mark.parametrize('kernel', KERNELS)
def test_equals_the_twin_on_a_whole_path(parts, kernel):
    poses, given = poses_and_loads()
    try:
        soil = CField.of(parts[0], kernel, **parts[1])
    except KernelLacks as error:
        pytest.skip(str(error))
    python = live(parts)
    for one in (soil, python):
        one.start(poses[0], context=given[0])
    assert_same(play(soil, poses[1:], given[1:]), play(python, poses[1:], given[1:]))


@pytest.mark.parametrize('dt', [1 / 240, 1 / 13])
def test_steps_of_any_length_from_another_start_on_a_given_bed(parts, dt):
    """The second wheel is smaller, on other soil, and already on its way."""
    poses, given = poses_and_loads(1 + int(1 / dt), dt)
    given[:, :2] = 9.81, 30.0
    velocity = np.array([-0.02, 0.0, 0.0, 0.0, 0.0, 0.3])
    for bed in (None, MAP):
        soil, python = CField.of(parts[0], **parts[1]), live(parts)
        soil.start(poses[0], velocity, bed, index=1, context=given[0])
        python.start(poses[0], velocity, case=8, bed=bed, context=given[0])
        assert_same(play(soil, poses[1:], given[1:], dt), play(python, poses[1:], given[1:], dt))


def test_begins_at_the_nearest_start_or_at_the_one_that_is_named(parts):
    soil = CField.of(parts[0], **parts[1])
    for index, context in enumerate(parts[1]['starts'].context):
        pose, stated = soil.start_of(index)
        np.testing.assert_array_equal(pose, parts[1]['starts'].pose[index])
        np.testing.assert_array_equal(stated, context)
        soil.start(index=index)
        named, beds = soil.save(), soil.particles()
        soil.start(context=context * [1.0, 1.001, 1.0])
        np.testing.assert_array_equal(soil.particles(), beds)
        soil.start(context=context)
        assert soil.save() == named
    with pytest.raises(ValueError, match='start is 2'):
        soil.start(index=2)


def test_a_wheel_that_would_sink_under_the_floor_leaves_the_state_as_it_was(parts):
    poses, given = poses_and_loads()
    shallow = HeightMap(np.array([0.1, 0.5]), np.array([0.118, 0.118]))
    field = world.make_field()
    for part in field.network.load.layers[-1]:
        part.assign(part * [1.0, 1.0, 1.0, -4.0])
    soil, python = CField.of(field, **parts[1]), live((field, parts[1]))
    low = poses - [0, 0.05, 0, 0, 0, 0, 0]
    soil.start(low[0], bed=shallow, context=given[0])
    python.start(low[0], bed=shallow, context=given[0])
    for k in range(1, 61):
        kept = soil.save()
        try:
            python.step(low[k], context=given[k])
        except ValueError as error:
            assert 'floor' in str(error)
            with pytest.raises(ValueError, match='floor'):
                soil.step(low[k], context=given[k])
            assert soil.save() == kept and k > 1
            return
        soil.step(low[k], context=given[k])
    raise AssertionError('the wheel has not sunk: the test shows nothing')


def test_a_renewed_wheel_begins_on_the_bed_that_it_left(parts):
    poses, given = poses_and_loads()
    soil, python = CField.of(parts[0], **parts[1]), live(parts)
    soil.start(poses[0], context=given[0])
    for pose, context in zip(poses[1:30], given[1:30]):
        frame = soil.step(pose, context=context)
    soil_points = soil.particles()
    at = poses[29].copy()
    at[1] = frame.point[1]
    travel = (poses[29] - poses[28])[0] / world.DT
    turned = np.diff(world.path()[28:30, 0, 2])[0] / world.DT
    python.start(at, [travel, 0, 0, 0, 0, turned], bed=soil_points, context=given[29])
    soil.renew()
    # The angles that a velocity is made of here are rounded: 1e-12 of a bin.
    assert_same(play(soil, poses[30:50], given[30:50]), play(python, poses[30:50], given[30:50]))


def test_status_names_the_measure_that_left_its_range(parts):
    field, of_start = parts
    poses, given = poses_and_loads()
    ranges, expected = dict(field.ranges), {'first_load': 1, 'rim_1': 8, 'sunk': 4}
    for name, bit in expected.items():
        try:
            field.ranges[name] = [1e4, 2e4]
            soil = CField.of(field, **of_start)
        finally:
            field.ranges = dict(ranges)
        soil.start(poses[0], context=given[0])
        assert soil.step(poses[1]).status == bit
        assert soil.judgement.status == 'extrapolating'
        assert soil.judgement.reason.startswith(name)


def test_what_belongs_to_a_blade_is_refused(parts):
    poses, _ = poses_and_loads()
    soil = CField.of(parts[0], **parts[1])
    with pytest.raises(ValueError, match='blade_width'):
        soil.start(poses[0], blade_width=0.3)
    at = poses[0].copy()
    assert library.load().lts_field_start(soil.address, at.ctypes.data, None, None, 0.0) == -4
    with pytest.raises(ValueError, match='recorded starts'):
        CField.of(parts[0])
