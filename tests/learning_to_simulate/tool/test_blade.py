"""A blade: the state of its path and its size."""

import numpy as np
import pytest

from learning_to_simulate.tool import blade
from tests.learning_to_simulate.swept_field import small_world as world

S = {name: i for i, name in enumerate(blade.SCALARS)}


def test_the_room_before_the_wall_is_that_of_the_foremost_place():
    plane = world.path()
    room = world.frames(plane).scalars[:, S['room']]
    # Above the soil the blade is nowhere; where it is pulled back, the soil it pushed stays.
    cut = plane[:, 0, 1] - world.BLADE.radius < world.SURFACE
    foremost = [plane[: t + 1, 0, 0][cut[: t + 1]].max(initial=plane[0, 0, 0]) for t in range(61)]
    np.testing.assert_allclose(room, plane[0, 0, 0] + 0.6 - foremost, atol=1e-6)
    assert room[-1] < 0.45 and (np.diff(plane[:, 0, 0]) < 0).any()


def test_influence_and_disturbed_depth_are_cones_about_the_cut():
    bins, u = world.frames(world.path()[:35]).bins[-1].astype(float), world.GRID.offsets
    cut = bins[:, blade.CUT]
    apart = np.abs(u[:, None] - u)
    reached = np.minimum(cut / blade.TOUCH, 1.0) - apart / blade.REACH
    influence = np.clip(3 * reached.max(axis=1), 0, 1)
    np.testing.assert_allclose(bins[:, blade.INFLUENCE], influence, atol=1e-6)
    disturbed = (cut - blade.RISE * apart).max(axis=1)
    np.testing.assert_allclose(bins[:, blade.DISTURBED], disturbed, atol=1e-6)
    assert cut.max() > 0.02


def test_nothing_is_influenced_before_the_soil_is_touched():
    plane = world.path()[:1] + np.linspace(0.0, 0.04, 20)[:, None, None] * [1, 0, 0] + [0, 0.03, 0]
    assert not world.frames(plane).bins[..., [blade.INFLUENCE, blade.CUT]].any()


def test_memory_is_the_exponential_average_of_the_velocity():
    plane = world.path()
    velocity = np.diff(plane[:, 0], axis=0) / world.DT
    age = np.arange(len(velocity))[::-1] * world.DT
    for k, tau in enumerate(blade.TIME_SCALES):
        weight = np.exp(-age / tau) * (1 - np.exp(-world.DT / tau))
        memory = weight @ velocity + np.exp(-len(velocity) * world.DT / tau) * velocity[0]
        found = world.frames(plane).scalars[-1, [S[f'{n}_{k}'] for n in ('speed', 'rise', 'turn')]]
        np.testing.assert_allclose(found, memory, atol=1e-6)


@pytest.mark.parametrize('times', [1, 3])
def test_a_press_is_the_way_down_that_no_way_along_goes_with(times):
    """35 mm down, 10 mm down again in the same hole after a lift, then down and along."""
    steps = [[0, -0.035, 0], [0, 0.02, 0], [0, -0.03, 0], [0.002, -0.01, 0], [0.1, 0, 0]]
    steps = np.repeat(np.array(steps) / times, times, axis=0)
    first = [-0.75, world.SURFACE + world.BLADE.radius, 0.4]
    plane = first + np.cumsum([np.zeros(3), *steps], axis=0)
    found = world.frames(plane[:, None]).scalars[::times, S['pressed']]
    steep = 0.01 - blade.STEEP * 0.002
    np.testing.assert_allclose(found, [0, 0.035, 0, 0.01, 0.01 + max(steep, -0.01), 0], atol=1e-6)


def test_size_of_a_blade_is_that_of_its_case():
    assert world.BLADE.size(world.AXES, {'blade_width_m': 0.3}) == [0.3]
    assert world.BLADE.size(world.AXES, {}) == [world.BLADE.width]
