"""The frame of a passage against scipy's rotations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from learning_to_simulate.live import poses
from learning_to_simulate.soil_field import place
from tests.learning_to_simulate.soil_field import scenes

RNG = np.random.default_rng(0)


def test_rotation_is_that_of_scipy():
    q = Rotation.random(20, random_state=1).as_quat()
    pose = np.concatenate([np.zeros((20, 3)), q[:, [3, 0, 1, 2]]], axis=1)
    np.testing.assert_allclose(
        poses.rotation_matrix(pose[:, 3:]), Rotation.from_quat(q).as_matrix(), atol=1e-14
    )


@pytest.mark.parametrize('yaw', [0.0, 0.4, np.pi / 2, -2.5, 3.1])
def test_a_tool_looks_along_its_way(yaw):
    """Identity: along -x; turned by a yaw, its axes turn with it, right-handed."""
    pose = scenes.poses([[0.3, 0.2, 0.4]], yaw, (1.0, 0.5, -2.0))[0]
    found, turn = place.place_of(pose), Rotation.from_euler('y', yaw)
    np.testing.assert_allclose(found.along, turn.apply([-1.0, 0.0, 0.0]), atol=1e-14)
    np.testing.assert_allclose(found.across, turn.apply([0.0, 0.0, -1.0]), atol=1e-14)
    np.testing.assert_allclose(np.cross(found.along, place.UP), found.across, atol=1e-14)
    np.testing.assert_allclose(found.origin, pose[:3] * [1, 0, 1])


def test_local_and_world_undo_each_other():
    found = place.place_of(scenes.poses([[0.3, 0.2, 0.1]], 0.7, (3.0, 1.0, 2.0))[0])
    points = RNG.normal(size=(4, 5, 3))
    np.testing.assert_allclose(found.world(found.local(points)), points, atol=1e-14)
    local = found.local(found.origin + 2 * found.along + 3 * place.UP + 4 * found.across)
    np.testing.assert_allclose(local, [2, 3, 4], atol=1e-14)
    np.testing.assert_allclose(found.vectors([0, 0, 1.0]), found.across)


def test_lean_yaw_and_roll_have_their_signs():
    """Top behind, a turn to the left about the upward axis, the right end up."""
    here = place.place_of(scenes.poses([[0.0, 0.0, 0.0]])[0])
    axes = {'lean': here.across, 'yaw': place.UP, 'roll': -here.along}
    for i, axis in enumerate(axes.values()):
        q = Rotation.from_rotvec(0.3 * axis).as_quat()[[3, 0, 1, 2]]
        wanted = 0.3 * np.eye(3)[i]
        np.testing.assert_allclose(here.turns(np.array([0, 0, 0, *q])), wanted, atol=1e-14)
    # The top of a leant tool lies behind; its front edge is what it turns about.
    top = poses.rotation_matrix(scenes.poses([[0.0, 0.0, 0.3]])[0, 3:]) @ place.UP
    assert here.local(here.origin + top)[0] == pytest.approx(-np.sin(0.3))


@pytest.mark.parametrize(
    'pose, message',
    [
        ([0, 0, 0, np.sqrt(0.5), np.sqrt(0.5), 0, 0], 'side'),
        ([0, 0, np.nan, 1, 0, 0, 0], 'expected'),
        ([0, np.inf, 0, 1, 0, 0, 0], 'expected'),
        ([0, 0, 0, 0, 0, 0, 0], 'length 1'),
        ([0, 0, 0, 2.0, 0, 0, 0], 'length 1'),
        ([0, 0, 0], 'expected'),
        ([[0, 0, 0], [1, 0, 0, 0]], 'expected'),
        (list('abcdefg'), 'expected'),
    ],
)
def test_what_is_no_pose_is_refused(pose, message):
    with pytest.raises(ValueError, match=message):
        place.place_of(pose)
