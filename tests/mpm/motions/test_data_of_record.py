"""Motions of all kinds against the runs of the shipped datasets."""

import pathlib

import numpy as np
import pytest

from mpm import scenes
from mpm.motions import catalogue, machine_drives
from pca_tools import dataset

DATASETS = pathlib.Path(__file__).resolve().parents[3] / 'datasets'


@pytest.mark.parametrize(
    'name, count',
    [
        ('excavation', 11), ('excavation_wide', 2), ('excavation_beyond', 1),
        ('excavation_more', 18), ('excavation_long', 1), ('wheel', 8), ('wheel_beyond', 1),
        ('wheel_more', 11),
    ],
)  # fmt: skip
def test_every_recorded_motion_is_drawn_again(name, count):
    """Poses of a tool that is moved, target and load of one that is free, and all parameters."""
    folder = str(DATASETS / name)
    metadata = dataset.read_metadata(folder)
    scene, kinds = scenes.SCENES[metadata['scene']['name']], set()
    for split, cases in metadata['cases'].items():
        for run, said in zip(dataset.read_split(folder, split), cases, strict=True):
            case = said['case']
            motion = catalogue.motion_of(catalogue.in_bin(scene, case), case)
            kinds.add(motion.parameters['kind'])
            assert motion.parameters.items() <= said.items(), case
            drive, machine = motion.drive, motion.drive.machine
            times = (drive.lead_in + np.arange(run.n_frames)) / 60
            x, y, angle, z = drive.pose(times).T
            if machine is None:
                nothing = np.zeros_like(angle)
                turn = np.cos(angle / 2), nothing, nothing, np.sin(angle / 2)
                np.testing.assert_allclose(run.rigid_pose, np.stack([x, y, z, *turn], 1), atol=1e-7)
            else:
                assert scene.name == 'wheel' or said['machine'] == machine_drives.described(machine)
                target = np.stack([x, y, angle], axis=1)
                np.testing.assert_allclose(run.target, target, atol=1e-6, err_msg=case)
                np.testing.assert_allclose(run.external, machine.force(times), rtol=1e-6)
    assert len(kinds) == count
