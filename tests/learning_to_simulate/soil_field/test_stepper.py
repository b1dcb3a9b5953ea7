"""A tool on a terrain, frame by frame."""

import numpy as np
import pytest

from learning_to_simulate.soil_field.place import place_of
from learning_to_simulate.soil_field.stepper import SoilStepper
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Wheel
from tests.learning_to_simulate.soil_field import worlds
from tests.learning_to_simulate.soil_field.scenes import poses


def stepper(terrain=None, **more):
    terrain = terrain or Terrain.flat((3.0, 4.0), corner=(-2.0, -2.0))
    return SoilStepper(worlds.trained()[0], terrain, worlds.TOOL, **more)


def driven(tool, **more):
    """Frames along a path of `worlds`."""
    way = poses(worlds.path(3), **more)
    return [tool.start(way[0])] + [tool.step(pose) for pose in way[1:]]


def test_forces_are_those_of_the_soil_and_turn_with_the_scene():
    here, there = stepper(), stepper(Terrain.flat((8.0, 8.0), 0.4, corner=(-4.0, -4.0)))
    found, shift = driven(here), (0.3, 0.4, -0.2)
    depth = np.maximum(worlds.TOOL.radius - worlds.path(3)[:, 1], 0.0)
    truth = depth[:, None] * [6000.0, 2000.0, 0.0]
    force = np.array([frame.force for frame in found])
    assert np.linalg.norm(force - truth) < 0.25 * np.linalg.norm(truth)
    assert found[-1].status == 'ok'
    place = place_of(poses(worlds.path(3), yaw=2.1)[0])
    for one, other in zip(found, driven(there, yaw=2.1, shift=shift), strict=True):
        local = [-one.force[0], one.force[1], -one.force[2]]
        np.testing.assert_allclose(place.vectors(local), other.force, atol=2e-3)
        local = [-one.torque[0], one.torque[1], -one.torque[2]]
        np.testing.assert_allclose(place.vectors(local), other.torque, atol=2e-4)


def test_the_next_tool_meets_what_the_last_has_left():
    terrain = Terrain.flat((3.0, 2.0), corner=(-2.0, -1.0))
    one, other = stepper(terrain), stepper(terrain)
    first = np.array([frame.force for frame in driven(one)])
    assert terrain.heights.min() < -0.01
    again = np.array([frame.force for frame in driven(other)])
    aside = np.array([frame.force for frame in driven(stepper(terrain), shift=(0, 0, 0.68))])
    assert np.linalg.norm(again - first) > 0.1 * np.linalg.norm(first)
    np.testing.assert_allclose(aside, first, atol=0.02 * np.abs(first).max())


def test_soil_rests_no_steeper_than_its_angle_of_repose_where_the_tool_has_gone():
    ground = Terrain.flat((3.0, 2.0), corner=(-2.5, -1.0))
    tool = stepper(ground)
    tool.start(poses([[0.0, 0.1, 0.1]])[0])
    for u in np.arange(0.0, 1.5, 0.05):
        tool.step(poses([[u, -0.04, 0.1]])[0], 0.1)
    steep, litres = np.abs(np.diff(ground.heights, axis=1)).max(), ground.heights.sum()
    tool.start(poses([[1.5, 0.3, 0.1]])[0])
    slope = np.abs(np.diff(ground.heights, axis=1)).max() / 0.02
    assert slope < ground.soil.friction + 0.005 < steep / 0.02
    assert ground.heights.sum() == pytest.approx(litres, abs=1e-9)


def test_what_a_field_does_not_have_is_refused():
    """Poses and times are refused in `native/test_soil_engine`, in the words of both engines."""
    with pytest.raises(ValueError, match='knows a blade, not a wheel'):
        SoilStepper(worlds.trained()[0], Terrain.flat((1.0, 1.0)), Wheel())
    for members in (3, 1.5):
        with pytest.raises(ValueError, match=rf'members is {members}, must lie in \[1, 2\]'):
            stepper(members=members)
    with pytest.raises(AttributeError):
        stepper().terrain = Terrain.flat((1.0, 1.0))
    tool, pose = stepper(), poses([[0.0, 0.2, 0.1]])[0]
    tool.start(pose)
    with pytest.raises(ValueError, match='dt is soon s'):
        tool.step(pose, dt='soon')
