"""Extreme cases: their paths, what must not be."""

import numpy as np
import pytest

from learning_to_simulate.soil_field import method
from learning_to_simulate.soil_field.place import place_of
from learning_to_simulate.soil_field.tools import Blade, Soil, Wheel
from reports import stability
from reports.stability import Case


@pytest.mark.parametrize('kind', [Blade, Wheel])
@pytest.mark.parametrize('case', stability.CASES, ids=lambda case: case.name)
def test_paths_are_such_as_their_names_say(kind, case):
    tool = stability.tool_of(kind, case)
    path, ground = stability.path_of(case, tool)
    np.testing.assert_allclose(np.linalg.norm(path[:, 3:], axis=1), 1.0)
    speed = np.linalg.norm(np.diff(path[:, :3], axis=0), axis=1) / case.dt
    assert speed.max(initial=0.0) < 1.0
    lowest = path[:, 1].min() - tool.radius
    assert (lowest > 0) == (case.shape in ('air', 'rest'))
    assert tool.width == pytest.approx(case.scale * kind().width)
    assert (path[-1, 0] < 0) == (case.shape in ('wall', 'edge')) and (path[:, 0] < ground).all()
    aside, (_, yaw, _) = path[-1, 2], place_of(path[0]).turns(path[-1])
    assert aside == pytest.approx(0.2 if case.shape == 'aside' else 0.0)
    turns = case.shape in ('air', 'turn')
    assert abs(yaw) == pytest.approx(np.pi / 4 if turns else 0.0, abs=1e-9)


def test_a_wheel_slips_and_a_halt_lasts():
    tool = Wheel()
    path, _ = stability.path_of(Case('x'), tool)
    turned = np.unwrap(place_of(path[0]).turns(path)[:, 0])
    way = path[0, 0] - path[-1, 0]
    assert way / (tool.radius * (turned[0] - turned[-1])) == pytest.approx(0.7)
    halts, _ = stability.path_of(Case('x', 'halts'), tool)
    assert (np.diff(halts, axis=0) == 0).all(axis=1).sum() == 2 * 59


def made(**more):
    force = np.array([[0.0, 0, 0], [-30.0, 40.0, 0]])
    pose = np.zeros((2, 7))
    pose[:, 1] = 0.5, 0.014 - 0.03
    return {
        'tool': Blade(), 'soil': Soil(), 'refused': '', 'pose': pose, 'force': force,
        'reasons': ['', ''], 'energy': np.array([98.0]), 'cut': 1e-3, 'came': 1e-5,
    } | more  # fmt: skip


def test_what_must_not_be_is_found():
    good = made()
    row = stability.judged(Case('x'), good, good)
    block = 1730.61 * 9.81 * 0.457 * 0.044**2
    assert row['force_over_weight'] == pytest.approx(50 / block, rel=1e-3)
    assert row['wrong'] == [] and row['soil_came'] == 0.01 and row['flagged'] == 0.0

    def wrong(case=None, python=good, **more):
        return stability.judged(case or Case('x'), made(**more), python)['wrong']

    assert wrong(came=-1e-4) == ['loses soil']
    assert wrong(came=-1e-4, reasons=['', 'speed 3'], python=made(reasons=['', 'speed 3'])) == []
    python = made(reasons=['', 'speed 1.0001 is outside [0, 1] of training'])
    for text, is_wrong in (('1', False), ('1.1', True), ('-1', True), ('many', True)):
        text = f'speed {text} is outside [0, 1] of training'
        assert wrong(python=python, reasons=['', text]) == ['C is not Python'] * is_wrong
    off = good['force'] * 1.01
    assert wrong(python=made(force=off)) == ['C is not Python'] == wrong(refused='frame 2: x')
    assert 'not finite' in wrong(force=np.full((2, 3), np.nan))
    # 20 kg from 0.5 m hold 98.1 J.
    falls = Case('x', 'rest', load=1.0, height=0.3)
    assert wrong(falls) == [] and wrong(falls, energy=np.array([99.0])) == ['gains energy']


@pytest.mark.parametrize('shape', ['halts', 'wall', 'rest'])
def test_a_field_goes_through_cases_alike_in_c_and_python(shape, trained_field):
    case = Case('short', shape, length=0.05, dt=0.05)
    if shape == 'rest':
        case = next(case for case in stability.CASES if case.name == 'falls 1 m')
    field = method.load(trained_field[0])
    c, python = (stability.walked(case, field, engine, 30) for engine in ('c', 'tensorflow'))
    row = stability.judged(case, c, python)
    assert 'C is not Python' not in row['wrong'] and 'not finite' not in row['wrong']
    assert len(c['force']) == len(c['pose']) == len(c['reasons']) <= 30
    assert bool(c['refused']) == (shape == 'rest')
