"""The rigid bodies: an excavation blade and a rover wheel.

Both are one shape to the kernels, a stadium drawn out along z: all points within a radius of a
line segment. The blade's edges are thus round, with half its thickness as radius (one cell, so
less than the grid resolves), and the normal of contact turns without a jump. The segment of the
wheel has no length. A body is described upright in its own frame, whose origin is the reference
point; where it is and how it leans is its pose (`Drive`). Axes: x is the way of driving (towards
-x), y is up, z lies across.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from mpm.columns import JIT

BLADE_HEIGHT, BLADE_THICKNESS, BLADE_WIDTH = 0.305, 0.028, 0.457
BLADE_FRICTION = 0.3
MAX_LEAN_DEG = 60.0
POINT_SPACING = 0.1
WHEEL_WIDTH = 0.125
WHEEL_RING_POINTS = 8
WHEEL_FRICTION = 0.5


class Body(NamedTuple):
    """Shape and surface of a rigid body, upright in its own frame; kernels take it as it is.

    Attributes:
        length: of the segment from the reference point upwards, m.
        radius: m.
        half_width: across, m.
        z_middle: z of the reference point, m; it never moves.
        friction: Coulomb coefficient between body and soil.
        points: float64 [R, 3], sample points relative to the reference point (m).
    """

    length: float
    radius: float
    half_width: float
    z_middle: float
    friction: float
    points: np.ndarray

    @property
    def reach(self) -> float:
        """Largest distance of the outline from the reference point across z, m."""
        return self.length + self.radius


def make_blade(z_middle: float, width: float = BLADE_WIDTH) -> Body:
    """Builds the blade; its lean is part of its pose.

    The reference point is the middle of the round lower edge, half a thickness above its
    lowest point. R = 20 points lie in the plane of the front face, 4 rows x 5 columns, in the
    middle of the face: rows 0.1 m apart, columns 0.1 m for the width of 0.457 m and in proportion
    for another.

    Raises:
        ValueError: if the width is not positive.
    """
    if not width > 0.0:
        raise ValueError(f'blade width must be positive, got {width} m')
    radius = BLADE_THICKNESS / 2
    length = BLADE_HEIGHT - BLADE_THICKNESS
    spacing = POINT_SPACING * width / BLADE_WIDTH
    points = [
        (-radius, length / 2 + (row - 1.5) * POINT_SPACING, (column - 2) * spacing)
        for row in range(4)
        for column in range(5)
    ]
    return Body(length, radius, width / 2, z_middle, BLADE_FRICTION, np.array(points))


def make_wheel(diameter: float, z_middle: float) -> Body:
    """Builds the wheel; the reference point is its centre.

    R = 16 points: two rings of 8 at the rim, 45 degrees apart. The two small wheels are 2/3 as
    wide.

    Raises:
        ValueError: if the diameter is not positive.
    """
    if not diameter > 0.0:
        raise ValueError(f'wheel diameter must be positive, got {diameter} m')
    width = WHEEL_WIDTH if diameter > 0.2 else WHEEL_WIDTH * 2.0 / 3.0
    radius = diameter / 2.0
    angles = 2.0 * math.pi * np.arange(WHEEL_RING_POINTS) / WHEEL_RING_POINTS
    points = [
        (radius * math.cos(angle), radius * math.sin(angle), side * width / 2)
        for side in (-1.0, 1.0)
        for angle in angles
    ]
    return Body(0.0, radius, width / 2, z_middle, WHEEL_FRICTION, np.array(points))


def wheel_edges() -> tuple:
    """Returns the directed edges (sender, receiver) of the wheel's points.

    They join each point with its two neighbours on its ring, both directions.
    """
    edges = []
    for ring in range(2):
        here = ring * WHEEL_RING_POINTS
        for i in range(WHEEL_RING_POINTS):
            edges += [(here + j % WHEEL_RING_POINTS, here + i) for j in (i - 1, i + 1)]
    return tuple(edges)


def sample_points(body: Body, x: float, y: float, theta: float) -> np.ndarray:
    """Returns the body's sample points [R, 3] (m) at a pose; theta in rad about +z."""
    cosine, sine = math.cos(theta), math.sin(theta)
    px, py = body.points[:, 0], body.points[:, 1]
    return np.stack(
        [
            x + cosine * px - sine * py,
            y + sine * px + cosine * py,
            body.z_middle + body.points[:, 2],
        ],
        axis=1,
    )


@numba.njit(inline='always', **JIT)
def signed_distance(body, sine, cosine, rx, ry, z):
    """Signed distance (m, negative inside) and outward normal of the nearest face.

    Args:
        body: `Body`.
        sine, cosine: of its angle.
        rx, ry: position relative to the reference point (m).
        z: absolute z (m).

    Returns:
        (distance, nx, ny, nz). Exact, but for a lower bound outside of the rims between the round
        surface and the two flat ends.
    """
    # In the body's own frame: `along` the segment, `beyond` its ends.
    along, ahead = ry * cosine - rx * sine, rx * cosine + ry * sine
    beyond = along - min(max(along, 0.0), body.length)
    norm = math.sqrt(beyond * beyond + ahead * ahead)
    distance = norm - body.radius
    side = abs(z - body.z_middle) - body.half_width
    if side > distance:
        return side, 0.0, 0.0, 1.0 if z > body.z_middle else -1.0
    if norm == 0.0:
        return distance, -cosine, -sine, 0.0
    ahead, beyond = ahead / norm, beyond / norm
    return distance, ahead * cosine - beyond * sine, ahead * sine + beyond * cosine, 0.0
