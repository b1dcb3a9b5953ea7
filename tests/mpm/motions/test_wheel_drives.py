"""The earlier pass of a drive over a rut; `test_data_of_record.py` finds every other change."""

import numpy as np

from mpm import scenes
from mpm.motions import catalogue, wheel_drives

SCENE = scenes.WHEEL


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
