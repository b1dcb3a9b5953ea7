"""Paths of an operator: of their kind, and what comes before their first frame; drawn tools. Every
change of a path is found by `test_data_of_record.py`."""

import math

import numpy as np
import pytest

from mpm import bodies, scenes
from mpm.distance import signed_distances
from mpm.motions import catalogue
from mpm.motions.operator_paths import BUCKET_RADII, FRAMES, KINDS, PLATE, SHELL, bucket

STEPS = 16  # a frame, of a path that is looked at


@pytest.fixture(params=KINDS)
def paths(request):
    """The first motions of a kind, as (motion, poses in steps from the lead-in's beginning on,
    depths of the lowest point below the flat surface in m)."""
    made = []
    for seed in range(8):
        case = catalogue.seed_case(request.param, seed)
        scene = catalogue.in_bin(scenes.EXCAVATION, case)
        motion = catalogue.motion_of(scene, case)
        times = np.arange(motion.simulated_frames * STEPS + 1) / 60 / STEPS
        poses = motion.drive.pose(times)
        lowest = bodies.lowest(motion.drive.body, poses[:, 2])
        made.append((motion, poses, scene.bin.surface - poses[:, 1] - lowest))
    return made


def test_each_plot_shows_what_it_is_for(paths):
    for motion, poses, depth in paths:
        start = motion.drive.lead_in * STEPS
        x, is_below = poses[start::STEPS, 0], depth[start::STEPS] > 0.0
        kind, plot = motion.parameters['kind'], motion.parameters['plot']
        assert is_below.sum() > (40 if kind in FRAMES else 60)  # about a second in the soil
        assert plot == kind or kind in ('disturbed', 'beside', 'soils', 'tools')
        forward = -np.diff(x) * 60.0
        if plot in ('smooth', 'halts', 'trench'):
            assert forward.min() > -1e-9
        within_a_frame = (forward[:-2] > 0.03) & (np.abs(forward[2:]) < 1e-9)
        assert within_a_frame.any() == (plot == 'halts')
        if plot == 'stops':
            still = (np.abs(forward) < 1e-3) & is_below[1:]
            assert still[10:].sum() >= 2 * 15
        if kind == 'trench':
            assert 1.1 < np.ptp(x) < 1.6 and motion.frames > 320
        else:
            assert motion.frames == FRAMES.get(kind, 320)


def test_an_earlier_pass_cuts_the_bed_before_the_first_frame(paths):
    for motion, poses, depth in paths:
        said, lead_in = motion.parameters, motion.drive.lead_in
        assert said['lead_in_frames'] == lead_in
        offsets = said.get('offsets_m', [])
        assert (lead_in > 0) == bool(offsets) or said['kind'] != 'beside'
        if said['kind'] in ('disturbed', 'beside') or said['plot'] == 'disturbed':
            assert lead_in > 120
        if not lead_in:
            continue
        end = lead_in * STEPS
        lead, depth = poses[: end + 1], depth[: end + 1]
        assert depth.max() > 0.019 and np.ptp(lead[:, 0]) > 0.1
        # At its end the blade stands still above the flat surface.
        assert depth[-1] < 0.0
        np.testing.assert_allclose(lead[-1], lead[-10 * STEPS], atol=1e-12)
        # Each pass lies where the record says, and the tool changes its place in the air alone.
        z = lead[:, 3] - lead[-1, 3]
        assert not np.ptp(poses[end:, 3])
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
        return signed_distances(body, np.zeros(4), np.array([[*place, z]]))[0]

    # Room for soil: the circle's own radius, less where its back is a polygon.
    assert 0.9 * radius < distance(middle) + 0.004 < 1.001 * radius
    assert distance(back) < -0.3 * SHELL
    assert distance(middle - [2.0 * radius, 0.0]) > 0.3 * radius  # nothing in front of it
    # What closes its ends is as thick as a plate, and there only.
    in_plate = distance(middle, half - 0.5 * PLATE)
    assert in_plate == pytest.approx(-0.5 * PLATE) if has_plates else in_plate > 0.05
    assert distance([0.0, 0.0]) < 0.0 < distance([-0.006, 0.0])  # the edge is the reference point
