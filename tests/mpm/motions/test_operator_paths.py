"""What comes before the first frame of an operator's path; drawn tools. Every change of what comes
after is found by `test_data_of_record.py`."""

import math

import numpy as np
import pytest

from mpm import bodies, scenes
from mpm.distance import signed_distances
from mpm.motions import catalogue
from mpm.motions.operator_paths import BUCKET_RADII, PLATE, SHELL, bucket, operator_drive

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


@pytest.mark.parametrize('kind', ['smooth', 'reverse', 'lift'])
def test_the_floor_of_a_given_bucket_rises_behind_its_edge(kind):
    rise = math.radians(2.0)
    outline = [[0.0, 0.0], [0.2 * math.cos(rise), 0.2 * math.sin(rise)], [0.2, 0.2], [0.18, 0.2],
               [0.18, 0.03]]  # fmt: skip
    tool = bodies.check_tool(
        {'name': 'bucket', 'edge_radius': 0.004, 'width': 0.3, 'outline': outline}
    )
    scene = scenes.SCENES['excavation']
    for seed in range(9000, 9004):
        motion = catalogue.motion_of(scene, f'{kind}_{seed}', tool)
        angle = motion.drive.pose(np.arange(321) / 60.0)[:, 2]
        floor = np.array(outline[1])
        height = floor[0] * np.sin(angle) + floor[1] * np.cos(angle)
        assert height.min() >= 0.2 * math.sin(math.radians(10.0)) - 1e-9
        assert height.max() > height.min() + 0.02  # it leans on its way


def test_drawn_buckets_differ_in_shape_and_their_floors_never_fall():
    scene, seen = scenes.EXCAVATION, []
    for seed in range(12):
        drive, drawn = operator_drive(scene, 'buckets', seed)
        outline, plot = np.array(drawn['tool']['outline']), drawn['plot']
        assert drawn['frames'] == {'brief': 150, 'scoop': 300}[plot]
        angle = drive.pose(np.arange(drawn['frames'] + 1) / 60.0)[:, 2]
        behind = outline[outline[:, 0] > 0.01]
        rise = np.degrees(np.arctan2(behind[:, 1], behind[:, 0]).min())
        assert -5.0 <= rise <= 30.0 and 0.17 <= outline[:, 1].max() <= 0.42
        if plot == 'brief':  # others curl
            relief = rise + np.degrees(angle)
            assert relief.min() >= -1e-9 and relief.max() <= 40.0 + 1e-9
        seen.append((plot, rise, 'ground' in drawn, *outline[1]))
    plots, rises, other, *floor = zip(*seen)
    assert set(plots) == {'brief', 'scoop'} and set(other) == {True, False}
    assert np.ptp(rises) > 10.0 and np.ptp(np.hypot(*floor)) > 0.08
    given = bucket(0.1, 0.3, True)
    assert 'ground' not in operator_drive(scene, 'buckets', 3, given)[1]


def test_a_large_bucket_does_not_lift_soil_out_of_the_grid():
    """It curls about a pin that is as far from it as it is large."""
    tool, box = bucket(0.12, 0.36, True), scenes.EXCAVATION.bin
    for seed in range(9006, 9014, 2):
        motion = catalogue.motion_of(scenes.EXCAVATION, f'scoop_{seed}', tool)
        drive = motion.drive
        assert motion.ground == scenes.Ground()  # others are of drawn buckets
        assert drive.pose(np.arange(401) / 60.0)[:, 1].max() <= scenes.CORNER + box.height
