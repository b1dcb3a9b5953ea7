"""The exported functions of a wheel's field against the stepper of Python, over whole paths."""

import functools

import numpy as np
import pytest
import tensorflow as tf
from learning_to_simulate.methods.swept_field.live import LiveField

from learning_to_simulate.export import field_exporting
from learning_to_simulate.export.field_functions import FieldFunctions
from learning_to_simulate.export.field_state import STATUS
from learning_to_simulate.live.resting_start import Starts
from tests.learning_to_simulate.swept_field import small_wheel as world


@pytest.fixture(scope='module')
def functions():
    field = world.make_field(members=2)
    field.calibration = {'force': [1.5, 2.0, 0.1]}
    # As of a model folder.
    field.rest = field.rest.astype(np.float32).astype(np.float64)
    return FieldFunctions(field)


def called(functions):
    """Name -> function of arrays, as the formats give them."""

    def call(function, **inputs):
        return function(**{k: tf.constant(v, tf.float32) for k, v in inputs.items()})

    concrete = functions.concrete('tflite')
    return {name: functools.partial(call, function) for name, function in concrete.items()}


@pytest.fixture(scope='module')
def loaded(functions):
    return called(functions)


def run(functions, loaded, plane, dt, live=None, shift=0.0):
    """Differences over a path [T, 1, 4]."""
    live = world.make_live(functions.field) if live is None else live
    poses = world.world_pose(plane[:, 0])
    poses[:, 0] += shift
    bed = world.bed_points() + [shift, 0.0, 0.0]
    contexts = world.contexts(plane[:, 0])
    return field_exporting.compare(functions, loaded, live, poses, {'bed': bed}, contexts, dt)


@pytest.mark.parametrize('frames, sunk', [(61, 0.006), (241, 0.03), (401, 0.001)])
def test_a_path_is_that_of_the_stepper(functions, loaded, frames, sunk):
    """A second of there and back with slip both ways and a changing load, at 60 to 400 frames."""
    dt = 1.0 / (frames - 1)
    found = run(functions, loaded, world.path(frames, dt, sunk), dt)
    assert found['steps'] == frames - 1
    # Measured up to 3e-5, 2e-8 m and 3e-8 m.
    assert max(found['relative_difference'].values()) < 1e-4
    assert found['height_difference_m'] < 2e-7 and found['particles_difference_m'] < 3e-7
    assert set(found['relative_difference']) == {'force', 'torque', 'bound'}


def test_the_edge_of_a_buried_wheel_reaches_the_same_bins(functions, loaded):
    """A wheel in up to its axle that goes on in whole shares of a bin: its upright edge meets bins,
    at a place that float32 does not tell from theirs."""
    radius, dt = 0.02499999850988388, world.DT
    share = radius / world.RADIUS
    starts = Starts(
        ({},), (share * world.body(),), (np.arange(16),), world.world_pose(world.path()[0]),
        np.zeros((1, 4, 3)), world.CONTEXT[None], None,
    )  # fmt: skip
    live = LiveField(functions.field, starts, world.FlatBed())
    plane = world.path(161, dt)
    t = np.arange(len(plane))
    for gone in (2e-4, -2e-4):
        plane[:, 0, 0] = np.float32(-0.38 + gone * t)
        plane[:, 0, 1] = world.SURFACE - 0.009
        plane[:, 0, 2] = 1.6 * gone * t / radius
        found = run(functions, loaded, plane, dt, live)
        assert found['steps'] == 160
        assert max(found['relative_difference'].values()) < 1e-4
        assert found['height_difference_m'] < 2e-7


def test_what_float32_cuts_off_a_place_is_not_lost(functions, loaded, monkeypatch):
    """Short frames far from the point that places are counted from, with and without."""
    dt = 1 / 3000
    plane = world.path(900, dt)[400:700]
    whole = field_exporting.pose_inputs
    monkeypatch.setattr(field_exporting, 'TOLERANCE', 1.0)
    monkeypatch.setattr(field_exporting, 'HEIGHT_TOLERANCE', 1.0)
    fine = max(run(functions, loaded, plane, dt, shift=3.0)['relative_difference'].values())
    monkeypatch.setattr(
        field_exporting, 'pose_inputs', lambda *x: whole(*x) | {'position_low': np.zeros(3)}
    )
    found = run(functions, loaded, plane, dt, shift=3.0)['relative_difference']
    assert 10 * fine < max(found.values())


