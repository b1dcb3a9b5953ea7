"""A blade that a machine carries: within its limits, and of its kind."""

import numpy as np
import pytest

from mpm import stability
from mpm.motions import machine_drives, operator_paths
from mpm.simulation import STIFFEST
from mpm.solver import EXCHANGE
from tests.mpm import small
from tests.mpm.small import DT, STEPS

TIMES = np.arange(320 * STEPS + 1) * DT


def test_a_press_goes_down_holds_and_goes_down_again():
    fastest, holds = [], []
    for drawn in small.drawn('excavation', 'press'):
        assert drawn.drive.machine is None
        poses, depth = drawn.whole, drawn.depth(drawn.whole)
        assert depth[0] < 0.0 and 0.005 < depth.max() <= machine_drives.PRESS_DEPTH + 0.01 + 1e-9
        sinking = np.diff(depth) / DT
        # It moves along in the air alone; all but the slowest rest in the soil.
        aside = np.abs(np.diff(poses[:, 0])) > 1e-12
        assert (depth[1:][aside] < 0.0).all()
        holds.append((np.abs(sinking) < 1e-9)[depth[1:] > 0.0].sum() * DT)
        low, high = machine_drives.PRESS_SPEEDS
        assert all(
            low - 1e-4 <= speed <= high + 1e-4 for speed in drawn.parameters['press_speeds_m_s']
        )
        fastest.append(sinking.max())
    assert np.ptp(np.log(fastest)) > 1.0 and np.mean(np.array(holds) > 0.2) > 0.7


@pytest.mark.parametrize('kind', ['free', 'actuated'])
def test_what_a_machine_is_stands_in_the_record(kind):
    kinds = set()
    for drawn in small.drawn('excavation', kind):
        dt = EXCHANGE / stability.steps_in(EXCHANGE, small.SOIL, drawn.box.dx)
        machine, parameters = drawn.drive.machine, drawn.parameters
        said = parameters['machine']
        assert said == machine_drives.described(machine)
        kinds.add(machine.is_free)
        mass, k = machine.masses(), np.array(machine.stiffness)
        assert ((mass > 0.0) == machine.is_free).all()
        assert (k[~np.array(machine.is_free)] == 0.0).all()
        # Springs are soft enough for the steps of a run.
        held = np.array(machine.is_free) & (k > 0.0)
        assert held[np.array(machine.is_free) & [True, False, True]].all()
        decay = np.array(machine.damping)[held] / mass[held]
        rate = np.maximum(np.sqrt(k[held] / mass[held]), decay)
        assert (rate * dt < STIFFEST).all()
        low, high = machine_drives.MASSES if kind == 'free' else machine_drives.ACTUATED_MASSES
        assert low <= machine.mass <= high
        force = machine.force(TIMES)
        if kind == 'actuated':
            assert not force.any() and k[:2].min() >= 1e4 and k[:2].max() <= 2e5
            continue
        weight = machine.mass * 9.81
        assert not force[0].any() and not force[:, [0, 2]].any()
        # Grown to the weight, and changed once by the factor.
        levels = {1.0, parameters['load_factor']}
        assert -force[-1, 1] == pytest.approx(parameters['load_factor'] * weight, rel=1e-3)
        assert -force[:, 1].min() == pytest.approx(max(levels) * weight, rel=1e-3)
    expected = {'actuated': {(True, True, False)}}
    expected['free'] = {(x, True, turn) for x in (False, True) for turn in (False, True)}
    assert kinds == expected[kind]


def test_an_actuator_pulls_along_the_path_of_an_operator():
    drawn = small.drawn('excavation', 'actuated')[3]
    scene, plot = small.scenes.EXCAVATION, drawn.parameters['plot']
    path, _ = operator_paths.operator_drive(scene, plot, 1_000_003)
    np.testing.assert_array_equal(drawn.poses, path.pose(drawn.drive.lead_in / 60 + TIMES))
