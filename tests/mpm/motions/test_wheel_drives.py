"""Drives of the wheel: within their limits, of their kind, functions of the seed."""

from typing import NamedTuple

import numpy as np
import pytest

from mpm import scenes
from mpm.motions import catalogue, checks, wheel_drives
from mpm.motions.drive import Drive
from mpm.motions.wheel_drives import KINDS, TURNS, free_drive

SCENE = scenes.WHEEL
DT = 1.0 / 60.0 / 16
TIMES = np.arange(320 * 16 + 1) * DT
SEEDS = range(100)


class Driven(NamedTuple):
    """A drive, its parameters; rim and travel speed [T - 1], m/s; load [T], N (0: none)."""

    drive: Drive
    parameters: dict
    rim: np.ndarray
    travel: np.ndarray
    load: np.ndarray


@pytest.fixture(scope='module', params=KINDS)
def drives(request):
    """(kind, the drives of its first seeds)."""
    made = []
    for seed in SEEDS:
        drive, parameters = free_drive(SCENE, request.param, seed)
        poses = drive.pose(TIMES)
        rim = np.diff(poses[:, 2]) / DT * drive.body.radius
        travel = -np.diff(poses[:, 0]) / DT
        load = np.zeros(len(TIMES)) if drive.machine is None else -drive.machine.force(TIMES)[:, 1]
        assert (poses[:, 3] == SCENE.bin.z_middle).all()
        made.append(Driven(drive, parameters, rim, travel, load))
    return request.param, made


def test_limits_are_kept(drives):
    kind, made = drives
    for drive, parameters, rim, travel, load in made:
        checks.check_drive(drive, SCENE.bin, 320, 16)
        assert np.abs(rim).max() <= wheel_drives.MAX_RIM_SPEED * (1 + 1e-9)
        # The slip at each level is in its range, so travel / rim is between them everywhere.
        assert (np.abs(travel) <= 1.1 * np.abs(rim) + 1e-9).all()
        assert 2.0 * drive.body.radius == pytest.approx(parameters['diameter_m'])
        if kind == 'height':
            assert drive.machine is None and drive.rest == 0
            continue
        assert drive.machine.is_free == (False, True, False) and drive.rest == 48
        assert parameters['load_min_N'] == pytest.approx(load.min(), rel=1e-2)
        assert parameters['load_max_N'] == pytest.approx(load.max(), rel=1e-2)
        if kind in TURNS:
            mean = scenes.wheel_load(parameters)
            for name, values in SCENE.levels.items():
                assert name == 'slip_percent' or parameters[name] in values
        else:
            mean, tool = parameters['load_N'], parameters['tool']
            pressure = mean / (2.0 * tool['radius'] * tool['width']) * 9.81
            assert 3.0e3 - 1 < pressure / parameters['gravity_m_s2'] < 12.0e3 + 1
            assert 28.0 <= parameters['friction_angle_deg'] <= 43.0
        assert load.min() >= 0.5 * mean - 1e-9 and load.max() <= 1.5 * mean + 1e-9
        assert load[0] == pytest.approx(mean) == 9.81 * drive.machine.mass
        if drive.body.radius < 0.05 and kind in TURNS:
            assert parameters['gravity_m_s2'] > 2.0
            assert parameters['gravity_m_s2'] > 9.0 or load.max() <= mean * (1 + 1e-9)


def test_speeds_are_smooth_and_begin_at_rest(drives):
    _, made = drives
    for drive, _, rim, travel, load in made[:40]:
        sinking = np.diff(drive.pose(TIMES)[:, 1]) / DT  # in shorter pieces than the others
        for speed, most in ((rim, 0.05), (travel, 0.05), (sinking, 0.1)):
            assert abs(speed[0]) < 1e-4
            acceleration = np.diff(speed) / DT
            jump = np.abs(np.diff(acceleration)).max()
            assert jump <= most * np.abs(acceleration).max() + 1e-9
        assert np.abs(np.diff(load)).max() <= 0.05 * load.max()


def test_each_kind_shows_what_it_is_for(drives):
    kind, made = drives
    for drive, parameters, rim, travel, load in made:
        plot = parameters['plot']
        assert plot == kind or kind in ('height', 'wheels')
        if plot in ('slip', 'load', 'grousers'):
            assert rim.min() > -1e-12 and travel.min() > -1e-12
        if plot == 'stops':
            assert (np.abs(travel[320:]) < 1e-6).sum() >= 0.3 * 60 * 16 - 2
        if plot == 'reverse':
            assert rim.min() < -0.004 and rim.max() > 0.004
        assert (np.ptp(load) > 0.0) == (plot == 'load')
        if kind == 'height':
            sunk = SCENE.bin.surface + drive.body.reach - drive.pose(TIMES)[:, 1]
            # From above the soil into it, never too deep, up again somewhere.
            assert sunk[0] < 0.0 and 0.0 <= sunk.max() <= wheel_drives.DEEPEST + 1e-9
            assert np.diff(sunk)[TIMES[1:] > 1.3].min() < -1e-7
        assert (drive.body.grousers > 0) == (kind == 'grousers')
    moving = [r > 1e-3 for _, _, r, _, _ in made]
    slips = [1 - t[m] / r[m] for (_, _, r, t, _), m in zip(made, moving)]
    assert np.mean([np.ptp(s) > 0.2 for s in slips]) > 0.8


def test_drawn_wheels_differ():
    wheels = [free_drive(SCENE, 'wheels', seed)[1]['tool'] for seed in range(60)]
    for name, (low, high) in {'radius': (0.03, 0.15), 'width': (0.05, 0.125)}.items():
        found = [wheel[name] for wheel in wheels]
        assert low <= min(found) < low + 0.2 * (high - low) and high - 0.2 * (high - low) < max(
            found
        )
    bars = [free_drive(SCENE, 'grousers', seed)[1]['tool'] for seed in range(60)]
    assert {8, 24} <= {bar['grousers']['count'] for bar in bars}
    assert all(bar['grousers']['height'] <= 0.15 * bar['radius'] + 1e-4 for bar in bars)


def test_a_tool_of_ones_own_takes_the_place_of_the_grid_s():
    tool = {'name': 'mine', 'radius': 0.11, 'width': 0.09, 'friction': 0.4}
    motion = catalogue.motion_of(SCENE, 'slip_0002', tool)
    assert motion.drive.body.radius == 0.11 and motion.parameters['tool'] == tool
    assert motion.parameters['diameter_m'] == 0.22


def test_drive_is_a_function_of_kind_and_seed(drives):
    kind, made = drives
    drive, parameters = free_drive(SCENE, kind, 17)
    np.testing.assert_array_equal(drive.pose(TIMES), made[17].drive.pose(TIMES))
    assert parameters == made[17].parameters
    ends = np.array([drive.pose(TIMES[-1:])[0, [0, 2]] for drive, *_ in made])
    assert len(np.unique(ends.round(12), axis=0)) == len(made)


def test_unknown_kind_and_negative_seed_are_refused():
    with pytest.raises(ValueError, match="unknown kind 'lift'.*reverse"):
        free_drive(SCENE, 'lift', 0)
    with pytest.raises(ValueError, match='-3'):
        free_drive(SCENE, 'slip', -3)
