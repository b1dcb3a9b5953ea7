"""Paths of an operator: within their limits, and of their kind; tools that are drawn."""

import math

import numpy as np
import pytest

from mpm import bodies
from mpm.motions.operator_paths import (
    BUCKET_RADII,
    FRAMES,
    KINDS,
    LAYERS,
    LEAST_BACKDRAG,
    PLATE,
    SHELL,
    bucket,
)
from tests.mpm import small
from tests.mpm.small import STEPS


@pytest.fixture(params=KINDS)
def paths(request):
    """(kind, its paths)."""
    return request.param, small.drawn('excavation', request.param)


def test_each_plot_shows_what_it_is_for(paths):
    kind, made = paths
    for path in made:
        x, depth = path.poses[::STEPS, 0], path.depth(path.poses[::STEPS])
        forward = -np.diff(x) * 60.0
        is_below = depth > 0.0
        assert is_below.sum() > (40 if kind in FRAMES else 60)  # about a second in the soil
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
        if plot == 'spread':
            over = -depth[np.argmax(is_below) :]
            assert (over > LAYERS[0]).sum() >= 30 and over.max() <= LAYERS[1] + 1e-9
        if plot == 'brief':
            assert is_below[:20].any() and depth.max() > 0.0199
        if plot == 'backdrag':
            # Forward into the soil, over the heap, and back at a height that meets it.
            turn = np.argmin(x)
            assert is_below[:turn].sum() >= 40 and (forward[turn:] < 1e-9).all()
            assert x[-1] - x[turn] >= LEAST_BACKDRAG and depth[turn:].min() > -0.025
            assert depth[: turn + 1].min() < -0.015
        if kind == 'trench':
            assert 1.1 < np.ptp(x) < 1.6 and path.motion.frames > 320
        else:
            assert path.motion.frames == FRAMES.get(kind, 320)
    if kind == 'brief':  # no two alike, many of them straight down, some near a wall
        tools = {str(path.parameters['tool']) for path in made}
        assert len(tools) == len({path.motion.ground for path in made}) == len(made)
        sunk = [path.poses[20 * STEPS] - path.poses[0] for path in made]
        assert sum(x == 0.0 and y < -0.01 for x, y, *_ in sunk) > len(made) / 3
        starts = [path.poses[0, 0] for path in made]
        assert min(starts) < 0.4 and max(starts) > 0.75


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


@pytest.mark.parametrize('radius', BUCKET_RADII)
@pytest.mark.parametrize('has_plates', [True, False])
def test_a_bucket_is_hollow_and_open_to_the_front(radius, has_plates):
    body = bodies.tool_body(bucket(radius, 0.6, has_plates))
    rise = math.radians(15.0)
    along = np.array([math.cos(rise), math.sin(rise)])
    up = np.array([-math.sin(rise), math.cos(rise)])
    middle = 1.6 * radius * along + radius * up
    back = middle + (radius + 0.5 * SHELL) * np.array([math.cos(0.2), math.sin(0.2)])
    half = body.half_width

    def distance(place, z=0.0):
        return bodies.signed_distances(body, np.zeros(4), np.array([[*place, z]]))[0]

    # Room for soil: the circle's own radius, less where its back is a polygon.
    assert 0.9 * radius < distance(middle) + 0.004 < 1.001 * radius
    assert distance(back) < -0.3 * SHELL
    assert distance(middle - [2.0 * radius, 0.0]) > 0.3 * radius  # nothing in front of it
    # What closes its ends is as thick as a plate, and there only.
    in_plate = distance(middle, half - 0.5 * PLATE)
    assert in_plate == pytest.approx(-0.5 * PLATE) if has_plates else in_plate > 0.05
    assert distance([0.0, 0.0]) < 0.0 < distance([-0.006, 0.0])  # the edge is the reference point