def test_what_float32_cuts_off_a_turn_is_not_lost(functions, loaded):
    """The speed of the rim over a frame of a ten-thousandth of a second, with and without."""
    values, _ = begun(functions, loaded)
    state = {name: values[name] for name in ('bins', 'tool')}
    plane = world.path()[31, 0]
    errors = []
    for keep in (1.0, 0.0):
        now = state
        for turned in (0.0, 1e-5):  # rad
            pose = field_exporting.pose_inputs(
                functions, world.world_pose(plane + [0.0, 0.0, turned, 0.0])
            )
            pose['rotation_low'] = keep * pose['rotation_low']
            dt = 1e-4 if turned else world.DT
            found = loaded['step'](**now, **pose, dt=dt, context=values['context'])
            now = {name: found[f'next_{name}'] for name in now}
        rim = float(now['tool'][functions.form.at['rim']])
        errors.append(abs(rim / (0.1 * world.RADIUS) - 1.0))
    # Measured 1e-6 and 1e-3.
    assert errors[0] < 1e-5 and errors[1] > 1e-4


def begun(functions, loaded, n_frame=30):
    """Inputs of the next step of a wheel that is on its way, and that step."""
    plane = world.path()[:, 0]
    poses, contexts = world.world_pose(plane), world.contexts(plane)
    given = field_exporting.start_inputs(
        functions, poses[0], world.bed_points(), world.SIZE, context=contexts[0]
    )
    found = loaded['start'](**given)
    state = {name: found[name] for name in ('bins', 'tool')}
    for k in range(1, n_frame + 2):
        following = field_exporting.pose_inputs(functions, poses[k])
        following |= {'dt': world.DT, 'context': contexts[k]}
        if k <= n_frame:
            found = loaded['step'](**state, **following)
            state = {name: found[f'next_{name}'] for name in state}
    return {k: np.array(v) for k, v in (state | following).items()}, found


def shifted(values, name, index, by):
    changed = values[name].copy()
    changed[index] += by
    return values | {name: changed}


@pytest.mark.parametrize(
    'change',
    [
        lambda v: shifted(v, 'context', 0, 0.01),  # another planet
        lambda v: shifted(v, 'context', 1, -1.0),  # another soil
        lambda v: shifted(v, 'context', 2, -1e3),  # a load that is none
        lambda v: shifted(v, 'context', 2, np.nan),
        lambda v: shifted(v, 'pose', 0, 0.2),  # a jump
        lambda v: shifted(v, 'pose', 0, -5.0) | {'dt': 10.0},  # beyond the bins
        lambda v: v | {'pose': np.array([*v['pose'][:3], 0, 0, 1, 0])},  # a turn too fast
        lambda v: shifted(v, 'pose', 3, 0.1),  # no unit quaternion
        lambda v: shifted(v, 'tool', FLOOR, 1.0),  # a floor above the wheel
        lambda v: shifted(v, 'rotation_low', 1, 0.01),
        lambda v: v | {'dt': 0.0},
        lambda v: v | {'dt': np.nan},
    ],
)
def test_what_cannot_be_leaves_the_state_and_says_so(functions, loaded, change):
    values, before = begun(functions, loaded)
    changed = change(values)
    found = loaded['step'](**changed)
    assert int(found['status']) == STATUS['refused']
    for name in ('bins', 'tool'):
        np.testing.assert_array_equal(found[f'next_{name}'], changed[name])
    for name in ('force', 'torque', 'bound', 'height'):
        np.testing.assert_array_equal(found[name], before[name])
    assert int(loaded['step'](**values)['status']) == STATUS['ok']


FLOOR = 4  # of the values of the state


