"""Drives of the wheel: within their limits, and of their kind."""

import numpy as np
import pytest

from mpm import scenes
from mpm.motions import catalogue, wheel_drives
from mpm.motions.wheel_drives import KINDS, TURNS
from tests.mpm import small
from tests.mpm.small import DT, STEPS

SCENE = scenes.WHEEL
TIMES = np.arange(320 * STEPS + 1) * DT


@pytest.fixture(params=KINDS)
def drives(request):
    """(kind, its drives)."""
    return request.param, small.drawn('wheel', request.param)


def speeds_of(drawn):
    """Rim and travel speed [T - 1], m/s; load [T], N (0: none)."""
    rim = np.diff(drawn.whole[:, 2]) / DT * drawn.drive.body.radius
    machine = drawn.drive.machine
    load = np.zeros(len(TIMES)) if machine is None else -machine.force(TIMES)[:, 1]
    return rim, -np.diff(drawn.whole[:, 0]) / DT, load


def test_limits_are_kept(drives):
    kind, made = drives
    for drawn in made:
        (rim, travel, load), parameters, drive = speeds_of(drawn), drawn.parameters, drawn.drive
        assert np.abs(rim).max() <= wheel_drives.MAX_RIM_SPEED * (1 + 1e-9)
        # The slip at each level is in its range, so travel / rim is between them everywhere.
        assert (np.abs(travel) <= 1.1 * np.abs(rim) + 1e-9).all()
        assert 2.0 * drive.body.radius == pytest.approx(parameters['diameter_m'])
        if kind == 'height':
            assert drive.machine is None and drive.rest == 0
            continue
        assert drive.machine.is_free == (False, True, False) and drive.rest == 48
        assert np.abs(np.diff(load)).max() <= 0.05 * load.max()
        assert parameters['load_min_N'] == pytest.approx(load.min(), rel=1e-2)
        assert parameters['load_max_N'] == pytest.approx(load.max(), rel=1e-2)
        gravity = parameters['gravity_m_s2']
        if kind in TURNS:
            mean = scenes.wheel_load(parameters)
            for name, values in SCENE.levels.items():
                assert name == 'slip_percent' or parameters[name] in values
            if drive.body.radius < 0.05:
                assert gravity > 2.0 and (gravity > 9.0 or load.max() <= mean * (1 + 1e-9))
        else:
            mean, tool = parameters['load_N'], parameters['tool']
            pressure = mean / (2.0 * tool['radius'] * tool['width']) * 9.81 / gravity
            assert 3.0e3 - 1 < pressure < 12.0e3 + 1
            assert 28.0 <= parameters['friction_angle_deg'] <= 43.0
        assert load.min() >= 0.5 * mean - 1e-9 and load.max() <= 1.5 * mean + 1e-9
        assert load[0] == pytest.approx(mean) == 9.81 * drive.machine.mass


def test_each_kind_shows_what_it_is_for(drives):
    kind, made = drives
    ranges = []
    for drawn in made:
        (rim, travel, load), plot, body = (
            speeds_of(drawn),
            drawn.parameters['plot'],
            drawn.drive.body,
        )
        assert plot == kind or kind in ('height', 'wheels')
        if plot in ('slip', 'load', 'grousers'):
            assert rim.min() > -1e-12 and travel.min() > -1e-12
        if plot == 'stops':
            assert (np.abs(travel[320:]) < 1e-6).sum() >= 0.3 * 60 * 16 - 2
        if plot == 'reverse':
            assert rim.min() < -0.004 and rim.max() > 0.004
        assert (np.ptp(load) > 0.0) == (plot == 'load')
        if kind == 'height':
            sunk = SCENE.bin.surface + body.reach - drawn.whole[:, 1]
            # From above the soil into it, never too deep, up again somewhere.
            assert sunk[0] < 0.0 and 0.0 <= sunk.max() <= wheel_drives.DEEPEST + 1e-9
            assert np.diff(sunk)[TIMES[1:] > 1.3].min() < -1e-7
        assert (body.grousers > 0) == (kind == 'grousers')
        ranges.append(np.ptp(1 - travel[rim > 1e-3] / rim[rim > 1e-3]))
    assert np.mean(np.array(ranges) > 0.2) > 0.8  # slips differ


def test_drawn_wheels_differ():
    wheels, bars = (
        [drawn.parameters['tool'] for drawn in small.drawn('wheel', kind)]
        for kind in ('wheels', 'grousers')
    )
    for name, (low, high) in {'radius': (0.03, 0.15), 'width': (0.05, 0.125)}.items():
        found, part = [wheel[name] for wheel in wheels], 0.25 * (high - low)
        assert low <= min(found) < low + part and high - part < max(found) <= high
    counts = {bar['grousers']['count'] for bar in bars}
    assert 8 <= min(counts) < 11 and 22 < max(counts) < 25
    assert all(bar['grousers']['height'] <= 0.15 * bar['radius'] + 1e-4 for bar in bars)


def test_a_tool_of_ones_own_takes_the_place_of_the_grid_s():
    tool = {'name': 'mine', 'radius': 0.11, 'width': 0.09, 'friction': 0.4}
    motion = catalogue.motion_of(SCENE, 'slip_0002', tool)
    assert motion.drive.body.radius == 0.11 and motion.parameters['tool'] == tool
    assert motion.parameters['diameter_m'] == 0.22
