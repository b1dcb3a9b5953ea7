"""Poses against rotation matrices; the pose of a blade from its particles."""

import numpy as np
import pytest

from learning_to_simulate.axes import Axes, blade_pose
from learning_to_simulate.live import poses

SEVERAL = (Axes(0, -1, 1, 0.4), Axes(1, 1, 2, 0.1), Axes(2, -1, 0, 0.0), Axes(0, 1, 2, 0.0))


@pytest.mark.parametrize('axes', SEVERAL)
def test_the_lean_is_that_of_a_rotation_matrix(axes):
    turn = np.random.default_rng(3).normal(size=4)
    pose = np.concatenate([np.zeros(3), turn / np.linalg.norm(turn)])
    top = poses.rotation_matrix(pose[3:])[:, axes.up]
    lean = np.arctan2(-axes.sign * top[axes.axis], top[axes.up])
    assert axes.poses(pose)[2] == pytest.approx(lean)
    # A tool that leans in the plane of travel leans by that; one that turns on the spot does not.
    for axis, lean in ((axes.across, 0.8), (axes.up, 0.0)):
        pose = np.eye(7)[3] * np.cos(0.4) + np.eye(7)[4 + axis] * np.sin(0.4)
        assert abs(axes.poses(pose)[2]) == pytest.approx(lean)


def test_the_axes_of_bodies_are_those_of_most():
    way = np.linspace(0.0, 1.0, 5)[:, None, None]
    there, other = (np.zeros((1, 5, 4, 3)) + way * step for step in ([0, 0.1, -0.5], [0.4, 3, 0]))
    assert Axes.of_bodies([there, other, there], 1) == Axes(2, -1, 1)


@pytest.mark.filterwarnings('error')
def test_the_pose_of_a_face_and_of_one_row_which_has_no_lean():
    rise, lean = np.linspace(0.0, 0.2, 5), 0.3
    face = np.stack([np.stack([rise * np.sin(lean), 0.4 + rise * np.cos(lean), z + 0 * rise], -1)
                     for z in (0.0, 0.1)]).reshape(1, 1, 10, 3)  # fmt: skip
    for body, expected in ((face, lean), (face[:, :, ::5], 0.0)):
        tip, found = blade_pose(body + [0.7, 0.0, 0.0], Axes(axis=0, sign=-1, up=1))
        np.testing.assert_allclose(tip, [[[-0.7, 0.4]]])
        assert found[0, 0] == pytest.approx(expected)  # its top lies behind: it goes towards -x
