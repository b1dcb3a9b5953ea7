"""Poses against rotation matrices; the pose of a blade from its particles."""

import numpy as np
import pytest

from learning_to_simulate.live import poses
from learning_to_simulate.tool.axes import Axes, blade_pose

AXES = Axes(axis=0, sign=-1, up=1)
SEVERAL = (Axes(0, -1, 1, 0.4), Axes(1, 1, 2, 0.1), Axes(2, -1, 0, 0.0), Axes(0, 1, 2, 0.0))


@pytest.mark.parametrize('axes', SEVERAL)
def test_lean_yaw_and_roll_are_those_of_a_rotation_matrix(axes):
    rng = np.random.default_rng(3)
    turn = rng.normal(size=4)
    pose = np.concatenate([np.zeros(3), turn / np.linalg.norm(turn)])
    matrix = poses.rotation_matrix(pose[3:])
    top, side = matrix[:, axes.up], matrix[:, axes.across]
    lean = np.arctan2(-axes.sign * top[axes.axis], top[axes.up])
    assert axes.poses(pose)[2] == pytest.approx(lean)
    along, rise, across = axes.local(side)
    yaw_roll = np.arctan2(along, across), np.arctan2(rise, np.hypot(along, across))
    np.testing.assert_allclose(axes.sideways(pose), yaw_roll, atol=1e-14)


@pytest.mark.parametrize('axes', SEVERAL)
def test_a_tool_that_leans_in_the_plane_of_travel_has_no_yaw_and_no_roll(axes):
    turn = np.zeros(7)
    turn[3], turn[4 + axes.across] = np.cos(0.4), np.sin(0.4)
    assert not axes.sideways(turn).any() and abs(axes.poses(turn)[2]) == pytest.approx(0.8)
    turn[3:] = 0.0
    turn[3], turn[4 + axes.up] = np.cos(0.1), np.sin(0.1)
    yaw, roll = axes.sideways(turn)
    assert (abs(yaw), roll) == pytest.approx((0.2, 0.0))


@pytest.mark.parametrize('axes', SEVERAL)
def test_there_and_back(axes):
    points = np.random.default_rng(2).normal(size=(20, 3))
    np.testing.assert_array_equal(axes.local(axes.world(points)), points)
    np.testing.assert_allclose(axes.loads(*axes.world_loads(points)), points)
    spin = np.zeros(6)
    spin[3:] = axes.world_loads(np.array([0.0, 0.0, 2.0]))[1]  # a torque turns as it pushes
    np.testing.assert_allclose(axes.velocities(spin), [0.0, 0.0, 2.0])


def test_the_axes_of_bodies_are_those_of_most():
    way = np.linspace(0.0, 1.0, 5)[:, None, None]
    there = np.zeros((1, 5, 4, 3)) + way * [0.0, 0.1, -0.5]
    other = np.zeros((1, 5, 4, 3)) + way * [0.4, 3.0, 0.0]
    assert Axes.of_bodies([there, other, there], 1) == Axes(2, -1, 1)


def test_the_pose_of_a_leaning_face():
    rise, lean = np.linspace(0.0, 0.2, 5), 0.3
    face = np.stack([np.stack([rise * np.sin(lean), 0.4 + rise * np.cos(lean), z + 0 * rise], -1)
                     for z in (0.0, 0.1)]).reshape(1, 1, 10, 3)  # fmt: skip
    tip, found = blade_pose(face + [0.7, 0.0, 0.0], AXES)
    np.testing.assert_allclose(tip, [[[-0.7, 0.4]]])
    assert found[0, 0] == pytest.approx(lean)  # its top lies behind: it travels towards -x


@pytest.mark.filterwarnings('error')
def test_a_body_of_one_row_has_no_lean():
    row = np.array([[0.7, 0.4, z] for z in (0.0, 0.1)])[None, None]
    tip, lean = blade_pose(row, AXES)
    np.testing.assert_allclose(tip, [[[-0.7, 0.4]]])
    assert lean == 0.0
