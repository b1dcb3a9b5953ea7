"""Rigid bodies: blades, buckets and rippers with an outline, wheels with grousers.

A body is drawn in the plane of travel and has a width across it. In the plane it is

- an outline: all points within `radius` of a point, of a segment, or of a solid polygon. A blade is
  a segment (its edges are round, with half its thickness as radius), a wheel is a point, a bucket
  is a polygon;
- and, of a wheel, grousers: equal bars with round ends that stand out of the rim;
- and, of a bucket, two side plates: a polygon that closes each end over some thickness.

A point without a width is a ball.

It is described upright in its own frame, whose origin is the reference point (the middle of a
blade's lower edge, a wheel's axle); where it is and how it leans is its pose: x, y (m), angle (rad,
counter-clockwise about +z), z (m) of its middle. Axes: x is the way of driving (towards -x), y is
up, z lies across.
"""

import itertools
import json
import math
from typing import NamedTuple

import numpy as np

BLADE_HEIGHT, BLADE_THICKNESS, BLADE_WIDTH = 0.305, 0.028, 0.457
BLADE_FRICTION = 0.3
MAX_LEAN_DEG = 60.0
POINT_SPACING = 0.1
WHEEL_WIDTH = 0.125
WHEEL_RING_POINTS = 8
WHEEL_FRICTION = 0.5
MAX_VERTICES = 64  # of an outline; every particle near the tool looks at each edge
MAX_SIZE = 2.0  # m; more is taken for another unit


class Body(NamedTuple):
    """Shape and surface of a rigid body, upright in its own frame; kernels take it as it is."""

    # float64 [M, 2], m: vertices of a polygon, counter-clockwise; two: a segment; one: a point
    outline: np.ndarray
    radius: float  # m, by which the outline is thickened
    half_width: float  # across, m
    friction: float  # Coulomb coefficient between body and soil
    grousers: int = 0  # how many stand out of the rim of a wheel
    # grouser_height, grouser_radius: beyond the rim, and half the thickness, m
    grouser_height: float = 0.0
    grouser_radius: float = 0.0
    # float64 [P, 2], m: the polygon of the two side plates; P = 0: there are none
    plates: np.ndarray = np.zeros((0, 2))
    plate_thickness: float = 0.0  # m, inwards from each end
    # float64 [R, 3], sample points relative to the reference point (m)
    points: np.ndarray = np.zeros((0, 3))

    @property
    def reach(self) -> float:
        """Largest distance of the outline from the reference point in the plane, m."""
        corners = np.concatenate([self.outline, self.plates])
        return float(np.hypot(*corners.T).max()) + self.radius + self.grouser_height

    @property
    def is_wheel(self) -> bool:
        """Whether its outline is a circle about the reference point."""
        return len(self.outline) == 1


def make_blade(width: float = BLADE_WIDTH) -> Body:
    """Builds the blade; its lean is part of its pose.

    The reference point is the middle of the round lower edge, half a thickness above its lowest
    point. R = 20 points lie in the plane of the front face, 4 rows x 5 columns, in the middle of
    the face: rows 0.1 m apart, columns 0.1 m for the width of 0.457 m and in proportion for
    another.
    """
    if not width > 0.0:
        raise ValueError(f'blade width must be positive, got {width} m')
    radius, length = BLADE_THICKNESS / 2, BLADE_HEIGHT - BLADE_THICKNESS
    spacing = POINT_SPACING * width / BLADE_WIDTH
    points = [
        (-radius, length / 2 + (row - 1.5) * POINT_SPACING, (column - 2) * spacing)
        for row in range(4)
        for column in range(5)
    ]
    outline = np.array([(0.0, 0.0), (0.0, length)])
    return Body(outline, radius, width / 2, BLADE_FRICTION, points=np.array(points))


