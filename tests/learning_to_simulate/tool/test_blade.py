"""A blade: the state of its path, its outline, its size."""

import numpy as np
import pytest

from learning_to_simulate.tool import blade
from learning_to_simulate.tool.blade import Blade
from tests.learning_to_simulate.swept_field import small_world as world

BLADE, SIZE = Blade(), np.array([0.3])
POSE = np.array([0.1, 0.2, 0.6])


def run(plane, bed=None, dt=world.DT, state=None):
    bed = world.flat_bed(plane[0, 0, 0]) if bed is None else bed
    if state is None:
        state, plane = blade.start(world.GRID, bed, plane[0]), plane[1:]
    for pose in plane:
        state = blade.advance(world.GRID, state, pose, dt)
    return state, bed


def seen(state, bed):
    return blade.frame(world.GRID, bed, np.array([0.457]), state)


def test_the_room_before_the_wall_is_that_of_the_foremost_place():
    plane = world.path()
    bed = world.flat_bed(plane[0, 0, 0])
    _, found = BLADE.frames(world.GRID, bed, np.array([[0.457]]), plane, world.DT)
    room = found.scalars[:, 0, blade.SCALARS.index('room')]
    # Above the soil the blade is nowhere; where it is pulled back, the soil it pushed stays.
    cut = plane[:, 0, 1] - world.BLADE.radius < world.SURFACE
    foremost = [plane[: t + 1, 0, 0][cut[: t + 1]].max(initial=plane[0, 0, 0]) for t in range(61)]
    np.testing.assert_allclose(room, bed.end - foremost, atol=1e-6)
    assert room[-1] < 0.45 and (np.diff(plane[:, 0, 0]) < 0).any()


def test_influence_and_disturbed_depth_are_cones_about_the_cut():
    state, bed = run(world.path()[:35])
    bins = seen(state, bed).bins[0]
    cut = (state.swept.surface - state.swept.profile)[0]
    u = world.GRID.offsets
    touched = np.minimum(cut / blade.TOUCH, 1.0)
    for i in range(0, len(u), 7):
        distance = np.abs(u - u[i])
        influence = np.clip(3 * (touched - distance / blade.REACH).max(), 0, 1)
        depth = (cut - blade.RISE * distance).max()
        assert bins[i, blade.INFLUENCE] == pytest.approx(influence, abs=1e-6)
        assert bins[i, blade.DISTURBED] == pytest.approx(depth, abs=1e-6)
    assert cut.max() > 0.02


def test_nothing_is_influenced_before_the_soil_is_touched():
    plane = world.path()[:1] + [[0.0, 0.03, 0.0]]
    plane = np.concatenate([plane + [[0.002 * i, 0.0, 0.0]] for i in range(20)])
    bins = seen(*run(plane)).bins
    assert not bins[..., blade.INFLUENCE].any()
    assert not bins[..., blade.CUT].any()


def test_memory_is_the_exponential_average_of_the_velocity():
    plane = world.path()
    state, _ = run(plane)
    velocity = np.diff(plane[:, 0], axis=0) / world.DT
    for k, tau in enumerate(blade.TIME_SCALES):
        age = np.arange(len(velocity))[::-1] * world.DT
        weight = np.exp(-age / tau) * (1 - np.exp(-world.DT / tau))
        np.testing.assert_allclose(state.memory[0, k], weight @ velocity, atol=1e-12)


def outline(n=4000):
    """[n, 2] points of the stadium, drawn from its definition."""
    axis = BLADE.length * np.array([-np.sin(POSE[2]), np.cos(POSE[2])])
    side = np.array([axis[1], -axis[0]]) / BLADE.length
    t = np.linspace(0, 1, n // 4)[:, None]
    angle = np.linspace(0, 2 * np.pi, n // 4)
    ring = BLADE.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    low, outward = POSE[:2], ring @ axis < 0
    return np.concatenate(
        [low + t * axis + BLADE.radius * side, low + t * axis - BLADE.radius * side,
         low + ring[outward], low + axis + ring[~outward]]
    )  # fmt: skip


def cloud(n=3000):
    rng = np.random.default_rng(0)
    return rng.uniform([-0.15, 0.15, -0.25], [0.2, 0.55, 0.25], (n, 3))


def test_points_leave_by_the_shortest_way():
    points = cloud()
    depth, way = BLADE.inside(points, POSE, SIZE)
    is_in = depth > 0
    assert is_in.sum() > 50
    drawn = outline()
    for point, d in zip(points[is_in], depth[is_in]):
        to_outline = np.hypot(*(drawn - point[:2]).T).min()
        assert d == pytest.approx(min(to_outline, SIZE[0] / 2 - abs(point[2])), abs=3e-4)
    np.testing.assert_allclose(np.linalg.norm(way, axis=1), depth, atol=1e-12)
    assert BLADE.inside(points + way, POSE, SIZE)[0].max() < 1e-12
    assert not way[depth == 0].any()


def test_a_point_on_the_axis_goes_to_the_front():
    _, way = BLADE.inside(np.array([[*POSE[:2], 0.0]]), POSE, SIZE)
    front = np.array([np.cos(POSE[2]), np.sin(POSE[2])])
    np.testing.assert_allclose(way[0, :2], BLADE.radius * front, atol=1e-12)


def test_size_of_a_blade_is_that_of_its_case():
    assert BLADE.size(world.AXES, {'blade_width_m': 0.3}) == [0.3]
    assert BLADE.size(world.AXES, {}) == [BLADE.width]
