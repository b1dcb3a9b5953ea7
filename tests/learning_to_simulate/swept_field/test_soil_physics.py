"""Push-out against points drawn on the blade's outline."""

import numpy as np
import pytest

from learning_to_simulate.methods.swept_field import soil_physics
from learning_to_simulate.methods.swept_field.tools import Blade

BLADE, WIDTH = Blade(), 0.3
POSE = np.array([0.1, 0.2, 0.6])


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
    depth, way = soil_physics.inside(points, POSE, BLADE, WIDTH)
    is_in = depth > 0
    assert is_in.sum() > 50
    drawn = outline()
    for point, d in zip(points[is_in], depth[is_in]):
        to_outline = np.hypot(*(drawn - point[:2]).T).min()
        assert d == pytest.approx(min(to_outline, WIDTH / 2 - abs(point[2])), abs=3e-4)
    np.testing.assert_allclose(np.linalg.norm(way, axis=1), depth, atol=1e-12)


def test_nothing_is_left_inside_and_nothing_else_moves():
    points = cloud()
    out = soil_physics.pushed_out(points, POSE, BLADE, WIDTH)
    assert soil_physics.inside(out, POSE, BLADE, WIDTH)[0].max() < 1e-12
    still = soil_physics.inside(points, POSE, BLADE, WIDTH)[0] == 0
    np.testing.assert_array_equal(out[still], points[still])


def test_a_point_on_the_axis_goes_to_the_front():
    out = soil_physics.pushed_out(np.array([[*POSE[:2], 0.0]]), POSE, BLADE, WIDTH)
    front = np.array([np.cos(POSE[2]), np.sin(POSE[2])])
    np.testing.assert_allclose(out[0, :2], POSE[:2] + BLADE.radius * front, atol=1e-12)


def test_volumes():
    points = np.array([[0.0, 0.1, 0.0], [0.0, 0.3, 0.0], [0.1, 0.31, 0.0]])
    assert soil_physics.heap_volume(points, np.full(3, 0.25), 2e-6) == pytest.approx(4e-6)
    assert soil_physics.cut_volume(0.01, 0.4) == pytest.approx(0.004)
