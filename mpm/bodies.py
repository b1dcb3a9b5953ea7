"""The rigid bodies: an excavation blade and a rover wheel.

Both are one shape to the kernels, a stadium drawn out along z: all points within a radius of a
line segment. The blade's edges are thus round, with half its thickness as radius (one cell, so
less than the grid resolves), and the normal of contact turns without a jump. The segment of the
wheel has no length. Axes: x is the way of driving (towards -x), y is up, z lies across.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np

from mpm.columns import JIT

BLADE_HEIGHT, BLADE_THICKNESS, BLADE_WIDTH = 0.305, 0.028, 0.457
BLADE_FRICTION = 0.3
POINT_SPACING = 0.1
WHEEL_WIDTH = 0.125
WHEEL_RING_POINTS = 8
WHEEL_FRICTION = 0.5


@dataclass(frozen=True)
class Body:
    """Shape and surface of a rigid body.

    Attributes:
        dims: float64 [7]: sine and cosine of the segment's lean, its length (m), radius (m), half
            width (m), z of the middle (m), shift (m) of the line that parts front from back.
        friction: Coulomb coefficient between body and soil.
        outset: where contact begins, cells outside the surface (see `solver.contact`).
        points: float64 [R, 3], sample points relative to the reference point (m), unrotated.
        edges: directed neighbours [sender, receiver] among the points.
    """

    dims: np.ndarray
    friction: float
    outset: float
    points: np.ndarray
    edges: tuple


def make_blade(angle_deg: float, z_middle: float) -> Body:
    """Builds the blade; its top leans back (+x) by `angle_deg`.

    The reference point is the middle of the round lower edge, half a thickness above its
    lowest point. R = 20 points lie in the plane of the front face, 4 rows x 5 columns, 0.1 m
    apart, in the middle of the face.

    Raises:
        ValueError: if the angle is outside [0, 60] degrees.
    """
    if not 0.0 <= angle_deg <= 60.0:
        raise ValueError(f'blade angle must lie in [0, 60] deg, got {angle_deg}')
    angle = math.radians(angle_deg)
    sine, cosine = math.sin(angle), math.cos(angle)
    radius = BLADE_THICKNESS / 2
    length = BLADE_HEIGHT - BLADE_THICKNESS
    points = []
    for row in range(4):
        along = length / 2 + (row - 1.5) * POINT_SPACING
        x, y = along * sine - radius * cosine, along * cosine + radius * sine
        for column in range(5):
            points.append((x, y, z_middle + (column - 2) * POINT_SPACING))
    # Three quarters of the thickness count as front: the face that pushes then always holds a
    # whole row of nodes, and no soil passes through the blade.
    dims = [sine, cosine, length, radius, BLADE_WIDTH / 2, z_middle, radius / 2]
    return Body(np.array(dims), BLADE_FRICTION, 0.5, np.array(points), ())


def make_wheel(diameter: float, z_middle: float) -> Body:
    """Builds the wheel; the reference point is its centre.

    R = 16 points: two rings of 8 at the rim, 45 degrees apart. Edges join each point
    with its two neighbours on its ring, both directions. The two small wheels are 2/3 as wide.

    Raises:
        ValueError: if the diameter is not positive.
    """
    if not diameter > 0.0:
        raise ValueError(f'wheel diameter must be positive, got {diameter} m')
    width = WHEEL_WIDTH if diameter > 0.2 else WHEEL_WIDTH * 2.0 / 3.0
    radius = diameter / 2.0
    points, edges = [], []
    for ring, side in enumerate((-1.0, 1.0)):
        for i in range(WHEEL_RING_POINTS):
            angle = 2.0 * math.pi * i / WHEEL_RING_POINTS
            points.append(
                (radius * math.cos(angle), radius * math.sin(angle), z_middle + side * width / 2)
            )
            here = ring * WHEEL_RING_POINTS
            for j in (i - 1, i + 1):
                edges.append((here + j % WHEEL_RING_POINTS, here + i))
    dims = np.array([0.0, 1.0, 0.0, radius, width / 2, z_middle, 0.0])
    return Body(dims, WHEEL_FRICTION, 1.0, np.array(points), tuple(edges))


def sample_points(body: Body, x: float, y: float, rotation: float) -> np.ndarray:
    """Returns the body's sample points [R, 3] (m) at a pose; rotation in rad about z."""
    cosine, sine = math.cos(rotation), math.sin(rotation)
    px, py = body.points[:, 0], body.points[:, 1]
    return np.stack(
        [x + cosine * px - sine * py, y + sine * px + cosine * py, body.points[:, 2]], axis=1
    )


@numba.njit(inline='always', **JIT)
def signed_distance(dims, rx, ry, z):
    """Signed distance (m, negative inside) and outward normal of the nearest face.

    Args:
        dims: the body's dims [7].
        rx, ry: position relative to the reference point (m).
        z: absolute z (m).

    Returns:
        (distance, nx, ny, nz). Inside, the distance is exact; outside, a lower bound.
    """
    sine, cosine = dims[0], dims[1]
    along = rx * sine + ry * cosine
    front = ry * sine - rx * cosine
    beyond = along - min(max(along, 0.0), dims[2])
    distance = math.sqrt(beyond * beyond + front * front) - dims[3]
    side = abs(z - dims[5]) - dims[4]
    if side > distance:
        return side, 0.0, 0.0, 1.0 if z > dims[5] else -1.0
    front += dims[6]
    norm = math.sqrt(beyond * beyond + front * front)
    if norm == 0.0:
        return distance, -cosine, sine, 0.0
    nx = (beyond * sine - front * cosine) / norm
    ny = (beyond * cosine + front * sine) / norm
    return distance, nx, ny, 0.0