def make_wheel(
    diameter: float,
    width: float | None = None,
    grousers: tuple = (0, 0.0, 0.0),
    friction: float = WHEEL_FRICTION,
) -> Body:
    """Builds a wheel; the reference point is its axle. R = 16 points: two rings of 8 at the rim, 45
    degrees apart.

    Without a width (m) it is that of the published wheels, of which the two small ones are 2/3 as
    wide. `grousers`: number, height beyond the rim and thickness (m) of the bars; ValueError if
    they overlap, or are not higher than half their thickness.
    """
    if width is None:
        width = WHEEL_WIDTH if diameter > 0.2 else WHEEL_WIDTH * 2.0 / 3.0
    radius = diameter / 2.0
    count, height, thickness = grousers
    if count and not (height > thickness / 2.0 > 0.0):
        raise ValueError(
            f'grousers of height {height} m and thickness {thickness} m: the height must exceed '
            'half the thickness, both must be positive'
        )
    if count * thickness > math.pi * diameter:
        raise ValueError(
            f'{count} grousers {thickness} m thick overlap on a rim of {math.pi * diameter:.4g} m'
        )
    angles = 2.0 * math.pi * np.arange(WHEEL_RING_POINTS) / WHEEL_RING_POINTS
    points = [
        (radius * math.cos(angle), radius * math.sin(angle), side * width / 2)
        for side in (-1.0, 1.0)
        for angle in angles
    ]
    bars = int(count), float(height), thickness / 2.0
    return Body(np.zeros((1, 2)), radius, width / 2.0, friction, *bars, points=np.array(points))


def make_ball(diameter: float) -> Body:
    """Builds a ball; its middle is the reference point and the only sample point."""
    return Body(np.zeros((1, 2)), diameter / 2.0, 0.0, BLADE_FRICTION, points=np.zeros((1, 3)))


def wheel_edges() -> tuple:
    """Returns the directed edges (sender, receiver) that join each point of the wheel with its two
    neighbours on its ring."""
    n = WHEEL_RING_POINTS
    near = [(j % n, i) for i in range(n) for j in (i - 1, i + 1)]
    return tuple((ring * n + j, ring * n + i) for ring in range(2) for j, i in near)


# Tools from a file


def read_tool(path: str) -> dict:
    """Reads a tool's JSON file and returns its description, complete and checked.

    An outline of 2 to 64 points, lengths in m (1e-4 to 2), friction 0 to 2; the origin is the
    reference point, driving goes to -x::

        {"name": "bucket", "outline": [[x, y], ...], "edge_radius": 0.004, "width": 0.3,
         "side_plates": {"thickness": 0.01}, "friction": 0.3}

    two points make a plate of thickness 2 edge_radius, more a solid polygon. `side_plates` may have
    an "outline" of its own; without one it is the convex hull of the tool's. A wheel::

        {"name": "wheel", "radius": 0.15, "width": 0.12, "friction": 0.5,
         "grousers": {"count": 12, "height": 0.01, "thickness": 0.004}}

    FileNotFoundError: there is no such file. ValueError, with the file: no JSON, an unknown or
    missing entry, a length outside its range, an outline that crosses itself.
    """
    with open(path, encoding='utf-8') as file:
        try:
            return check_tool(json.load(file))
        except (ValueError, RecursionError) as error:
            raise ValueError(f'{path} is not a tool: {error}') from error


_OUTLINE = {'name', 'outline', 'edge_radius', 'width', 'friction', 'side_plates'}
_WHEEL = {'name', 'radius', 'width', 'friction', 'grousers'}


def check_tool(tool: dict) -> dict:
    """Returns a tool's description with its defaults filled in; ValueError as `read_tool`."""
    is_wheel = isinstance(tool, dict) and 'radius' in tool
    _check_entries(tool, _WHEEL if is_wheel else _OUTLINE, 'the tool')
    name = tool.get('name', 'tool')
    if not (isinstance(name, str) and name.replace('-', '').replace('_', '').isalnum()):
        raise ValueError(f'name must be of letters, digits, - and _, got {name!r}')
    usual = {'friction': WHEEL_FRICTION if is_wheel else BLADE_FRICTION}
    checked = {'name': name, 'friction': _number(usual | tool, 'friction', 0.0, 2.0)}
    for length in ('width', 'radius' if is_wheel else 'edge_radius'):
        checked[length] = _number(tool, length)
    if is_wheel:
        if bars := tool.get('grousers'):
            _check_entries(bars, {'count', 'height', 'thickness'}, 'grousers')
            count = _number(bars, 'count', 1, 360)
            if count % 1:
                raise ValueError(f'count of the grousers must be a whole number, got {count}')
            lengths = {side: _number(bars, side) for side in ('height', 'thickness')}
            checked['grousers'] = {'count': int(count), **lengths}
    else:
        checked['outline'] = _polygon(tool.get('outline'), 'outline')
        if plates := tool.get('side_plates'):
            _check_entries(plates, {'thickness', 'outline'}, 'side_plates')
            outline = plates.get('outline') or _hull(checked['outline'])
            checked['side_plates'] = {
                'thickness': _number(plates, 'thickness'),
                'outline': _polygon(outline, 'outline of the side plates', least=3),
            }
            if 2 * checked['side_plates']['thickness'] >= checked['width']:
                raise ValueError('the side plates are thicker than the tool is wide')
    tool_body(checked)
    return checked


