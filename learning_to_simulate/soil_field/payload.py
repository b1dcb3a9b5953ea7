"""Soil that a bucket holds: how much room its shape and its lean leave.

In the plane of travel soil lies in the shell below two lines at the angle of repose: one that rises
backwards from the edge, one that rises forwards from the upper rim. Along the floor it slides out
where that is steeper than its friction, (29) of docs/soil_field.md. Lengths are of the field.
"""

import functools
import math
from typing import NamedTuple

import numpy as np

# The shell of `mpm.motions.operator_paths.bucket`: thickness, m; arc of the back, rad.
SHELL, ARC = 0.024, math.radians(165.0)
# How steeply the floor may rise behind the edge where all soil stays on it, and over which slopes
# beyond that it slides out, rad (a friction of 0.3 between tool and soil holds it up to 17 deg).
SLIPS, SLIPS_OUT = math.radians(17.0), math.radians(8.0)
# Share of the soil over the floor that stays there as the bucket leaves the ground, where the floor
# falls by less than an angle behind the edge, and by more than another (rad): fitted to 39 training
# and validation runs of kind `scoop`.
TAKEN, CURLED = (0.53, 0.95), (math.radians(-24.0), math.radians(9.0))
# Where that soil is looked for, in reaches behind the edge, and across in half widths.
TAKEN_ALONG = (np.arange(6) + 0.5) / 6
TAKEN_ACROSS = (-0.8, -0.4, 0.0, 0.4, 0.8)
# What is dumped falls so far ahead of the edge, and spreads by so much to both sides of that, m.
FALLS_AHEAD, FALLS_APART = 0.03, 0.04
# Share by which the height of each particle in a picture differs from that of the last.
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


class Shape(NamedTuple):
    """Of a bucket, in lengths of the field: height of its outline over the edge; rise (rad) and
    length of its underside right behind the edge, while it does not lean."""

    height: float
    rise: float
    floor: float

    @property
    def slope(self) -> float:
        """Rise of its floor inside, rad: its shell is sharp at the edge only."""
        return self.rise + math.atan2(SHELL, self._inner)

    @property
    def _inner(self):
        return math.sqrt(max(self.floor**2 - SHELL**2, 0.0))

    @property
    def inside(self) -> np.ndarray:
        """float64 [10, 2]: places u (along the way) and y of the edge, the back up to the upper
        rim, and a point far out of the mouth, m of the field; not to be written into."""
        return _inside(self.height, self.slope, self._inner)

    @property
    def reach(self) -> float:
        """How far it reaches behind its edge, m."""
        return -float(self.inside[:, 0].min())


@functools.lru_cache  # every frame asks for it
def _inside(height, slope, floor):
    sine, cosine = math.sin(slope), math.cos(slope)
    # From the height: that of the floor's end, the radius across it, and half a circle.
    radius = max(height - SHELL - floor * sine, 0.0) / (1.0 + cosine)
    turn = slope - math.pi / 2 + np.linspace(0.0, ARC, 8)
    along = floor * cosine + radius * (np.cos(turn) - sine)
    up = floor * sine + radius * (np.sin(turn) + cosine)
    u, y = -along[-1], up[-1]
    far = u / 2 + y, y / 2 - u
    return np.stack([[0.0, *-along, far[0]], [0.0, *up, far[1]]], axis=1)


class Room(NamedTuple):
    """For how much soil a bucket has room, m2; how far ahead of its edge the middle of that is, m;
    1 where the floor holds soil, 0 where all slides out."""

    area: float = 0.0
    middle: float = 0.0
    holds: float = 0.0


def room(shape: Shape, lean: float, friction: float) -> Room:
    """The room in a bucket at a lean (rad), for soil of a friction (tangent of the angle of
    repose)."""
    points = _turned(shape, lean)
    edge, rim = points[0], points[-2]
    way = 1.0 if rim[0] > edge[0] else -1.0  # from the edge to the rim
    below = _cut(points, edge, -way * friction)
    below = _cut(below, rim, way * friction)
    # The lines through the origin and each side bound triangles, whose sum is the area.
    u, y = below.T
    v, z = np.roll(below, -1, axis=0).T
    twice = u * z - v * y
    area = abs(float(twice.sum())) / 2.0
    middle = float((twice * (u + v)).sum() / twice.sum()) / 3.0 if area > 0 else 0.0
    holds = min(max((SLIPS - (shape.slope - lean)) / SLIPS_OUT + 1.0, 0.0), 1.0)
    return Room(holds * area, middle, holds)


def places(shape: Shape, lean: float, friction: float, area: float, count: int) -> np.ndarray:
    """So many places [count, 2] u and y from the edge, evenly in soil of an area (m2) on the floor
    of a bucket, for pictures; other arguments as of `room`."""
    corners = _turned(shape, lean)[:-1]
    back = int(np.argmin(corners[:, 0]))
    u = np.linspace(corners[back, 0], 0.0, 65)
    bottom = np.interp(u, corners[back::-1, 0], corners[back::-1, 1])
    top = np.minimum(-friction * u, np.interp(u, corners[back:, 0], corners[back:, 1]))
    depth = np.maximum(top - bottom, 1e-9)
    filled = np.append(0.0, np.cumsum((depth[1:] + depth[:-1]) / 2.0 * np.diff(u)))
    index = np.arange(count)
    at = np.interp((index + 0.5) / max(count, 1) * filled[-1], filled, u)
    high = GOLDEN * index % 1.0 * min(area / filled[-1], 1.0)
    return np.stack([at, np.interp(at, u, bottom) + high * np.interp(at, u, depth)], axis=1)


def kept(shape: Shape, lean: float) -> float:
    """Share of the soil over its floor that a bucket keeps where it leaves the ground at a lean."""
    return float(np.interp(lean - shape.slope, CURLED, TAKEN))


def _turned(shape, lean):
    sine, cosine = math.sin(lean), math.cos(lean)
    return shape.inside @ np.array([[cosine, sine], [-sine, cosine]])


def _cut(points, through, fall):
    """The part of a polygon [K, 2] below the line through a point that falls by `fall` per way."""
    over = points[:, 1] - through[1] + fall * (points[:, 0] - through[0])
    kept = []
    for a, b, p, q in zip(over, np.roll(over, -1), points, np.roll(points, -1, axis=0)):
        if a <= 0:
            kept.append(p)
        if (a <= 0) != (b <= 0):
            kept.append(p + a / (a - b) * (q - p))
    return np.array(kept).reshape(-1, 2)
