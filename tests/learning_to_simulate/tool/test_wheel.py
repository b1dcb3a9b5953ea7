"""A wheel: its drive and its rut against a plain sum over time, its poses, size and outline."""

import dataclasses

import numpy as np
import pytest

from learning_to_simulate import tool
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.tool import wheel
from tests.learning_to_simulate.swept_field import small_wheel as world

S = {name: i for i, name in enumerate(wheel.SCALARS)}


def twin(plane, dt):
    """What bins have borne at the end of a path, bin by bin and frame by frame."""
    radius, first = world.RADIUS, plane[0, 0]
    sunk = world.SURFACE - first[1] + radius
    contact = np.sqrt(sunk * (2 * radius - sunk))
    bins = first[0] + world.GRID.offsets
    slid, shear, peak, since = (np.zeros(len(bins)) for _ in range(4))
    profile = np.full(len(bins), world.SURFACE)
    for k, place in enumerate(bins):
        travelled, last = 0.0, -np.inf
        for t, (u, height, turned, load) in enumerate(plane[:, 0]):
            borne = max(1 - ((place - u) / contact) ** 2, 0)
            if t:
                before = plane[t - 1, 0]
                slip = radius * (turned - before[2]) - (u - before[0])
                mean = (borne + max(1 - ((place - before[0]) / contact) ** 2, 0)) / 2
                slid[k] += mean * abs(slip)
                shear[k] += mean * slip
                travelled += abs(u - before[0])
            if borne > 0:
                last = travelled
            peak[k] = max(peak[k], min(borne / 0.2, 1) * load)
            if abs(place - u) < radius:
                rim = height - np.sqrt(radius**2 - (place - u) ** 2)
                profile[k] = min(profile[k], rim)
        since[k] = min(travelled - last, world.GRID.forget)
    return slid, shear, peak, since, world.SURFACE - profile


def test_bins_are_those_of_the_twin():
    plane = world.path()
    bins = world.frames(plane).bins[-1]
    slid, shear, peak, since, cut = twin(plane, world.DT)
    assert slid.max() > 0.01 and shear.max() > 0.01 and cut.max() > 0.01
    np.testing.assert_allclose(bins[:, wheel.SLID], slid, atol=1e-6)
    np.testing.assert_allclose(bins[:, wheel.SHEAR], shear, atol=1e-6)
    np.testing.assert_allclose(bins[:, wheel.PEAK], peak, rtol=1e-5)
    np.testing.assert_allclose(bins[:, wheel.SINCE], since, atol=1e-6)
    # Between frames the rim goes on: the straight way is a little below both ends.
    np.testing.assert_allclose(bins[:, wheel.CUT], cut, atol=1e-4)


def test_nothing_stirs_before_the_wheel_does():
    """Frames before it moves show the first sinkage alone; then the influence grows from 0."""
    found = world.frames(world.path())
    at_rest = slice(0, 6)
    assert not found.bins[at_rest, :, wheel.INFLUENCE].any()
    assert found.bins[0, :, wheel.CUT].max() == pytest.approx(0.006, abs=1e-5)
    np.testing.assert_array_equal(found.bins[0, :, wheel.CUT], found.bins[0, :, wheel.FIRST_CUT])
    assert found.bins[-1, :, wheel.INFLUENCE].max() == 1
    far = np.abs(world.GRID.offsets) > wheel.REACH + 0.06 + 0.04
    assert not found.bins[-1, far, wheel.INFLUENCE].any()


def test_the_bed_under_the_wheel_is_level_with_its_neighbours():
    """A bed that is read with the wheel on it has its print; the cut is counted from without."""
    bed = world.flat_bed(-0.38)
    surface = bed.surface.copy()
    surface[:, np.abs(world.GRID.offsets) < 0.02] -= 0.006
    plane = world.path()[:1]
    drive, rut = wheel.start(world.GRID, bed._replace(surface=surface), world.SIZE[None], plane[0])
    np.testing.assert_allclose(rut.surface, world.SURFACE)
    assert drive.sunk == pytest.approx(0.006)


def test_poses_of_a_wheel_go_on_turning():
    """Angles of several turns, whole or frame by frame."""
    plane = np.zeros((200, 4))
    plane[:, 0], plane[:, 1] = -0.38, 0.2
    plane[:, 2], plane[:, 3] = np.linspace(0.5, 20.0, 200), 120.0
    poses, context = world.world_pose(plane), {'load': plane[:, 3]}
    found = world.WHEEL.poses(world.AXES, poses, context)
    np.testing.assert_allclose(found, plane, atol=1e-9)
    last = found[0]
    for t in range(1, 200):
        load = {'load': plane[t : t + 1, 3]}
        last = world.WHEEL.poses(world.AXES, poses[t : t + 1], load, last)[0]
    np.testing.assert_allclose(last, plane[-1], atol=1e-9)


def test_size_of_a_wheel_from_its_points_and_its_soil():
    turned = 0.3
    turn = np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]])
    points = world.body()
    points[:, :2] = points[:, :2] @ turn.T
    points = points + [0.38, 0.2, world.MIDDLE]
    context = {'gravity': 3.72, 'friction_angle_deg': 37.0, 'load': 120.0}
    size = world.WHEEL.size(world.AXES, {}, points, context)
    np.testing.assert_allclose(size, world.SIZE, rtol=1e-12)
    assert world.WHEEL.width_of(size) == pytest.approx(world.WIDTH)


def test_velocity_of_a_wheel_is_that_of_travel_and_rim():
    velocity = [-0.02, 0.0, 0.0, 0.0, 0.0, 0.4]  # towards -x, rolling on
    found = world.WHEEL.velocity(world.AXES, velocity, world.SIZE)
    np.testing.assert_allclose(found, [0.02, 0.4 * world.RADIUS])


def test_a_path_in_steps_is_that_of_one_call():
    """Predicted heights come from the same call for all frames, or frame by frame."""
    plane, bed = world.path(), world.flat_bed(-0.38)
    field = world.make_field()
    size = world.SIZE[None]
    whole_pose, whole = world.WHEEL.frames(
        world.GRID, bed, size, plane, world.DT, None, field.heights
    )
    assert np.abs(whole_pose[..., 1] - plane[..., 1]).max() > 1e-3
    state, _ = world.WHEEL.begin(world.GRID, bed, size, plane[0])
    for t in range(1, len(plane)):
        state, pose, frame = world.WHEEL.step(
            world.GRID, bed, size, state, plane[t], world.DT, field.heights
        )
        np.testing.assert_allclose(pose, whole_pose[t], atol=1e-6)
        for one, other in zip(frame, whole):
            np.testing.assert_allclose(one, other[t], atol=1e-5)
    # The heights that a user gives after the first count for nothing.
    other = plane.copy()
    other[1:, :, 1] += 0.05
    pose, _ = world.WHEEL.frames(world.GRID, bed, size, other, world.DT, None, field.heights)
    np.testing.assert_array_equal(pose, whole_pose)


def test_the_tool_of_a_scene():
    scene = world.make_field().scene
    assert isinstance(tool.for_scene(scene), tool.Wheel)
    blade = dataclasses.replace(scene, rigid_motion=RigidMotion.PRESCRIBED)
    assert isinstance(tool.for_scene(blade), tool.Blade)
    with pytest.raises(ValueError, match='predicted'):
        tool.for_scene(dataclasses.replace(scene, rigid_motion=RigidMotion.PREDICTED))
    with pytest.raises(ValueError, match='gravity'):
        tool.for_scene(dataclasses.replace(scene, context_names=('load',)))
