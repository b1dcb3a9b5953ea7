"""Shapes against clouds of points on their surface, and what a tool's file may hold."""

import json
import math

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mpm import bodies, distance
from mpm.motions import operator_paths

BUCKET = bodies.tool_body(operator_paths.bucket(0.1, 0.3, True))
BODIES = {
    'blade': bodies.make_blade(0.3),
    'wheel': bodies.make_wheel(0.15),
    'lugs': bodies.make_wheel(0.2, 0.1, (8, 0.02, 0.01)),
    'bucket': BUCKET,
    'open bucket': bodies.tool_body(operator_paths.bucket(0.1, 0.3, False)),
}
EACH = pytest.mark.parametrize('body', BODIES.values(), ids=BODIES)
STEP = 2e-3  # m, between points of a cloud


def is_in_polygon(points, corners):
    """By the winding angle, which the kernel does not use."""
    a = corners[None] - points[:, None]
    b = np.roll(a, -1, axis=1)
    turn = np.arctan2(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0], (a * b).sum(axis=-1))
    return np.abs(turn.sum(axis=1)) > math.pi


def from_line(points, a, b):
    share = np.clip(((points - a) @ (b - a)) / max((b - a) @ (b - a), 1e-30), 0.0, 1.0)
    return np.linalg.norm(points - a - share[:, None] * (b - a), axis=1)


def is_in_plane(points, corners, radius):
    """Whether points [M, 2] lie within a radius of an outline."""
    ends = np.roll(corners, -1, axis=0)
    near = np.min([from_line(points, a, b) for a, b in zip(corners, ends)], axis=0) <= radius
    return near | (is_in_polygon(points, corners) if len(corners) > 2 else False)


def is_inside(body, p):
    """Whether points [M, 3] lie in a body, part by part."""
    plane, across = p[:, :2], np.abs(p[:, 2])
    inside = is_in_plane(plane, body.outline, body.radius) & (across <= body.half_width)
    for bar in range(body.grousers):
        angle = 2 * math.pi * bar / body.grousers
        end = (body.radius + body.grouser_height - body.grouser_radius) * np.array(
            [math.cos(angle), math.sin(angle)]
        )
        is_bar = from_line(plane, np.zeros(2), end) <= body.grouser_radius
        inside |= is_bar & (across <= body.half_width)
    if len(body.plates):
        plate = is_in_plane(plane, body.plates, 0.0)
        between = (across <= body.half_width) & (across >= body.half_width - body.plate_thickness)
        inside |= plate & between
    return inside


def signed(body, points, angle=0.0):
    sine, cosine = math.sin(angle), math.cos(angle)
    return np.array([distance.signed_distance(body, sine, cosine, *point) for point in points])


@EACH
def test_sign_is_that_of_the_shape_however_it_leans(body):
    rng, angle = np.random.default_rng(0), 0.7
    points = rng.uniform(-1.0, 1.0, (3000, 3)) * [0.45, 0.45, body.half_width + 0.05]
    cosine, sine = math.cos(angle), math.sin(angle)
    turned = points @ np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1.0]])
    found = signed(body, turned, angle)[:, 0]
    clear = np.abs(found) > 1e-9
    np.testing.assert_array_equal((found < 0.0)[clear], is_inside(body, points)[clear])
    assert 0.002 < (found < 0.0).mean() < 0.9


@EACH
def test_distance_outside_is_the_nearest_point_of_the_shape(body):
    """Against a dense cloud of points inside: exact to the spacing of the cloud."""
    reach, half = body.reach + STEP, body.half_width
    rng = np.random.default_rng(1)
    axis = np.arange(-reach, reach, 2 * STEP)
    plane = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    # A prism, and other prisms at its ends.
    middle, end = (
        plane[is_inside(body, np.column_stack([plane, np.full(len(plane), z)]))] for z in (0, half)
    )
    side = 2 * half / 40
    cloud = [
        np.column_stack([layer, np.full(len(layer), z)])
        for z in np.linspace(-half, half, 41)
        for layer in [end if abs(z) >= half - body.plate_thickness else middle]
    ]
    tree = cKDTree(np.concatenate(cloud))
    points = rng.uniform(-1.0, 1.0, (400, 3)) * [reach + 0.05, reach + 0.05, half + 0.05]
    found = signed(body, points)
    outside = found[:, 0] > 0.01
    gap = tree.query(points[outside])[0]
    assert np.abs(found[outside, 0] - gap).max() < math.hypot(2 * STEP * 1.5, side)
    assert (gap > found[outside, 0] - 1e-9).all()  # no point of the shape is nearer


@EACH
def test_normal_is_the_gradient(body):
    rng = np.random.default_rng(2)
    points = rng.uniform(-1.0, 1.0, (200, 3)) * [0.3, 0.3, body.half_width + 0.04]
    found, step = signed(body, points, -0.4), 1e-6
    moved = [signed(body, points + step * unit, -0.4)[:, 0] for unit in np.eye(3)]
    slope = (np.stack(moved, axis=1) - found[:, :1]) / step
    smooth = np.abs(np.linalg.norm(slope, axis=1) - 1.0) < 1e-3  # not where two parts meet
    assert smooth.mean() > 0.95
    np.testing.assert_allclose(slope[smooth], found[smooth, 1:], atol=2e-3)