def _check_entries(found, known, what):
    if not isinstance(found, dict):
        raise ValueError(f'{what} must be a JSON object, got {str(found)[:80]}')
    if unknown := sorted(set(found) - known):
        raise ValueError(f'unknown entries {unknown} of {what}; there are {sorted(known)}')


def _number(tool, name, low=1e-4, high=MAX_SIZE):
    """A number of a description; by default a length, m."""
    value = tool.get(name)
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f'{name} must be a number from {low:g} to {high:g}, got {value!r}')
    return float(value)


def _polygon(vertices, what, least=2) -> list:
    try:
        points = np.array(vertices, dtype=np.float64)
    except (TypeError, ValueError):
        points = np.zeros(0)
    if points.ndim != 2 or points.shape[1:] != (2,) or not np.isfinite(points).all():
        raise ValueError(f'{what} must be a list of [x, y] in m, got {str(vertices)[:80]}')
    if not least <= len(points) <= MAX_VERTICES:
        raise ValueError(f'{what} has {len(points)} points, expected {least} to {MAX_VERTICES}')
    if np.abs(points).max() > MAX_SIZE:
        raise ValueError(
            f'{what} reaches {np.abs(points).max():g} m from the reference point, at most '
            f'{MAX_SIZE:g}; are these millimetres?'
        )
    if np.hypot(*(np.roll(points, -1, axis=0) - points).T).min() < 1e-6:
        raise ValueError(f'{what} has a point twice in a row')
    if len(points) > 2:
        if crossing := _crossing(points):
            raise ValueError(f'{what} crosses itself: edges {crossing[0]} and {crossing[1]}')
        x, y = points.T
        area = 0.5 * float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
        if abs(area) < 1e-8:
            raise ValueError(f'{what} encloses no area')
        if area < 0.0:
            points = points[::-1]
    return points.tolist()


def _crossing(points):
    """The numbers of two edges of a closed polygon that meet where they should not, or None."""

    def cross(a, b):
        return a[0] * b[1] - a[1] * b[0]

    edges = list(zip(points, np.roll(points, -1, axis=0)))
    for i, j in itertools.combinations(range(len(edges)), 2):
        (a, b), (c, d) = edges[i], edges[j]
        if j == i + 1 or (i == 0 and j == len(edges) - 1):
            # Neighbours share a point; they must not run back over each other.
            if abs(cross(b - a, d - c)) < 1e-12 and (b - a) @ (d - c) < 0.0:
                return i, j
            continue
        is_across = cross(b - a, c - a) * cross(b - a, d - a) <= 0.0
        is_across &= cross(d - c, a - c) * cross(d - c, b - c) <= 0.0
        # On one line they meet only if they overlap.
        first = np.maximum(np.minimum(a, b), np.minimum(c, d))
        last = np.minimum(np.maximum(a, b), np.maximum(c, d))
        if is_across and (last >= first).all():
            return i, j
    return None


def _hull(points) -> list:
    """The convex hull of points, counter-clockwise from the leftmost one on."""
    from scipy.spatial import ConvexHull  # slow to load, and help does not wait for it

    if np.linalg.matrix_rank(np.subtract(points, points[0])) < 2:
        raise ValueError('a plate has no side plates without an outline of their own')
    ring = ConvexHull(points).vertices
    first = min(range(len(ring)), key=lambda n: tuple(points[ring[n]]))
    return [points[n] for n in np.roll(ring, -first)]


