"""The exported functions of a swept field against the stepper of Python, over whole paths."""

import functools

import numpy as np
import pytest
import tensorflow as tf
from learning_to_simulate.methods.swept_field.beds import HeightMap

from learning_to_simulate.export import field_exporting
from learning_to_simulate.export.field_blade import BladeForm
from learning_to_simulate.export.field_functions import FieldFunctions
from learning_to_simulate.export.field_state import STATUS
from tests.learning_to_simulate.swept_field import small_world as world

MAP = HeightMap(np.array([0.1, 0.3, 0.6, 0.9]), np.array([0.26, 0.25, 0.24, 0.23]))


@pytest.fixture(scope='module')
def field():
    found = world.make_field(members=2)
    found.calibration = {'force': [1.5, 2.0, 0.1]}
    # As of a model folder.
    found.rest = found.rest.astype(np.float32).astype(np.float64)
    return found


@pytest.fixture(scope='module')
def functions(field):
    return FieldFunctions(field)


@pytest.fixture(scope='module')
def live(field):
    return world.make_live(field)


@pytest.fixture(scope='module')
def loaded(functions):
    """Name -> function of arrays, as the formats give them."""

    def call(function, **inputs):
        return function(**{k: tf.constant(v, tf.float32) for k, v in inputs.items()})

    concrete = functions.concrete('tflite')
    return {name: functools.partial(call, function) for name, function in concrete.items()}


@pytest.mark.parametrize(
    'frames, bed, width',
    [(61, None, 0.457), (241, MAP, 0.457), (181, None, 0.3), (401, MAP, 0.35)],
)
def test_a_path_is_that_of_the_stepper(functions, loaded, live, frames, bed, width):
    """A second of there and back at 60 to 400 frames."""
    dt = 1.0 / (frames - 1)
    poses = world.world_pose(world.path(frames, dt=dt)[:, 0])
    bed = functions.field.rest if bed is None else bed
    begin = {'bed': bed, 'blade_width': width}
    found = field_exporting.compare(functions, loaded, live, poses, begin, dt=dt)
    assert found['steps'] == frames - 1
    # Measured up to 7e-6 and 4e-7 m.
    assert max(found['relative_difference'].values()) < 7e-5
    assert found['particles_difference_m'] < 4e-6
    assert set(found['relative_difference']) == {'force', 'torque', 'bound'}


def test_what_float32_cuts_off_a_place_is_not_lost(functions, loaded, live, monkeypatch):
    """Short frames far from the point that places are counted from, with and without."""
    dt = 1 / 3000
    poses = world.world_pose(world.path(150, dt=dt)[:, 0]) + [3.0, 1.0, 0, 0, 0, 0, 0]
    bed = functions.field.rest + [3.0, 1.0, 0.0]
    run = functools.partial(
        field_exporting.compare, functions, loaded, live, poses, {'bed': bed}, dt=dt
    )
    monkeypatch.setattr(field_exporting, 'TOLERANCE', 1.0)
    fine = max(run()['relative_difference'].values())
    whole = field_exporting.pose_inputs
    monkeypatch.setattr(
        field_exporting, 'pose_inputs', lambda *x: whole(*x) | {'position_low': np.zeros(3)}
    )
    assert 10 * fine < max(run()['relative_difference'].values())


def start_inputs(functions, pose):
    rest = functions.field.rest
    return field_exporting.start_inputs(functions, pose, rest, np.array([0.457]))


def begun(functions, loaded, n_frame=20):
    """Inputs of the next step of a tool that is in the soil, and that step."""
    poses = world.world_pose(world.path()[:, 0])
    values = start_inputs(functions, poses[0])
    found = loaded['start'](**values)
    state = {name: found[name] for name in ('bins', 'tool')}
    for pose in poses[1 : n_frame + 1]:
        inputs = state | field_exporting.pose_inputs(functions, pose) | {'dt': world.DT}
        found = loaded['step'](**inputs)
        state = {name: found[f'next_{name}'] for name in state}
    following = field_exporting.pose_inputs(functions, poses[n_frame + 1])
    return {k: np.array(v) for k, v in (state | following | {'dt': world.DT}).items()}, found


def shifted(values, name, index, by):
    changed = values[name].copy()
    changed[index] += by
    return values | {name: changed}


