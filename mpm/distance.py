"""Signed distance from the surface of a body (`bodies`), for the kernels of the solver.

Source of the distance from a polygon: inside or outside by counting crossings of a ray (Haines
1994, Graphics Gems IV, 24), the distance from its edges.
"""

import math

import numba
import numpy as np

from mpm.bodies import Body
from mpm.columns import JIT


@numba.njit(**JIT)
def _from_segment(ax, ay, bx, by, px, py):
    """Way from the nearest point of the segment a b to p, and its square."""
    ex, ey = bx - ax, by - ay
    wx, wy = px - ax, py - ay
    square = ex * ex + ey * ey
    share = min(max((wx * ex + wy * ey) / square, 0.0), 1.0) if square > 0.0 else 0.0
    wx, wy = wx - share * ex, wy - share * ey
    return wx, wy, wx * wx + wy * wy


@numba.njit(**JIT)
def _from_outline(outline, px, py):
    """Signed distance from a solid polygon (a segment, a point), and the outward normal."""
    count = len(outline)
    best, wx, wy, edge = np.inf, 0.0, 0.0, 0
    is_inside = False
    for i in range(count if count > 2 else max(count - 1, 1)):
        k = i + 1 if i + 1 < count else 0
        ax, ay, bx, by = outline[i, 0], outline[i, 1], outline[k, 0], outline[k, 1]
        ux, uy, square = _from_segment(ax, ay, bx, by, px, py)
        if square < best:
            best, wx, wy, edge = square, ux, uy, i
        if count > 2 and (ay > py) != (by > py) and px < (bx - ax) * (py - ay) / (by - ay) + ax:
            is_inside = not is_inside
    distance = math.sqrt(best)
    if distance > 0.0:
        scale = -1.0 / distance if is_inside else 1.0 / distance
        return (-distance if is_inside else distance), wx * scale, wy * scale
    # On the line itself: the normal of the edge; of a point, up.
    k = edge + 1 if edge + 1 < count else 0
    ex, ey = outline[k, 0] - outline[edge, 0], outline[k, 1] - outline[edge, 1]
    norm = math.sqrt(ex * ex + ey * ey)
    if norm == 0.0:
        return 0.0, 0.0, 1.0
    return 0.0, ey / norm, -ex / norm


@numba.njit(**JIT)
def _from_bars(body, px, py):
    """Signed distance from the nearest grouser of a wheel, and the outward normal."""
    pitch = 2.0 * math.pi / body.grousers
    angle = math.floor(math.atan2(py, px) / pitch + 0.5) * pitch
    cosine, sine = math.cos(angle), math.sin(angle)
    ux, uy = px * cosine + py * sine, py * cosine - px * sine
    # A bar reaches from the axle to its round end.
    end = body.radius + body.grouser_height - body.grouser_radius
    wx, wy, square = _from_segment(0.0, 0.0, end, 0.0, ux, uy)
    norm = math.sqrt(square)
    if norm > 0.0:
        wx, wy = wx / norm, wy / norm
    else:
        wy = 1.0
    return norm - body.grouser_radius, wx * cosine - wy * sine, wx * sine + wy * cosine


@numba.njit(**JIT)
def _across(plane, nx, ny, side, sign):
    """Signed distance from a prism: `plane` from its outline, `side` beyond its end; its normal."""
    if plane > 0.0 and side > 0.0:
        distance = math.sqrt(plane * plane + side * side)
        return distance, nx * plane / distance, ny * plane / distance, sign * side / distance
    if side > plane:
        return side, 0.0, 0.0, sign
    return plane, nx, ny, 0.0


@numba.njit(**JIT)
def signed_distance(body, sine, cosine, rx, ry, rz):
    """Signed distance (m, negative inside) from a body's surface, and the outward normal there:
    (distance, nx, ny, nz).

    Exact outside, and inside of one part; where two parts overlap (rim and grouser, shell and side
    plate) the depth inside is that of the deeper one, a lower bound. `sine` and `cosine` are of the
    body's angle; rx, ry, rz (m) count from the reference point, along the axes of the world.
    """
    if body.half_width == 0.0:
        norm = math.sqrt(rx * rx + ry * ry + rz * rz)
        if norm > 0.0:
            return norm - body.radius, rx / norm, ry / norm, rz / norm
        return -body.radius, 0.0, 1.0, 0.0
    px, py = rx * cosine + ry * sine, ry * cosine - rx * sine
    plane, nx, ny = _from_outline(body.outline, px, py)
    plane -= body.radius
    if body.grousers > 0:
        bar, bx, by = _from_bars(body, px, py)
        if bar < plane:
            plane, nx, ny = bar, bx, by
    sign = 1.0 if rz > 0.0 else -1.0
    distance, nx, ny, nz = _across(plane, nx, ny, abs(rz) - body.half_width, sign)
    if len(body.plates) > 0:
        plane, mx, my = _from_outline(body.plates, px, py)
        middle = body.half_width - 0.5 * body.plate_thickness
        outwards = sign if abs(rz) > middle else -sign
        side = abs(abs(rz) - middle) - 0.5 * body.plate_thickness
        other, mx, my, mz = _across(plane, mx, my, side, outwards)
        if other < distance:
            distance, nx, ny, nz = other, mx, my, mz
    return distance, nx * cosine - ny * sine, nx * sine + ny * cosine, nz


@numba.njit(**JIT)
def _distances(body, pose, positions):
    sine, cosine = math.sin(pose[2]), math.cos(pose[2])
    result = np.empty(len(positions))
    for n in range(len(positions)):
        rx, ry = positions[n, 0] - pose[0], positions[n, 1] - pose[1]
        result[n] = signed_distance(body, sine, cosine, rx, ry, positions[n, 2] - pose[3])[0]
    return result


def signed_distances(body: Body, pose, positions: np.ndarray) -> np.ndarray:
    """Returns the signed distance [N] (m, negative inside) of points [N, 3] (m) from a body's
    surface; the pose is x, y (m) of its reference point, its angle (rad), z (m)."""
    return _distances(
        body, np.array(pose, dtype=np.float64), np.ascontiguousarray(positions, np.float64)
    )
