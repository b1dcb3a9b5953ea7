"""Paths of an operator: functions of kind and seed, within their limits, smooth, of their kind."""

import subprocess
import sys

import numpy as np
import pytest

from mpm import bodies, scenes
from mpm.motions import checks, operator_paths
from mpm.motions.operator_paths import KINDS, operator_drive

SCENE = scenes.EXCAVATION
SEEDS = range(200)
STEPS = 16
TIMES = np.arange(320 * STEPS + 1) / 60.0 / STEPS


@pytest.fixture(scope='module', params=KINDS)
def paths(request):
    """(kind, [(drive, parameters, poses of the recorded part)]) of all seeds."""
    made = []
    for seed in SEEDS:
        drive, parameters = operator_drive(SCENE, request.param, seed)
        made.append((drive, parameters, drive.pose(TIMES + drive.lead_in / 60.0)))
    return request.param, made


def test_limits_are_kept(paths):
    _, made = paths
    dt = TIMES[1]
    for drive, parameters, poses in made:
        checks.check_drive(drive, SCENE.bin, 320, STEPS)
        whole = drive.pose(np.arange((320 + drive.lead_in) * STEPS + 1) * dt)
        lean = -np.degrees(whole[:, 2])
        depth = SCENE.bin.surface - (whole[:, 1] - drive.body.radius)
        assert lean.min() >= -1e-9 and lean.max() <= 60.0 + 1e-9
        assert depth.max() <= operator_paths.MAX_DEPTH + 1e-9
        speed = np.abs(np.diff(poses, axis=0)) / dt
        assert speed[:, 0].max() <= operator_paths.MAX_SPEED * (1 + 1e-9)
        rates = np.abs(np.diff(whole, axis=0)) / dt
        assert rates[:, 1].max() <= operator_paths.MAX_RISE * (1 + 1e-9)
        assert np.degrees(rates[:, 2]).max() <= operator_paths.MAX_TURN * (1 + 1e-9)
        # 20 cm in front of the edge are left for the heap.
        assert whole[:, 0].min() > scenes.CORNER + 0.20 - 1e-3
        assert parameters['depth_max_m'] == pytest.approx(
            SCENE.bin.surface + drive.body.radius - poses[:, 1].min(), abs=1e-4
        )
        assert 2 * drive.body.half_width == pytest.approx(parameters['blade_width_m'])


def test_no_soil_is_squeezed_against_the_wall_behind(paths):
    """A point on the back of the blade, followed in small steps, never nears the wall in deep soil.

    The generator looks at whole frames and at central differences, hence the margins.
    """
    _, made = paths
    wall = scenes.CORNER + SCENE.bin.size[0]
    pushes = 0
    for drive, _, _ in made:
        x, y, angle = drive.pose(np.arange((320 + drive.lead_in) * STEPS + 1) * TIMES[1]).T
        depth = SCENE.bin.surface - (y - drive.body.radius)
        back = np.stack([np.cos(angle), np.sin(angle)])
        way = np.diff([x, y], axis=1) / TIMES[1]
        pushing = (np.sum(way * back[:, 1:], axis=0) > 0.025) & (depth[1:] > 0.022)
        pushes += pushing.any()
        assert (wall - x[1:] - depth[1:])[pushing].min(initial=1.0) > 0.12 - 3e-3
    assert pushes > 10  # backs do push, away from the wall


def test_velocity_and_acceleration_are_continuous(paths):
    _, made = paths
    dt = TIMES[1]
    for _, _, poses in made[:40]:
        velocity = np.diff(poses, axis=0) / dt
        acceleration = np.diff(velocity, axis=0) / dt
        # From rest, and no jump beside the largest value (of a piece that the end cuts, of what is
        # seen of it): a step of a millisecond changes little, where a jump would be all of it.
        assert np.abs(velocity[0]).max() < 1e-3
        for values in (velocity, acceleration):
            jump = np.abs(np.diff(values, axis=0)).max(axis=0)
            assert (jump <= 0.2 * np.abs(values).max(axis=0) + 1e-9).all()


def test_each_kind_shows_what_it_is_for(paths):
    kind, made = paths
    for drive, parameters, poses in made:
        x, y, _ = poses[::STEPS].T
        forward = -np.diff(x) * 60.0
        is_below = y - drive.body.radius < SCENE.bin.surface
        assert is_below.sum() > 60  # a second in the soil at least
        plot = parameters['plot']
        assert kind in ('disturbed', plot)
        if plot in ('smooth', 'stops', 'halts'):
            assert forward.min() > -1e-9
        within_a_frame = (forward[:-2] > 0.03) & (np.abs(forward[2:]) < 1e-9)
        assert within_a_frame.any() == (plot == 'halts')
        if plot == 'stops':
            still = (np.abs(forward) < 1e-3) & is_below[1:]
            assert still[10:].sum() >= 2 * 15
        if plot == 'reverse':
            assert (x - np.minimum.accumulate(x)).max() >= 0.02
        if plot == 'lift':
            out = np.flatnonzero(np.diff(is_below.astype(int)) == -1)[0]
            assert is_below[out + 1 :].sum() >= 45


def test_disturbed_bed_is_cut_before_the_first_frame():
    for seed in SEEDS:
        drive, parameters = operator_drive(SCENE, 'disturbed', seed)
        assert parameters['lead_in_frames'] == drive.lead_in > 120
        poses = drive.pose(np.arange(drive.lead_in + 1) / 60.0)
        low = poses[:, 1] - drive.body.radius
        assert low.min() < SCENE.bin.surface - 0.019
        # At its end the blade stands still above the flat surface.
        assert low[-1] > SCENE.bin.surface
        np.testing.assert_allclose(poses[-1], poses[-10], atol=1e-12)
        assert np.ptp(poses[:, 0]) > 0.1


def test_path_is_a_function_of_kind_and_seed(paths):
    kind, made = paths
    ends = np.array([poses[-1] for _, _, poses in made])
    assert len(np.unique(ends.round(9), axis=0)) == len(SEEDS)
    code = (
        'import numpy as np; from mpm import scenes; from mpm.motions.operator_paths import *\n'
        f'd, p = operator_drive(scenes.EXCAVATION, {kind!r}, 17)\n'
        'print(d.pose(np.linspace(0, 9, 50)).tobytes().hex(), p)'
    )
    run = [sys.executable, '-c', code]
    other = subprocess.run(run, capture_output=True, text=True, check=True).stdout.strip()
    drive, parameters = operator_drive(SCENE, kind, 17)
    assert other == f'{drive.pose(np.linspace(0, 9, 50)).tobytes().hex()} {parameters}'


def test_bodies_starts_and_leans_differ():
    drawn = [operator_drive(SCENE, kind, seed) for kind in KINDS for seed in range(40)]
    widths = [parameters['blade_width_m'] for _, parameters in drawn]
    assert set(widths) == {0.30, bodies.BLADE_WIDTH}
    assert 0.2 < np.mean(np.array(widths) == 0.30) < 0.4
    assert 0.1 < np.mean([p['lean_max_deg'] > 45.0 for _, p in drawn]) < 0.4
    start = np.array([drive.pose(np.zeros(1))[0, 0] for drive, _ in drawn])
    assert 0.3 < np.mean(np.isclose(start, 0.82)) < 0.7 and start.min() < 0.65


def test_unknown_kind_and_negative_seed_are_refused():
    with pytest.raises(ValueError, match="unknown kind 'dig'.*smooth"):
        operator_drive(SCENE, 'dig', 0)
    with pytest.raises(ValueError, match='-1'):
        operator_drive(SCENE, 'lift', -1)
