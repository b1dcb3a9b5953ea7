"""What comes before the first frame of an operator's path; drawn tools. Every change of what comes
after is found by `test_data_of_record.py`."""

import math

import numpy as np
import pytest

from mpm import bodies, scenes
from mpm.distance import signed_distances
from mpm.motions import catalogue
from mpm.motions.operator_paths import BUCKET_RADII, PLATE, SHELL, bucket

STEPS = 16  # a frame, of a path that is looked at


@pytest.mark.parametrize('kind', ['disturbed', 'beside', 'soils'])
def test_an_earlier_pass_cuts_the_bed_before_the_first_frame(kind):
    for seed in range(8):
        case = catalogue.seed_case(kind, seed)
        scene = catalogue.in_bin(scenes.EXCAVATION, case)
        motion = catalogue.motion_of(scene, case)
        poses = motion.drive.pose(np.arange(motion.simulated_frames * STEPS + 1) / 60 / STEPS)
        lowest = poses[:, 1] + bodies.lowest(motion.drive.body, poses[:, 2])
        depth = scene.bin.surface - lowest
        said, lead_in = motion.parameters, motion.drive.lead_in
        offsets = said.get('offsets_m', [])
        assert bool(offsets) == (kind == 'beside')
        assert said['lead_in_frames'] == lead_in
        if not lead_in:
            assert kind == 'soils'
            continue
        assert lead_in > 120
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
