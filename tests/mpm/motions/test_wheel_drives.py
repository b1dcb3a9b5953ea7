"""Drives of the wheel: within their limits, and of their kind."""

import numpy as np

from mpm import scenes
from mpm.motions import catalogue, wheel_drives

SCENE = scenes.WHEEL


def test_a_tool_of_ones_own_takes_the_place_of_the_grid_s():
    tool = {'name': 'mine', 'radius': 0.11, 'width': 0.09, 'friction': 0.4}
    motion = catalogue.motion_of(SCENE, 'slip_0002', tool)
    assert motion.drive.body.radius == 0.11 and motion.parameters['tool'] == tool
    assert motion.parameters['diameter_m'] == 0.22


def test_brief_drives_have_wheels_and_soils_of_their_own():
    drives = [catalogue.motion_of(SCENE, f'brief_{seed:04d}') for seed in range(24)]
    assert {motion.frames for motion in drives} == {wheel_drives.BRIEF}
    for values in (
        [motion.drive.body.radius for motion in drives],
        [motion.ground.friction_angle_deg for motion in drives],
    ):
        assert len(set(values)) == len(drives)
    end = np.array([wheel_drives.BRIEF / scenes.FRAME_RATE])
    turned = [motion.drive.pose(end)[0, 2] * motion.drive.body.radius for motion in drives]
    assert min(turned) > 0.01  # m of rim: none of them rests
    for is_one in (
        [motion.drive.machine is None for motion in drives],  # at a given height
        [motion.drive.body.grouser_height > 0 for motion in drives],
    ):
        assert 0.2 < np.mean(is_one) < 0.8
