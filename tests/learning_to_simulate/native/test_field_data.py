"""Swept fields in C against the steppers of Python, kernel by kernel."""

import ctypes

import numpy as np
import pytest

from learning_to_simulate.live.stepper import Stepper
from learning_to_simulate.native import field_data, library
from learning_to_simulate.native.binding import KERNELS, CField, KernelLacks
from learning_to_simulate.swept_field.calibration import CONDITIONS
from learning_to_simulate.swept_field.engine import FieldEngine
from learning_to_simulate.tool.bed import HeightMap
from learning_to_simulate.tool.blade import Blade
from learning_to_simulate.tool.inputs import Row, Table
from tests.learning_to_simulate.native import worlds
from tests.learning_to_simulate.swept_field import small_wheel, small_world

pytestmark = worlds.needs_c
TOOLS = tuple(worlds.FIELDS)
MAP = HeightMap(np.array([0.9, 0.1, 0.6, 0.3]), np.array([0.24, 0.26, 0.19, 0.25]))
PRINT = HeightMap(
    np.linspace(0.1, 0.5, 5), small_wheel.SURFACE + np.array([-4, 6, 0, 4, -2]) * 1e-3
)


@pytest.fixture(scope='module')
def fields():
    return {tool: worlds.field(tool) for tool in TOOLS}


@pytest.fixture(scope='module')
def blade(fields):
    return fields['blade'][0]


def pair(made):
    """A field in C, and its stepper by TensorFlow."""
    field, parts = made
    return CField.of(field, **parts), Stepper(FieldEngine(field, *parts.values()))


def drive(tool, n_frame=61, dt=1 / 60):
    """Poses [T, 7] and contexts of a path."""
    small = worlds.FIELDS[tool]
    plane = small.path(n_frame, dt=dt)[:, 0]
    contexts = small_wheel.contexts(plane) if tool == 'wheel' else [None] * n_frame
    return small.world_pose(plane), contexts


def play(soil, poses, contexts, dt=None):
    """Loads [T, 6], bounds [T], points [T, 3] and particles [T, N, 3], in C or in Python."""
    rows = []
    for pose, context in zip(poses, contexts, strict=True):
        frame = soil.step(pose, context=context, dt=dt)
        point = frame.point if hasattr(frame, 'point') else frame.pose[:3]
        load = np.concatenate([frame.force, frame.torque])
        rows.append((load, frame.bound, point, soil.particles()))
    return [np.array(column, np.float64) for column in zip(*rows)]


def assert_same(one, other):
    loads, bounds, places, points = other
    assert np.abs(loads).max() > 10 and np.abs(points[-1] - points[0]).max() > 1e-3
    assert np.ptp(places, axis=0)[1] > 1e-4
    np.testing.assert_allclose(one[0], loads, atol=1e-5 * np.abs(loads).max())
    np.testing.assert_allclose(one[1], bounds, rtol=1e-4)
    np.testing.assert_allclose(one[2], places, atol=1e-7)
    np.testing.assert_allclose(one[3], points, atol=1e-6)


@pytest.mark.parametrize('tool', TOOLS)
def test_every_kernel_equals_python_on_a_whole_path(fields, tool):
    field, parts = fields[tool]
    poses, contexts = drive(tool)
    _, python = pair(fields[tool])
    python.start(poses[0], context=contexts[0])
    expected = play(python, poses[1:], contexts[1:])
    for kernel in KERNELS:
        try:
            soil = CField.of(field, **parts, kernel=kernel)
        except KernelLacks:
            continue
        assert soil.kernel == kernel
        soil.start(poses[0], context=contexts[0])
        assert_same(play(soil, poses[1:], contexts[1:]), expected)


@pytest.mark.parametrize('dt', [1 / 240, 1 / 13])
@pytest.mark.parametrize('tool', TOOLS)
def test_steps_of_any_length_on_a_given_bed_with_another_tool(fields, tool, dt):
    """On its way; the second wheel is smaller, on other soil."""
    poses, contexts = drive(tool, 1 + int(1 / dt), dt)
    velocity = np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.3])
    soil, python = pair(fields[tool])
    if tool == 'blade':
        of_c = of_python = {'blade_width': 0.3}
    else:
        contexts[:, :2] = 9.81, 30.0
        of_c = {'index': 1, 'context': contexts[0]}
        of_python = {'case': 8, 'context': contexts[0]}
    bed = MAP if tool == 'blade' else PRINT
    python.start(poses[0], velocity, bed=bed, **of_python)
    particles = python.particles()
    expected = play(python, poses[1:], contexts[1:], dt)
    for given in (bed, np.asfortranarray(particles)):
        soil.start(poses[0], velocity, given, **of_c)
        np.testing.assert_allclose(soil.particles(), particles, atol=1e-6)
        assert_same(play(soil, poses[1:], contexts[1:], dt), expected)


