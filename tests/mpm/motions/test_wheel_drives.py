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


def test_a_drive_over_a_rut_begins_over_the_way_of_an_earlier_pass():
    for seed in range(12):
        motion = catalogue.motion_of(SCENE, f'rut_{seed:04d}')
        drive, lead_in = motion.drive, motion.drive.lead_in
        assert drive.machine is None and motion.frames == wheel_drives.BRIEF and lead_in > 60
        frames = np.arange(lead_in + motion.frames + 1)
        pose = drive.pose(frames / scenes.FRAME_RATE)
        sunk = SCENE.bin.surface + drive.body.reach - pose[:, 1]
        first, second = sunk[:lead_in], sunk[lead_in:]
        assert 0.0 < first.max() <= wheel_drives.DEEPEST_RUT + 1e-9
        # At frame 0 it is in the air; on its way it is where the first pass was in the soil.
        assert second[0] < 0.5 * first.max() and second.max() > 0.001
        cut, now = pose[:lead_in, 0][first > 0], pose[lead_in:, 0][second > 0]
        assert cut.min() - drive.body.reach < now.max() and now.min() < cut.max()
        # No jump where one pass ends and the other begins.
        assert np.abs(np.diff(pose[:, :2], axis=0)).max() < 0.01


def test_a_towed_wheel_slips_by_about_nothing_and_most_have_grousers():
    with_grousers = []
    for seed in range(12):
        motion = catalogue.motion_of(SCENE, f'tow_{seed:04d}')
        pose = motion.drive.pose(np.arange(motion.frames + 1) / scenes.FRAME_RATE)
        way, turn = np.abs(np.diff(pose[:, [0, 2]], axis=0)).T
        rim = motion.drive.body.radius * turn
        slip = 1.0 - way[40:] / rim[40:]  # on its way
        assert slip.min() > -0.31 and slip.max() < 0.16
        with_grousers.append('grousers' in motion.parameters['tool'])
    assert 6 <= sum(with_grousers) < 12