@pytest.mark.parametrize(
    'change',
    [
        lambda v: shifted(v, 'pose', 0, np.nan),
        lambda v: shifted(v, 'pose', 0, 0.2),  # a jump
        lambda v: shifted(v, 'pose', 0, -5.0) | {'dt': 10.0},  # beyond the bins
        lambda v: shifted(v, 'pose', 1, -0.2) | {'dt': 1.0},  # under the floor
        lambda v: shifted(v, 'pose', 3, 0.1),  # no unit quaternion
        lambda v: v | {'pose': np.array([*v['pose'][:3], 0, 0, 0, 1])},  # a turn too fast
        lambda v: shifted(v, 'position_low', 1, np.nan),
        lambda v: shifted(v, 'position_low', 1, 0.01),
        lambda v: v | {'dt': 0.0},
        lambda v: v | {'dt': -1.0},
        lambda v: v | {'dt': np.nan},
        lambda v: v | {'dt': np.inf},
    ],
)
def test_what_cannot_be_leaves_the_state_and_says_so(functions, loaded, change):
    values, before = begun(functions, loaded)
    found = loaded['step'](**change(values))
    assert int(found['status']) == STATUS['refused']
    for name in ('next_bins', 'next_tool', 'force', 'torque', 'bound'):
        np.testing.assert_array_equal(found[name], before[name])
    assert int(loaded['step'](**values)['status']) == STATUS['ok']


@pytest.mark.parametrize('bad', [np.nan, np.inf, 1e30])
@pytest.mark.parametrize('place', [('bins', (1, 3)), ('tool', 'u'), ('tool', 'started')])
def test_a_state_that_no_start_made_is_refused(functions, loaded, place, bad):
    values, _ = begun(functions, loaded)
    name, index = place
    values = shifted(values, name, functions.form.at.get(index, index), bad)
    found = loaded['step'](**values)
    assert int(found['status']) == STATUS['refused']
    np.testing.assert_array_equal(found['force'], 0.0)
    assert not np.any(found['next_bins']) and not np.any(found['next_tool'])
    rest = functions.field.rest.astype(np.float32)
    state = {name: values[name] for name in ('bins', 'tool')}
    np.testing.assert_array_equal(loaded['particles'](**state, rest=rest)['particles'], rest)


@pytest.mark.parametrize(
    'name, value',
    [('width', 0.0), ('width', np.nan), ('level', np.inf), ('end', np.nan), ('floor', -1e30)],
)
def test_bad_starts_are_refused(functions, loaded, name, value):
    poses = world.world_pose(world.path()[:2, 0])
    values = start_inputs(functions, poses[0])
    found = loaded['start'](**values | {name: value})
    assert int(found['status']) == STATUS['refused'] and not np.any(found['tool'])
    surface = values['surface'] * np.nan
    assert int(loaded['start'](**values | {'surface': surface})['status']) == STATUS['refused']
    state = {n: found[n] for n in ('bins', 'tool')}
    step = loaded['step'](**state, **field_exporting.pose_inputs(functions, poses[1]), dt=world.DT)
    assert int(step['status']) == STATUS['refused'] and not np.any(step['force'])


def test_particles_that_are_none_come_back_and_harm_no_other(functions, loaded):
    values, _ = begun(functions, loaded)
    state = {name: values[name] for name in ('bins', 'tool')}
    rest = functions.field.rest.astype(np.float32)
    there = loaded['particles'](**state, rest=rest)['particles'].numpy()
    assert np.abs(there - rest).max() > 1e-3
    bad = rest.copy()
    bad[::7, 1] = np.nan
    found = loaded['particles'](**state, rest=bad)['particles'].numpy()
    np.testing.assert_array_equal(found[::7], bad[::7])
    np.testing.assert_array_equal(np.delete(found, np.s_[::7], 0), np.delete(there, np.s_[::7], 0))


def test_a_frame_outside_training_says_by_how_much(field):
    ranges = dict(field.ranges)
    try:
        field.ranges['lean'] = [0.0, 0.1]
        narrow = FieldFunctions(field)
    finally:
        field.ranges = ranges
    step = {name: getattr(narrow, name) for name in ('start', 'step')}
    loaded = {
        name: lambda function=function, **inputs: function(
            **{k: tf.constant(v, tf.float32) for k, v in inputs.items()}
        )
        for name, function in step.items()
    }
    _, found = begun(narrow, loaded, n_frame=1)
    assert int(found['status']) == STATUS['extrapolating']
    lean = world.path()[1, 0, 2] - 0.105 - 1e-6
    names = field.tool.scalars
    expected = [lean if name == 'lean' else 0.0 for name in names]
    np.testing.assert_allclose(found['outside'], expected, atol=1e-6)


def test_the_state_keeps_its_digits_over_a_long_way(functions, loaded):
    """Ten thousand frames forth and back: distances are counted from now."""
    values, _ = begun(functions, loaded)
    values['bins'][2] += 1e5
    state = loaded['step'](**values)['next_bins'].numpy()
    assert state[2].max() == pytest.approx(functions.field.grid.forget) and state[2].min() >= 0
    assert 'travelled' not in BladeForm.tool


def test_what_there_is_not_is_refused_by_name(field):
    with pytest.raises(ValueError, match=r'members is 3, must lie in \[1, 2\]'):
        FieldFunctions(field, members=3)
    with pytest.raises(ValueError, match='n_particles is 0'):
        FieldFunctions(field, n_particles=0)
