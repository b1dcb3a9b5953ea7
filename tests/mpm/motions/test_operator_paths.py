"""Paths of an operator: functions of kind and seed, within their limits, smooth, of their kind."""

import subprocess
import sys
from typing import NamedTuple

import numpy as np
import pytest

from mpm import bodies, scenes
from mpm.motions import catalogue, checks, operator_paths
from mpm.motions.drive import Drive
from mpm.motions.operator_paths import KINDS, TURNS, operator_drive

SCENE = scenes.EXCAVATION
SEEDS = {'tools': 20}  # of kinds that are slow to draw; 80 of the others
STEPS = 16
DT = 1.0 / 60.0 / STEPS


def scene_of(kind):
    return catalogue.in_bin(SCENE, operator_paths.BINS.get(kind))


class Path(NamedTuple):
    """A drive, its parameters, and float64 [T, 4] poses: of the whole run, of the recorded part."""

    drive: Drive
    parameters: dict
    whole: np.ndarray
    poses: np.ndarray

    def depth(self, poses):
        """Of the lowest point below the flat surface, m."""
        return SCENE.bin.surface - poses[:, 1] - bodies.lowest(self.drive.body, poses[:, 2])

    @property
    def leans(self):
        """The range of its kind of tool, deg."""
        is_polygon = len(self.drive.body.outline) > 2
        return operator_paths.BUCKET_LEANS if is_polygon else (0.0, bodies.MAX_LEAN_DEG)


@pytest.fixture(scope='module', params=KINDS)
def paths(request):
    """(kind, the paths of its first seeds)."""
    made = []
    for seed in range(SEEDS.get(request.param, 80)):
        drive, parameters = operator_drive(scene_of(request.param), request.param, seed)
        frames = drive.lead_in + parameters.get('frames', 320)
        whole = drive.pose(np.arange(frames * STEPS + 1) * DT)
        made.append(Path(drive, parameters, whole, whole[drive.lead_in * STEPS :]))
    return request.param, made


