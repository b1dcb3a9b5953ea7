"""A blade that a machine carries: within limits, smooth, of its kind, a function of the seed."""

import numpy as np
import pytest

from mpm import bodies, scenes, stability
from mpm.constitutive import make_soil
from mpm.motions import catalogue, checks, machine_drives, operator_paths
from mpm.motions.machine_drives import KINDS, machine_drive
from mpm.simulation import STIFFEST
from mpm.solver import EXCHANGE

SCENE = scenes.EXCAVATION
TIMES = np.arange(320 * 16 + 1) / 60.0 / 16


@pytest.fixture(scope='module', params=KINDS)
def drives(request):
    """(kind, [(drive, parameters, poses [T, 4])] of its first seeds)."""
    made = [machine_drive(SCENE, request.param, seed) for seed in range(60)]
    return request.param, [(drive, p, drive.pose(TIMES)) for drive, p in made]


def depth_of(drive, poses):
    """Of the lowest point below the flat surface, m."""
    return SCENE.bin.surface - poses[:, 1] - bodies.lowest(drive.body, poses[:, 2])


def test_motions_pass_the_checks_and_are_smooth(drives):
    _, made = drives
    for drive, _, poses in made:
        checks.check_drive(drive, SCENE.bin, 320, 16)
        assert (poses[:, 3] == SCENE.bin.z_middle).all()
        velocity = np.diff(poses, axis=0) / TIMES[1]
        assert np.abs(velocity[0]).max() < 1e-3
        # No jump: 5 cm in a twentieth of a second is the quickest.
        jump = np.abs(np.diff(velocity, axis=0)).max(axis=0)
        assert (jump <= 0.2 * np.abs(velocity).max(axis=0) + 1e-9).all()


@pytest.mark.parametrize('drives', ['press'], indirect=True)
def test_a_press_goes_down_holds_and_goes_down_again(drives):
    _, made = drives
    fastest, holds = [], []
    for drive, parameters, poses in made:
        assert drive.machine is None
        depth = depth_of(drive, poses)
        assert depth[0] < 0.0 and 0.005 < depth.max() <= machine_drives.PRESS_DEPTH + 0.01 + 1e-9
        sinking = np.diff(depth) / TIMES[1]
        # It moves along in the air alone; all but the slowest rest in the soil.
        aside = np.abs(np.diff(poses[:, 0])) > 1e-12
        assert (depth[1:][aside] < 0.0).all()
        holds.append((np.abs(sinking) < 1e-9)[depth[1:] > 0.0].sum() * TIMES[1])
        low, high = machine_drives.PRESS_SPEEDS
        assert all(low - 1e-4 <= speed <= high + 1e-4 for speed in parameters['press_speeds_m_s'])
        fastest.append(sinking.max())
    assert np.ptp(np.log(fastest)) > 1.0 and np.mean(np.array(holds) > 0.2) > 0.7


@pytest.mark.parametrize('drives', ['free', 'actuated'], indirect=True)
def test_what_a_machine_is_stands_in_the_record(drives):
    kind, made = drives
    soil = make_soil(1.5e6, 0.76)
    dt = EXCHANGE / stability.steps_in(EXCHANGE, soil, SCENE.bin.dx)
    kinds = set()
    for drive, parameters, _ in made:
        machine, said = drive.machine, parameters['machine']
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
    drive, parameters = machine_drive(SCENE, 'actuated', 3)
    path, _ = operator_paths.operator_drive(SCENE, parameters['plot'], 1_000_003)
    np.testing.assert_array_equal(drive.pose(TIMES), path.pose(TIMES))


def test_a_drive_is_a_function_of_kind_and_seed(drives):
    kind, made = drives
    drive, parameters = machine_drive(SCENE, kind, 17)
    np.testing.assert_array_equal(drive.pose(TIMES), made[17][2])
    assert parameters == made[17][1]
    motion = catalogue.motion_of(SCENE, f'{kind}_0017')
    assert motion.parameters == parameters and motion.frames == 320
    assert len({poses.tobytes() for _, _, poses in made}) == len(made)


def test_unknown_kind_and_negative_seed_are_refused():
    with pytest.raises(ValueError, match="unknown kind 'lift' of a machine"):
        machine_drive(SCENE, 'lift', 0)
    with pytest.raises(ValueError, match='-1'):
        machine_drive(SCENE, 'press', -1)
