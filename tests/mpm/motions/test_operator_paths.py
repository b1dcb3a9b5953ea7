"""Paths of an operator: within their limits, and of their kind."""

import numpy as np
import pytest

from mpm import bodies, scenes
from mpm.motions import operator_paths
from mpm.motions.operator_paths import KINDS, TURNS
from tests.mpm import small
from tests.mpm.small import DT, STEPS


@pytest.fixture(params=KINDS)
def paths(request):
    """(kind, its paths)."""
    return request.param, small.drawn('excavation', request.param)


def test_limits_are_kept(paths):
    kind, made = paths
    for path in made:
        whole, body = path.whole, path.drive.body
        low, high = operator_paths.BUCKET_LEANS if len(body.outline) > 2 else (0.0, 60.0)
        lean = -np.degrees(whole[:, 2])
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
    pushes = 0
    for path in made:
        wall = scenes.CORNER + path.box.size[0]
        x, y, angle, _ = path.whole.T
        depth = path.depth(path.whole)
        back = np.stack([np.cos(angle), np.sin(angle)])
        way = np.diff([x, y], axis=1) / DT
        pushing = (np.sum(way * back[:, 1:], axis=0) > 0.025) & (depth[1:] > 0.022)
        pushes += pushing.any()
        assert (wall - x[1:] - depth[1:])[pushing].min(initial=1.0) > 0.12 - 3e-3
    assert pushes >= (kind != 'trench')  # backs do push, away from the wall


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
            assert 1.1 < np.ptp(x) < 1.6 and path.motion.frames > 320
        else:
            assert path.motion.frames == 320


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


def parameters_of(*kinds):
    return [path.parameters for kind in kinds for path in small.drawn('excavation', kind)]


def test_passes_lie_beside_each_other():
    found = parameters_of('beside')
    ways = [max(map(abs, p['offsets_m'])) / p['blade_width_m'] for p in found]
    assert max(ways) <= operator_paths.FARTHEST + 1e-3 and min(ways) < 0.3
    assert {len(p['offsets_m']) for p in found} == {1, 2}


def test_soils_lie_within_the_law():
    grounds = [path.motion.ground for path in small.drawn('excavation', 'soils')]
    angle, density, gravity = np.array(grounds).T
    usual = scenes.Ground()
    assert 28.0 <= angle.min() < 31.0 and 40.0 < angle.max() <= 43.0
    assert set(gravity) == {usual.gravity, 1.62, 3.72}
    is_other = density != usual.bulk_density
    assert 2 < is_other.sum() < 15 and density.min() >= 1300.0 and density.max() <= 1900.0
    assert (gravity[is_other] == usual.gravity).all()  # density or gravity, not both


def test_bodies_starts_and_leans_differ():
    kinds = (*TURNS, 'halts')
    found = parameters_of(*kinds)
    widths = [p['blade_width_m'] for p in found]
    assert set(widths) == {0.30, bodies.BLADE_WIDTH}
    assert 0.2 < np.mean(np.array(widths) == 0.30) < 0.4
    assert 0.1 < np.mean([p['lean_max_deg'] > 45.0 for p in found]) < 0.4
    start = np.array([d.whole[0, 0] for kind in kinds for d in small.drawn('excavation', kind)])
    assert 0.3 < np.mean(np.isclose(start, 0.82)) < 0.7 and start.min() < 0.65