def test_the_floor_of_the_state_is_where_the_refused_step_expects_it(functions):
    assert functions.form.tool[FLOOR] == 'floor'


def test_the_height_of_a_pose_and_the_sign_of_its_rotation_mean_nothing(functions, loaded):
    values, _ = begun(functions, loaded)
    one = loaded['step'](**values)
    other = shifted(values, 'pose', 1, 0.3)
    other |= {'pose': other['pose'] * [1, 1, 1, -1, -1, -1, -1]}
    other |= {'rotation_low': -values['rotation_low']}
    found = loaded['step'](**other)
    assert int(found['status']) == STATUS['ok'] and float(found['height']) < 0.3
    for name in ('next_bins', 'force', 'height'):
        np.testing.assert_array_equal(found[name], one[name])


def test_sums_grow_by_what_float32_would_cut_off(functions, loaded):
    """Thousands of frames that each add less than the last digit of what is there."""
    values, _ = begun(functions, loaded)
    form, pose = functions.form, values['pose'].astype(np.float64)
    state = {name: values[name].copy() for name in ('bins', 'tool')}
    names = ('travelled', 'slipped')
    for name in names:
        state['tool'][form.at[name]] += 50.0
    slid = form.bins.index('slid')
    state['bins'][slid] += 50.0
    rest = {name: values[name] for name in ('dt', 'context')}
    was = state
    for k in range(400):
        pose[0] -= 1e-6 * (-1) ** k
        found = loaded['step'](**state, **rest, **field_exporting.pose_inputs(functions, pose))
        if k == 0:  # the step from where the wheel was
            was = {name: np.array(found[f'next_{name}']) for name in state}
        state = {name: found[f'next_{name}'] for name in state}
    assert int(found['status']) == STATUS['ok']
    for name in names:
        at, low = form.at[name], form.at[f'{name}_low']
        more = [float(state['tool'][i]) - float(was['tool'][i]) for i in (at, low)]
        assert sum(more) == pytest.approx(399e-6, rel=1e-3)
    low = form.bins.index('slid_low')
    more = sum(np.array(state['bins'][i], float) - was['bins'][i] for i in (slid, low))
    assert more.max() == pytest.approx(399e-6, rel=1e-2)


@pytest.mark.parametrize(
    'name, value',
    [('radius', 0.0), ('width', -0.1), ('level', np.inf), ('context', [0.0, 37.0, 100.0]),
     ('context', [9.81, 37.0, 0.0]), ('context', [9.81, np.nan, 9.0])],
)  # fmt: skip
def test_bad_starts_are_refused(functions, loaded, name, value):
    poses = world.world_pose(world.path()[:2, 0])
    values = field_exporting.start_inputs(
        functions, poses[0], world.bed_points(), world.SIZE, context=world.CONTEXT
    )
    assert int(loaded['start'](**values)['status']) == STATUS['ok']
    found = loaded['start'](**values | {name: np.array(value)})
    assert int(found['status']) == STATUS['refused'] and not np.any(found['tool'])
    following = field_exporting.pose_inputs(functions, poses[1])
    following |= {'dt': world.DT, 'context': world.CONTEXT}
    step = loaded['step'](bins=found['bins'], tool=found['tool'], **following)
    assert int(step['status']) == STATUS['refused'] and not np.any(step['force'])


def test_no_particle_that_moved_is_inside_the_wheel(functions, loaded):
    values, _ = begun(functions, loaded)
    found = loaded['step'](**values)
    state = {name: found[f'next_{name}'] for name in ('bins', 'tool')}
    rest = functions.field.rest.astype(np.float32)
    there = loaded['particles'](**state, rest=rest)['particles'].numpy()
    moved = (there != rest).any(axis=1)
    axle = np.array([values['pose'][0], found['height']])
    distance = np.linalg.norm(there[moved, :2] - axle, axis=1)
    beside = np.abs(there[moved, 2] - world.MIDDLE) > world.WIDTH / 2 - 1e-6
    assert moved.sum() > 100
    assert ((distance > world.RADIUS - 1e-6) | beside).all()