def test_limits_are_kept(paths):
    kind, made = paths
    for path in made:
        box, whole = scene_of(kind).bin, path.whole
        checks.check_drive(path.drive, box, len(path.poses) // STEPS, STEPS)
        lean, (low, high) = -np.degrees(whole[:, 2]), path.leans
        assert lean.min() >= low - 1e-9 and lean.max() <= high + 1e-9
        assert path.depth(whole).max() <= operator_paths.MAX_DEPTH + 1e-9
        speed = np.abs(np.diff(path.poses[:, 0])) / DT
        assert speed.max() <= operator_paths.MAX_SPEED * (1 + 1e-9)
        # The lowest point rises as fast as it may; a tool that turns moves its reference point too.
        rise = np.abs(np.diff(path.depth(whole))) / DT
        assert rise.max() <= operator_paths.MAX_RISE * (1 + 1e-9)
        turn = np.degrees(np.abs(np.diff(whole[:, 2]))) / DT
        assert turn.max() <= operator_paths.MAX_TURN * (1 + 1e-9)
        # 20 cm in front of the edge are left for the heap.
        assert whole[:, 0].min() > scenes.CORNER + 0.20 - 1e-3
        deepest = path.depth(path.poses).max()
        assert path.parameters['depth_max_m'] == pytest.approx(deepest, abs=1e-4)
        width = path.parameters.get('tool', {}).get('width', path.parameters.get('blade_width_m'))
        assert 2 * path.drive.body.half_width == pytest.approx(width)


def test_no_soil_is_squeezed_against_the_wall_behind(paths):
    """A point on the back of the blade, followed in small steps, never nears the wall in deep soil.

    The generator looks at whole frames and at central differences, hence the margins.
    """
    kind, made = paths
    box = scene_of(kind).bin
    wall = scenes.CORNER + box.size[0]
    pushes = 0
    for path in made:
        x, y, angle, _ = path.whole.T
        depth = path.depth(path.whole)
        back = np.stack([np.cos(angle), np.sin(angle)])
        way = np.diff([x, y], axis=1) / DT
        pushing = (np.sum(way * back[:, 1:], axis=0) > 0.025) & (depth[1:] > 0.022)
        pushes += pushing.any()
        assert (wall - x[1:] - depth[1:])[pushing].min(initial=1.0) > 0.12 - 3e-3
    assert pushes >= (kind != 'trench')  # backs do push, away from the wall


def test_velocity_and_acceleration_are_continuous(paths):
    _, made = paths
    for path in made[:40]:
        # Of what the story draws: x, depth, lean. Where a bucket turns from one lowest corner to
        # the next, its depth is smooth and its reference point is not.
        x, y, angle, _ = path.poses.T
        drawn = np.stack([x, path.depth(path.poses), angle], axis=1)
        velocity = np.diff(drawn, axis=0) / DT
        acceleration = np.diff(velocity, axis=0) / DT
        # From rest, and no jump beside the largest value (of a piece that the end cuts, of what is
        # seen of it): a step of a millisecond changes little, where a jump would be all of it.
        assert np.abs(velocity[0]).max() < 1e-3
        for values in (velocity, acceleration):
            jump = np.abs(np.diff(values, axis=0)).max(axis=0)
            assert (jump <= 0.2 * np.abs(values).max(axis=0) + 1e-9).all()


def test_each_plot_shows_what_it_is_for(paths):
    kind, made = paths
    for path in made:
        x, depth = path.poses[::STEPS, 0], path.depth(path.poses[::STEPS])
        forward = -np.diff(x) * 60.0
        is_below = depth > 0.0
        assert is_below.sum() > 60  # a second in the soil at least
        plot = path.parameters['plot']
        assert plot == kind or kind in ('disturbed', 'beside', 'soils', 'tools')
        if plot in ('smooth', 'halts', 'trench'):
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
        if kind == 'trench':
            assert 1.1 < np.ptp(x) < 1.6 and path.parameters['frames'] > 320
        else:
            assert 'frames' not in path.parameters


def test_an_earlier_pass_cuts_the_bed_before_the_first_frame(paths):
    _, made = paths
    for path in made:
        lead = path.whole[: path.drive.lead_in * STEPS + 1]
        assert path.parameters['lead_in_frames'] == path.drive.lead_in
        plot, offsets = path.parameters['plot'], path.parameters.get('offsets_m', [])
        assert (path.drive.lead_in > 0) == bool(offsets) or path.parameters['kind'] != 'beside'
        if path.parameters['kind'] in ('disturbed', 'beside') or plot == 'disturbed':
            assert path.drive.lead_in > 120
        if not path.drive.lead_in:
            continue
        depth = path.depth(lead)
        assert depth.max() > 0.019 and np.ptp(lead[:, 0]) > 0.1
        # At its end the blade stands still above the flat surface.
        assert depth[-1] < 0.0
        np.testing.assert_allclose(lead[-1], lead[-10 * STEPS], atol=1e-12)
        # Each pass lies where the record says, and the tool changes its place in the air alone.
        z = lead[:, 3] - path.poses[0, 3]
        assert not np.ptp(path.poses[:, 3])
        for offset in offsets:
            assert (depth[np.abs(z - offset) < 1e-4] > 0.019).any()
        moves = np.abs(np.diff(z)) > 1e-12
        assert (depth[1:][moves] < 0.0).all()


def test_passes_lie_beside_each_other():
    drawn = [operator_drive(scene_of('beside'), 'beside', seed) for seed in range(60)]
    ways, passes = [], []
    for drive, parameters in drawn:
        width = 2 * drive.body.half_width
        ways.append(max(abs(offset) for offset in parameters['offsets_m']) / width)
        passes.append(len(parameters['offsets_m']))
    assert max(ways) <= operator_paths.FARTHEST + 1e-3 and min(ways) < 0.3
    assert set(passes) == {1, 2}


def test_soils_lie_within_the_law():
    grounds = [operator_drive(SCENE, 'soils', seed)[1]['ground'] for seed in range(60)]
    angles = [ground['friction_angle_deg'] for ground in grounds]
    assert 28.0 <= min(angles) < 31.0 and 40.0 < max(angles) <= 43.0
    assert {ground.get('gravity') for ground in grounds} == {None, 1.62, 3.72}
    densities = [ground['bulk_density'] for ground in grounds if 'bulk_density' in ground]
    assert 5 < len(densities) < 30 and min(densities) >= 1300.0 and max(densities) <= 1900.0
    assert all(len(ground) < 3 for ground in grounds)  # density or gravity, not both
    motion = catalogue.motion_of(SCENE, 'soils_0000')
    assert motion.ground.friction_angle_deg == angles[0] and 'ground' not in motion.parameters


def test_path_is_a_function_of_kind_and_seed(paths):
    kind, made = paths
    ends = np.array([path.poses[-1] for path in made])
    assert len(np.unique(ends.round(9), axis=0)) == len(made)
    code = (
        'import numpy as np; from mpm.scenes import EXCAVATION\n'
        'from mpm.motions import catalogue, operator_paths\n'
        f'scene = catalogue.in_bin(EXCAVATION, operator_paths.BINS.get({kind!r}))\n'
        f'd, p = operator_paths.operator_drive(scene, {kind!r}, 17)\n'
        'print(d.pose(np.linspace(0, 9, 50)).tobytes().hex(), p)'
    )
    run = [sys.executable, '-c', code]
    other = subprocess.run(run, capture_output=True, text=True, check=True).stdout.strip()
    here = made[17].drive.pose(np.linspace(0, 9, 50)).tobytes().hex()
    assert other == f'{here} {made[17].parameters}'


def test_bodies_starts_and_leans_differ():
    kinds = (*TURNS, 'halts')
    drawn = [operator_drive(SCENE, kind, seed) for kind in kinds for seed in range(40)]
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
