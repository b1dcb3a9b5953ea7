"""The frame of a passage against scipy's rotations, strips against dense integrals."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from learning_to_simulate.live import poses
from learning_to_simulate.soil_field import place
from learning_to_simulate.soil_field.tools import Blade, Wheel
from tests.learning_to_simulate.soil_field import scenes

RNG = np.random.default_rng(0)


@pytest.mark.parametrize('yaw', [0.0, 0.4, -2.5])
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
        ([0, 0, np.nan, 1, 0, 0, 0], 'pose .* holds nan at'),
        ([0, 0, 0, 0, 0, 0, 0], 'length 1'),
        ([0, 0, 0, 2.0, 0, 0, 0], 'length 1'),
        ([0, 0, 0], r'pose .place in m, unit quaternion. has shape \(3,\)'),
        (list('abcdefg'), 'not an array of numbers'),
    ],
)
def test_what_is_no_pose_is_refused(pose, message):
    with pytest.raises(ValueError, match=message):
        place.place_of(pose)


@pytest.mark.parametrize('width', [0.3, 1.5, 0.05])
def test_strips_lie_side_by_side_without_gaps(width):
    found = place.strips_of(Blade(width))
    low, high = found.centres - found.widths / 2, found.centres + found.widths / 2
    np.testing.assert_allclose(low[1:], high[:-1], atol=1e-14)
    half = np.clip(width, 0.15, 0.6) / 2
    np.testing.assert_allclose([low[0], high[-1]], [-half - 0.3, half + 0.3])
    np.testing.assert_allclose([low[found.under][0], high[found.under][-1]], [-half, half])
    np.testing.assert_allclose(found.centres, -found.centres[::-1], atol=1e-15)


@pytest.mark.parametrize('tool, even', [(Wheel(0.05), False), (Blade(1.2), True)])
def test_one_strip_is_as_wide_as_its_tool(tool, even):
    found = place.strips_of(tool, even)
    assert found.widths == pytest.approx([tool.width / tool.scale]) and found.centres == [0.0]
    low, share = found.shares(np.array([-1.0, 0.0, 2.0]))
    assert not low.any() and not share.any()


@pytest.mark.parametrize('tool', [Blade(0.5), Blade(1.2), Blade(0.1)])
def test_heights_are_means_over_the_width(tool):
    terrain, found, scale = scenes.hills(), place.strips_of(tool), tool.scale
    here = place.place_of(scenes.poses([[0.1, 0.0, 0.0]], 0.6, (0.1, 0.0, 0.05))[0])
    u = np.linspace(-0.4, 0.4, 9) / scale
    read = found.heights(terrain, here, scale, u)
    share = (np.arange(400) + 0.5) / 400 - 0.5
    for j in range(11):
        across = scale * (found.centres[j] + found.widths[j] * share)
        points = np.stack(np.broadcast_arrays(scale * u[:, None], 0.0, across), axis=-1)
        x, _, z = np.moveaxis(here.world(points), -1, 0)
        np.testing.assert_allclose(read[j], terrain.at(x, z).mean(axis=1) / scale, atol=2e-4)
    assert np.ptp(read, axis=0).max() > 0.01