def test_force_alone_and_particles_late_are_the_same_bits(blade):
    poses, contexts = drive('blade')
    soil, silent = CField.of(blade), CField.of(blade)
    for one in (soil, silent):
        one.start(poses[0])
    loads, *_, points = play(soil, poses[1:], contexts[1:])
    alone = np.array([np.concatenate(silent.step(pose)[:2]) for pose in poses[1:]])
    np.testing.assert_array_equal(alone, loads)
    np.testing.assert_array_equal(silent.particles(), points[-1])
    resting = len(blade.rest) - soil.call('moving')
    kept = (points[-1] == blade.rest.astype(np.float32)).all(axis=1)
    assert 0 < resting <= kept.sum() < len(blade.rest)


def test_fewer_members_answer_as_their_mean(blade):
    poses, contexts = drive('blade')
    soil, python = CField.of(blade), small_world.make_live(blade, members=1)
    soil.call('members', 1, 1)
    for one in (soil, python):
        one.start(poses[0])
    got, expected = (play(one, poses[1:], contexts[1:]) for one in (soil, python))
    for k in (0, 3):
        np.testing.assert_allclose(got[k], expected[k], atol=1e-5 * np.abs(expected[0]).max())
    with pytest.raises(ValueError, match='range'):
        soil.call('members', 4, 1)


@pytest.mark.parametrize('tool, bed', [('blade', None), ('blade', MAP), ('wheel', None)])
def test_states_come_back_bit_by_bit(fields, tool, bed):
    poses, contexts = drive(tool)
    soil, _ = pair(fields[tool])
    other = soil.another()
    soil.start(poses[0], bed=bed, context=contexts[0])
    play(soil, poses[1:20], contexts[1:20])
    saved = soil.save()
    first = play(soil, poses[20:40], contexts[20:40])
    for one in (soil, other):
        one.load_state(saved)
        for a, b in zip(first, play(one, poses[20:40], contexts[20:40])):
            np.testing.assert_array_equal(a, b)
    soil.load_state(saved)
    other.copy_state(soil)
    np.testing.assert_array_equal(play(other, poses[20:40], contexts[20:40])[3], first[3])
    for damaged in (saved[:-1], b'', saved[:200] + b'x' + saved[201:]):
        with pytest.raises(ValueError, match='damaged'):
            soil.load_state(damaged)
    assert soil.save() == saved


@pytest.mark.parametrize('tool', TOOLS)
def test_a_renewed_run_begins_on_the_bed_that_it_left(fields, tool):
    poses, contexts = drive(tool)
    soil, python = pair(fields[tool])
    soil.start(poses[0], context=contexts[0])
    play(soil, poses[1:29], contexts[1:29])
    frame = soil.step(poses[29], context=contexts[29])
    at, rate = poses[29].copy(), np.diff(worlds.FIELDS[tool].path()[28:30, 0], axis=0)[0] * 60
    velocity, options = np.zeros(6), {}
    velocity[:3] = (poses[29] - poses[28])[:3] * 60
    if tool == 'wheel':
        at[1], velocity[1], velocity[5] = frame.point[1], 0.0, rate[2]
        options = {'context': contexts[29]}
    else:
        velocity[5] = -rate[2]
    python.start(at, velocity, bed=soil.particles(), **options)
    soil.call('renew')
    parts = poses[30:50], contexts[30:50]
    for one, two in zip(play(soil, *parts), play(python, *parts)):
        # Angles and their rates are rounded on the way: 1e-12 of a bin.
        np.testing.assert_allclose(one, two, atol=1e-5 * np.abs(two).max())


def test_height_map_and_what_c_alone_refuses(fields):
    blade, poses = fields['blade'][0], drive('blade')[0]
    soil, (wheel, _) = CField.of(blade), pair(fields['wheel'])
    soil.start(poses[0])
    origin, cell, shape = (0.05, 0.075), 0.1, (9, 7)
    flat = worlds.height_map(soil, origin, cell, shape)
    for pose in poses[1:]:
        soil.step(pose)
    points, heights = soil.particles(), worlds.height_map(soil, origin, cell, shape)
    expected = np.full(shape, np.nan, np.float32)
    for x, y, z in points:
        i, j = int((x - origin[0]) / cell), int((z - origin[1]) / cell)
        if i < shape[0] and j < shape[1] and not expected[i, j] >= y:
            expected[i, j] = y
    np.testing.assert_array_equal(heights, expected)
    assert np.nanmax(np.abs(heights - flat)) > 1e-3
    for of, change, message in (
        (soil, {'bed': blade.rest * 1e4}, 'range'),
        (soil, {'bed': blade.rest[:9]}, 'shape'),
        (soil, {'index': 0}, 'no recorded starts'),
        (wheel, {'blade_width': 0.3}, 'blade_width'),
        (wheel, {'index': 2}, 'range'),
    ):
        with pytest.raises(ValueError, match=message):
            of.start(poses[0], **change)
    with pytest.raises(ValueError, match='not started'):
        CField.of(blade).step(poses[0])
    with pytest.raises(ValueError, match='recorded starts'):
        CField.of(fields['wheel'][0])
    with pytest.raises(ValueError, match='a call that this model does not take'):
        wheel.call('start', poses[0], None, None, 0.0)


