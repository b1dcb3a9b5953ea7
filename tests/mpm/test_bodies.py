"""Shapes against clouds of points on their surface."""

import math

import numpy as np
import pytest

from mpm import bodies


def distance_to(body, x, y, z, angle=0.0):
    """Distance and normal of a point, given relative to the reference point."""
    sine, cosine = math.sin(angle), math.cos(angle)
    return bodies.signed_distance(body, sine, cosine, x, y, z + body.z_middle)


def cross_section(body, count=4000):
    """Points on the outline of the upright stadium, by geometry alone: sides and half circles."""
    axis, across = np.array([0.0, 1.0]), np.array([-1.0, 0.0])
    along = np.linspace(0.0, body.length, count)[:, None] * axis
    turn = np.linspace(0.0, math.pi, count)[:, None]
    cap = body.radius * (np.cos(turn) * across - np.sin(turn) * axis)
    top = body.length * axis + body.radius * (np.cos(turn) * across + np.sin(turn) * axis)
    return np.concatenate([along + body.radius * across, along - body.radius * across, cap, top])


@pytest.mark.parametrize('body', [bodies.make_blade(0.4), bodies.make_wheel(0.15, 0.4)])
def test_distance_and_normal_against_a_cloud(body):
    outline = cross_section(body)
    wide = body._replace(half_width=10.0)  # so wide that no flank is near
    rng = np.random.default_rng(0)
    for x, y in rng.uniform(-0.2, 0.35, (200, 2)):
        distance, nx, ny, nz = distance_to(wide, x, y, 0.0)
        gap = np.linalg.norm(outline - [x, y], axis=1).min()
        # The cloud's points lie 0.1 mm apart.
        assert abs(distance) == pytest.approx(gap, abs=1e-4)
        assert math.hypot(nx, ny, nz) == pytest.approx(1.0)
        if distance > 1e-3:
            # Outside, stepping against the normal comes nearer.
            nearer = distance_to(wide, x - 1e-4 * nx, y - 1e-4 * ny, 0.0)[0]
            assert nearer < distance


def test_inside_is_negative_and_the_flanks_count():
    wheel = bodies.make_wheel(0.3, 0.2)
    half = wheel.half_width
    assert distance_to(wheel, 0.0, 0.0, 0.0)[0] == pytest.approx(-half)
    distance, nx, ny, nz = distance_to(wheel, 0.0, 0.0, half + 0.01)
    assert (distance, nx, ny, nz) == (pytest.approx(0.01), 0.0, 0.0, 1.0)
    distance, _, _, nz = distance_to(wheel, 0.0, 0.0, -half + 0.001)
    assert distance == pytest.approx(-0.001) and nz == -1.0


@pytest.mark.parametrize(('width', 'spacing'), [(0.457, 0.1), (0.30, 0.1 * 0.30 / 0.457)])
def test_blade_is_as_high_and_as_thick_as_published(width, spacing):
    blade = bodies.make_blade(0.4, width)
    outline = cross_section(blade)
    assert np.ptp(outline[:, 1]) == pytest.approx(0.305, abs=1e-6)
    assert np.ptp(outline[:, 0]) == pytest.approx(0.028, abs=1e-6)
    assert outline[:, 1].min() == pytest.approx(-0.014, abs=1e-6)
    assert blade.half_width == width / 2
    assert blade.reach == pytest.approx(np.linalg.norm(outline, axis=1).max(), abs=1e-6)
    # 4 x 5 points on the front face, symmetric about the middle and on the blade.
    assert blade.points.shape == (20, 3)
    for point in blade.points:
        # The lowest row stands beside the round edge.
        assert abs(distance_to(blade, *point)[0]) < 0.007
    assert (blade.points[:, 0] == -0.014).all() and np.abs(blade.points[:, 2]).max() < width / 2
    assert blade.points[:, 2].sum() == pytest.approx(0.0, abs=1e-12)
    rows = blade.points.reshape(4, 5, 3)
    np.testing.assert_allclose(np.diff(rows, axis=0)[..., 1], 0.1)
    np.testing.assert_allclose(np.diff(rows, axis=1)[..., 2], spacing)


@pytest.mark.parametrize(('diameter', 'width'), [(0.05, 0.125 * 2 / 3), (0.3, 0.125)])
def test_wheel_points_and_edges(diameter, width):
    wheel = bodies.make_wheel(diameter, 0.2)
    points, edges = wheel.points, bodies.wheel_edges()
    np.testing.assert_allclose(np.hypot(points[:, 0], points[:, 1]), diameter / 2)
    assert np.ptp(points[:, 2]) == pytest.approx(width)
    assert len(set(edges)) == 32
    for sender, receiver in edges:
        assert (receiver, sender) in edges
        # Neighbours on one ring, 45 degrees apart.
        chord = np.linalg.norm(points[sender] - points[receiver])
        assert chord == pytest.approx(diameter * math.sin(math.pi / 8))


def test_sample_points_turn_with_the_body():
    wheel = bodies.make_wheel(0.3, 0.2)
    turned = bodies.sample_points(wheel, 1.0, 2.0, math.pi / 2)
    # A positive angle takes +x to +y.
    np.testing.assert_allclose(turned[0], [1.0, 2.15, 0.2 + wheel.points[0, 2]], atol=1e-12)


def test_bad_bodies_are_refused():
    with pytest.raises(ValueError, match='width'):
        bodies.make_blade(0.4, 0.0)
    with pytest.raises(ValueError, match='diameter'):
        bodies.make_wheel(0.0, 0.4)


def test_leaning_body_is_the_upright_one_turned():
    blade, angle = bodies.make_blade(0.4), 0.7
    cosine, sine = math.cos(angle), math.sin(angle)
    for x, y, z in np.random.default_rng(1).uniform(-0.3, 0.3, (50, 3)):
        distance, nx, ny, nz = distance_to(blade, x, y, z)
        turned = distance_to(blade, cosine * x - sine * y, sine * x + cosine * y, z, angle)
        expected = (distance, cosine * nx - sine * ny, sine * nx + cosine * ny, nz)
        np.testing.assert_allclose(turned, expected, atol=1e-12)
