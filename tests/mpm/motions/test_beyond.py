"""Runs that leave the data: each fits its bin. `test_data_of_record.py` holds what they are."""

import pytest

from mpm import scenes
from mpm.motions import beyond, catalogue, checks


@pytest.mark.parametrize('scene', scenes.SCENES.values(), ids=lambda scene: scene.name)
def test_every_run_fits_its_bin(scene):
    count = len(beyond.NAMES[scene.name])
    for number in range(count):
        motion = catalogue.motion_of(scene, catalogue.seed_case(beyond.KIND, number))
        checks.check_drive(motion.drive, scene.bin, motion.frames, checks.STEPS_CHECKED)
    with pytest.raises(ValueError, match=f'has the runs 0 to {count - 1}, each with its own tool'):
        catalogue.motion_of(scene, catalogue.seed_case(beyond.KIND, count))