@EACH
def test_lowest_point_and_extent_are_those_of_the_cloud(body):
    axis = np.arange(-body.reach, body.reach, 4e-3)
    grid = np.stack(np.meshgrid(axis, axis, [0.0, body.half_width]), axis=-1).reshape(-1, 3)
    cloud = grid[is_inside(body, grid)][:, :2]
    for angle in (0.0, -0.6, 0.3):
        turned = cloud @ np.array(
            [[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]]
        )
        low = bodies.lowest(body, np.array([angle]))[0]
        # A wheel with grousers is taken for a circle about their ends.
        slack = 6e-3 + (0.01 if body.grousers else 0.0)
        assert turned[:, 1].min() == pytest.approx(low, abs=slack)
        height = low + 0.05
        x_low, x_high, y_low = bodies.extent_below(body, np.array([[0, 0, angle, 0.0]]), height)
        below = turned[turned[:, 1] < height, 0]
        assert x_low[0] < below.min() + 5e-3 and x_high[0] > below.max() - 5e-3
        assert y_low[0] == low


def test_blade_is_as_high_and_as_thick_as_published():
    blade = bodies.make_blade()
    assert bodies.lowest(blade, np.zeros(1))[0] == -0.014
    assert blade.outline[1, 1] + 2 * blade.radius == pytest.approx(0.305)
    assert blade.points.shape == (20, 3) and (blade.points[:, 0] == -0.014).all()
    rows = blade.points.reshape(4, 5, 3)
    np.testing.assert_allclose(np.diff(rows, axis=0)[..., 1], 0.1)
    np.testing.assert_allclose(np.diff(rows, axis=1)[..., 2], 0.1)
    with pytest.raises(ValueError, match='width'):
        bodies.make_blade(0.0)


@pytest.mark.parametrize(('diameter', 'width'), [(0.05, 0.125 * 2 / 3), (0.3, 0.125)])
def test_wheel_points_and_edges(diameter, width):
    wheel = bodies.make_wheel(diameter)
    points, edges = wheel.points, bodies.wheel_edges()
    np.testing.assert_allclose(np.hypot(points[:, 0], points[:, 1]), diameter / 2)
    assert np.ptp(points[:, 2]) == pytest.approx(width)
    assert len(set(edges)) == 32
    for sender, receiver in edges:
        assert (receiver, sender) in edges
        chord = np.linalg.norm(points[sender] - points[receiver])
        assert chord == pytest.approx(diameter * math.sin(math.pi / 8))


PLATE = {'name': 'plate', 'outline': [[0, 0], [0, 0.2]], 'edge_radius': 0.01, 'width': 0.3}
SQUARE = [[0, 0], [0.1, 0], [0.1, 0.1], [0, 0.1]]
BARS = {'count': 8, 'height': 0.01, 'thickness': 0.004}
WHEEL = {'radius': 0.05, 'width': 0.1, 'grousers': BARS}


def test_a_tool_is_read_from_its_file(tmp_path):
    path = tmp_path / 'plate.json'
    path.write_text(json.dumps(PLATE))
    body = bodies.tool_body(bodies.read_tool(str(path)))
    points = np.random.default_rng(3).uniform(-0.3, 0.3, (50, 3))
    same = bodies.make_blade(0.3)._replace(radius=0.01, outline=body.outline)
    np.testing.assert_array_equal(signed(body, points), signed(same, points))
    clockwise = bodies.check_tool(PLATE | {'outline': SQUARE[::-1]})
    there = signed(bodies.tool_body(clockwise), points)
    here = signed(bodies.tool_body(bodies.check_tool(PLATE | {'outline': SQUARE})), points)
    np.testing.assert_allclose(there[:, 0], here[:, 0], atol=1e-15)


@pytest.mark.parametrize(
    ('tool', 'change', 'words'),
    [
        (PLATE, {'outline': [[0, 0], [0.1, 0.1], [0.1, 0], [0, 0.1]]}, 'crosses itself: edges'),
        (PLATE, {'outline': [[0, 0], [0.1, 0], [0.2, 0]]}, 'crosses itself|encloses no area'),
        (PLATE, {'outline': [[0, 0], [0, 200]]}, 'millimetres'),
        (PLATE, {'outline': [[0, 0], [0, 0]]}, 'twice in a row'),
        (PLATE, {'outline': [[0, 0], [0, float('nan')]]}, r'list of \[x, y\]'),
        (PLATE, {'outline': 'blade'}, r'list of \[x, y\]'),
        (PLATE, {'width': -1}, 'width must be a number'),
        (PLATE, {'width': 457}, 'width must be a number from 0.0001 to 2, got 457'),
        (PLATE, {'colour': 'red'}, r"unknown entries \['colour'\]"),
        (PLATE, {'friction': 9}, 'friction must be'),
        (PLATE, {'side_plates': 0.02}, 'side_plates must be a JSON object'),
        (PLATE, {'side_plates': {'thickness': 0.02}}, 'no side plates without an outline'),
        (PLATE | {'outline': SQUARE}, {'side_plates': {'thickness': 0.2}}, 'thicker than the tool'),
        (PLATE | {'outline': SQUARE}, {'side_plates': {'thick': 0.02}}, r"\['thick'\] of side_pla"),
        (PLATE, {'radius': 0.1}, r"unknown entries \['edge_radius', 'outline'\] of the tool"),
        (WHEEL, {'grousers': [12]}, 'grousers must be a JSON object'),
        (WHEEL, {'grousers': BARS | {'count': 7.5}}, 'must be a whole number, got 7.5'),
        (WHEEL, {'grousers': BARS | {'count': 80}}, '80 grousers 0.004 m thick overlap'),
        (WHEEL, {'grousers': BARS | {'height': 0.001}}, 'must exceed half the thickness'),
        (WHEEL, {'grousers': {'count': 8, 'height': 0.01}}, 'thickness must be a number'),
    ],
)
def test_a_wrong_tool_is_refused_with_its_file(tmp_path, tool, change, words):
    path = tmp_path / 'tool.json'
    path.write_text(json.dumps(tool | change))
    with pytest.raises(ValueError, match=f'tool.json is not a tool: .*({words})'):
        bodies.read_tool(str(path))
