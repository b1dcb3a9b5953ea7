"""Runs that leave the data: each fits its bin, and lies where no other kind draws."""

import numpy as np
import pytest

from mpm import scenes
from mpm.motions import beyond, catalogue, checks, operator_paths, wheel_drives

BLADE, WHEEL = scenes.EXCAVATION, scenes.WHEEL


def runs(scene):
    for number, name in enumerate(beyond.NAMES[scene.name]):
        yield name, catalogue.motion_of(scene, catalogue.seed_case(beyond.KIND, number))


@pytest.mark.parametrize('scene', [BLADE, WHEEL], ids=lambda scene: scene.name)
def test_every_run_fits_its_bin(scene):
    for name, motion in runs(scene):
        checks.check_drive(motion.drive, scene.bin, motion.frames, checks.STEPS_CHECKED)
        assert motion.parameters['plot'] == name


def test_each_blade_leaves_what_operators_draw():
    times = np.linspace(0.0, 5.0, 2001)
    for name, motion in runs(BLADE):
        x, y, angle, z = motion.drive.pose(times).T
        low, high = operator_paths.FRICTION_DEG
        depth = BLADE.bin.surface - y - np.array([-motion.drive.body.radius])
        left = {
            'soil': not low <= motion.ground.friction_angle_deg <= high,
            'fast': np.abs(np.gradient(x, times)).max() > 4 * operator_paths.MAX_SPEED,
            'deep': depth.max() > operator_paths.MAX_DEPTH + 0.02,
            'forward': np.degrees(-angle[0]) < min(operator_paths.BUCKET_LEANS),
            'aside': np.ptp(z) > 0.05,
            'narrow': 2 * motion.drive.body.half_width < 0.15,
            'wall': x.min() < scenes.CORNER + operator_paths.FRONT_ROOM / 2,
            'uphill': motion.ground.slope_deg > 0,
            'downhill': motion.ground.slope_deg < 0,
            'turns': np.ptp(angle) > 0.5,
        }
        found = [key for key, is_left in left.items() if is_left]
        assert found == {'loose': ['soil'], 'firm': ['soil'], 'usual': []}.get(name, [name])


def test_each_wheel_leaves_what_drives_draw():
    found = dict(runs(WHEEL))
    angles = [found[name].ground.friction_angle_deg for name in ('loose', 'firm', 'fast')]
    assert angles[0] < wheel_drives.FRICTION_DEG[0] and angles[1] > wheel_drives.FRICTION_DEG[1]
    assert wheel_drives.FRICTION_DEG[0] < angles[2] < wheel_drives.FRICTION_DEG[1]
    assert found['grousers'].drive.body.grouser_height > wheel_drives.GROUSERS['height'][1]
    assert 2 * found['wide'].drive.body.half_width > wheel_drives.WIDTHS[1]
    times = np.linspace(0.0, 5.0, 501)
    assert np.ptp(found['aside'].drive.pose(times)[:, 3]) > 0.015
    spun = found['spins'].drive.pose(times)
    assert np.ptp(spun[:, 0]) == 0 and np.ptp(spun[:, 2]) > 1.0
    assert found['uphill'].ground.slope_deg == -found['downhill'].ground.slope_deg == 15.0
    with pytest.raises(ValueError, match='has the runs 0 to 10'):
        catalogue.motion_of(WHEEL, 'beyond_0011')