@pytest.mark.parametrize(
    'operand, message',
    [
        ('tip ** 3', 'has no place in an operand'),
        ('height + (' * 8 + 'tip' + ')' * 8, 'more than the 8 values'),
    ],
)
def test_inputs_that_c_cannot_read_are_refused(blade, monkeypatch, operand, message):
    table = Table((Row(operand),))
    monkeypatch.setattr(Blade, 'tables', Blade.tables.__class__(Blade.tables.own, table, table))
    with pytest.raises(ValueError, match=message):
        field_data.values(blade)


def test_a_wheel_begins_at_the_nearest_start_or_at_the_one_that_is_named(fields):
    parts = fields['wheel'][1]
    soil = CField.of(fields['wheel'][0], **parts)
    for index, context in enumerate(parts['starts'].context):
        soil.start(index=index)
        stated, placed = np.empty(3), library.structures()['lts_field_result']()
        soil.call('context', stated)
        np.testing.assert_array_equal(stated, context)
        soil.call('newest', ctypes.byref(placed))
        np.testing.assert_array_equal(placed.point, parts['starts'].pose[index, :3])
        named, beds = soil.save(), soil.particles()
        soil.start(context=context * [1.0, 1.001, 1.0])
        np.testing.assert_array_equal(soil.particles(), beds)
        soil.start(context=context)
        assert soil.save() == named


def test_a_wheel_that_would_sink_under_the_floor_leaves_the_state_as_it_was(fields):
    poses, contexts = drive('wheel')
    shallow = HeightMap(np.array([0.1, 0.5]), np.array([0.118, 0.118]))
    field = small_wheel.make_field()
    for part in field.network.load.layers[-1]:
        part.assign(part * [1.0, 1.0, 1.0, -4.0])
    soil, python = pair((field, fields['wheel'][1]))
    low = poses - [0, 0.05, 0, 0, 0, 0, 0]
    for one in (soil, python):
        one.start(low[0], bed=shallow, context=contexts[0])
    for k in range(1, 61):
        kept = soil.save()
        try:
            python.step(low[k], context=contexts[k])
        except ValueError as error:
            assert 'floor' in str(error)
            with pytest.raises(ValueError, match='floor'):
                soil.step(low[k], context=contexts[k])
            assert soil.save() == kept and k > 1
            return
        soil.step(low[k], context=contexts[k])
    raise AssertionError('the wheel has not sunk: the test shows nothing')


@pytest.mark.parametrize('tool', TOOLS)
def test_what_leaves_its_range_has_its_bit_and_the_reason_of_python(fields, tool, monkeypatch):
    """In the words of training's range, not of the wider one that is still well."""
    field, parts = fields[tool]
    assert library.constants()['LTS_FIELD_CONDITIONS'] == len(CONDITIONS)
    poses, contexts = drive(tool, 3)
    poses -= [0, 0.03 * (tool == 'blade'), 0, 0, 0, 0, 0]  # in the air no condition holds
    context, start, pose, speed = (
        library.constants()[f'LTS_OUTSIDE_{n}'] for n in ('CONTEXT', 'START', 'POSE', 'SPEED')
    )
    expected = {
        'blade': {'tip': pose, 'half_width': context, 'turn_1': speed, 'room': pose},
        'wheel': {'first_load': context, 'rim_1': speed, 'sunk': pose, 'radius': context},
    }[tool] | {'bed_low': start, 'frame_time': speed, 'yaw': pose}
    ranges = dict(field.ranges)
    for name, bit in expected.items():
        monkeypatch.setattr(field, 'ranges', ranges | {name: [1e4, 2e4]})
        soil, python = pair((field, parts))
        mine, judged = (one.start(poses[0], context=contexts[0]) for one in (soil, python))
        assert mine.reason == judged.reason and judged.reason.startswith(f'{name} ')
        assert '[1e+04, 2e+04] of training' in judged.reason
        assert soil.step(poses[1], context=contexts[1]).status == bit
        assert python.step(poses[1], context=contexts[1]).now == soil.judgement.status