def tool_body(tool: dict) -> Body:
    """Returns the body of a checked description; ValueError as `make_wheel`.

    R = 20 sample points of an outline: 4 places along it, from the vertex nearest to the reference
    point on, 5 columns across; of a wheel as `make_wheel`.
    """
    if 'radius' in tool:
        g = tool.get('grousers', {'count': 0, 'height': 0.0, 'thickness': 0.0})
        bars = g['count'], g['height'], g['thickness']
        return make_wheel(2.0 * tool['radius'], tool['width'], bars, tool['friction'])
    outline = np.array(tool['outline'])
    first = int(np.argmin(np.hypot(*outline.T)))
    chain = np.roll(outline, -first, axis=0)
    if len(chain) > 2:
        chain = np.concatenate([chain, chain[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(chain, axis=0).T))])
    # An open chain is sampled end to end, a closed one has no end.
    at = np.linspace(0.0, along[-1], 4, endpoint=len(outline) == 2)
    places = np.stack([np.interp(at, along, chain[:, axis]) for axis in range(2)], axis=1)
    columns = (np.arange(5) - 2) * POINT_SPACING * tool['width'] / BLADE_WIDTH
    points = [(x, y, z) for x, y in places for z in columns]
    surface = outline, tool['edge_radius'], tool['width'] / 2, tool['friction']
    body = Body(*surface, points=np.array(points))
    if not (plates := tool.get('side_plates')):
        return body
    sides = np.array(plates['outline'])
    return body._replace(plates=sides, plate_thickness=plates['thickness'])


def blade_or(tool: dict | None, width: float) -> tuple[Body, dict]:
    """Returns the body of a checked tool, without one the blade of a width (m), and what a run's
    parameters say of it."""
    if tool is not None:
        return tool_body(tool), {'tool': tool}
    return make_blade(width), {'blade_width_m': width}


# Where a body is


def sample_points(body: Body, pose) -> np.ndarray:
    """Returns the body's sample points [R, 3] (m) at a pose: x, y (m), theta (rad), z (m)."""
    x, y, theta, z = pose
    cosine, sine = math.cos(theta), math.sin(theta)
    px, py = body.points[:, 0], body.points[:, 1]
    return np.stack(
        [x + cosine * px - sine * py, y + sine * px + cosine * py, z + body.points[:, 2]], axis=1
    )


def lowest(body: Body, theta: np.ndarray) -> np.ndarray:
    """Returns the height [T] of a body's lowest point over its reference point, m (negative below
    it), at angles theta [T] (rad)."""
    theta = np.asarray(theta, np.float64)
    corners = np.concatenate([body.outline, body.plates])
    edges = [body.radius + body.grouser_height] * len(body.outline) + [0.0] * len(body.plates)
    height = np.sin(theta)[..., None] * corners[:, 0] + np.cos(theta)[..., None] * corners[:, 1]
    return (height - edges).min(axis=-1)


def extent_below(body: Body, poses: np.ndarray, height: float):
    """Returns the extent of a body at `poses` [T, 4] below a `height` (m), as seen from the side.

    That is lowest and highest x [T] of what is below (the whole reach of a round end that dips
    below it; +-inf if nothing does) and the lowest y [T], m.
    """
    x, y, theta = np.asarray(poses, np.float64).T[:3]
    cosine, sine = np.cos(theta), np.sin(theta)
    low, high = np.full(len(x), np.inf), np.full(len(x), -np.inf)
    for corners, radius in (
        (body.outline, body.radius + body.grouser_height), (body.plates, 0.0),
    ):  # fmt: skip
        ends = [
            (x + (a * cosine - b * sine), y + (a * sine + b * cosine) - radius) for a, b in corners
        ]
        for (ax, ay), (bx, by) in zip(ends, ends[1:] + ends[:1]):
            # The share of the edge at which it leaves what is below the height.
            with np.errstate(divide='ignore', invalid='ignore'):
                share = np.clip(np.where(by != ay, (height - ay) / (by - ay), 0.0), 0.0, 1.0)
            reach = radius
            if len(corners) == 1:  # the chord of the circle at that height
                depth = np.clip(height - (ay + radius), -radius, radius)
                reach = np.where(depth < 0.0, np.sqrt(radius**2 - depth**2), radius)
            crosses = (ay < height) != (by < height)
            for at, is_below in ((ax, ay < height), (ax + share * (bx - ax), crosses)):
                low = np.where(is_below, np.minimum(low, at - reach), low)
                high = np.where(is_below, np.maximum(high, at + reach), high)
    return low, high, y + lowest(body, theta)
