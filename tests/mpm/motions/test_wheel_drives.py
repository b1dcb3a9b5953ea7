"""Free drives of the wheel: within their limits, of their kind, functions of the seed."""

import numpy as np
import pytest

from mpm import scenes
from mpm.motions import checks, wheel_drives
from mpm.motions.wheel_drives import KINDS, free_drive

SCENE = scenes.WHEEL
TIMES = np.arange(320 * 16 + 1) / 60.0 / 16


@pytest.fixture(scope='module', params=KINDS)
def drives(request):
    """(kind, [(drive, parameters, rim speed [T], travel speed [T], load [T])])."""
    made = []
    for seed in range(200):
        drive, parameters = free_drive(SCENE, request.param, seed)
        poses = drive.pose(TIMES)
        rim = np.diff(poses[:, 2]) / TIMES[1] * drive.body.radius
        travel = -np.diff(poses[:, 0]) / TIMES[1]
        made.append((drive, parameters, rim, travel, drive.load(TIMES)))
    return request.param, made


def test_limits_are_kept(drives):
    _, made = drives
    for drive, parameters, rim, travel, load in made:
        checks.check_drive(drive, SCENE.bin, 320, 16)
        assert np.abs(rim).max() <= wheel_drives.MAX_RIM_SPEED * (1 + 1e-9)
        # The slip at each level is in its range, so travel / rim is between them everywhere.
        assert (np.abs(travel) <= 1.1 * np.abs(rim) + 1e-9).all()
        mean = scenes.wheel_load(parameters)
        assert load.min() >= 0.5 * mean - 1e-9 and load.max() <= 1.5 * mean + 1e-9
        assert load[0] == pytest.approx(mean)
        if drive.body.radius < 0.05:
            assert parameters['gravity_m_s2'] > 2.0
            assert parameters['gravity_m_s2'] > 9.0 or load.max() <= mean * (1 + 1e-9)
        for name, values in SCENE.levels.items():
            if name != 'slip_percent':
                assert parameters[name] in values
        assert drive.body.radius == parameters['diameter_m'] / 2


def test_speeds_are_smooth_and_begin_at_rest(drives):
    _, made = drives
    for _, _, rim, travel, load in made[:40]:
        for speed in (rim, travel):
            assert abs(speed[0]) < 1e-4
            acceleration = np.diff(speed) / TIMES[1]
            jump = np.abs(np.diff(acceleration)).max()
            assert jump <= 0.05 * np.abs(acceleration).max() + 1e-9
        assert np.abs(np.diff(load)).max() <= 0.05 * load.max()


def test_each_kind_shows_what_it_is_for(drives):
    kind, made = drives
    for _, _, rim, travel, load in made:
        if kind in ('slip', 'load'):
            assert rim.min() > -1e-12 and travel.min() > -1e-12
        if kind == 'stops':
            assert (np.abs(travel[320:]) < 1e-6).sum() >= 0.3 * 60 * 16 - 2
        if kind == 'reverse':
            assert rim.min() < -0.004 and rim.max() > 0.004
        assert (np.ptp(load) > 0.0) == (kind == 'load')
    moving = [r > 1e-3 for _, _, r, _, _ in made]
    slips = [1 - t[m] / r[m] for (_, _, r, t, _), m in zip(made, moving)]
    assert np.mean([np.ptp(s) > 0.2 for s in slips]) > 0.8


def test_drive_is_a_function_of_kind_and_seed(drives):
    kind, made = drives
    drive, parameters = free_drive(SCENE, kind, 17)
    np.testing.assert_array_equal(drive.pose(TIMES), made[17][0].pose(TIMES))
    assert parameters == made[17][1]
    ends = np.array([drive.pose(TIMES[-1:])[0, [0, 2]] for drive, *_ in made])
    assert len(np.unique(ends.round(12), axis=0)) == len(made)


def test_unknown_kind_and_negative_seed_are_refused():
    with pytest.raises(ValueError, match="unknown kind 'lift'.*reverse"):
        free_drive(SCENE, 'lift', 0)
    with pytest.raises(ValueError, match='-3'):
        free_drive(SCENE, 'slip', -3)
