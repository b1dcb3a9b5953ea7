"""What holds for any soil, whatever a network says: none of it is inside the tool.

Points are u, height, distance from the middle plane (m), poses u, height, lean, as in `tool_path`.
`xp` is numpy, or `tensors` in a TensorFlow graph.
"""

import numpy as np


def blade_axis(pose, blade, xp=np):
    """[..., 2] u and height (m) of the middle of the upper edge minus that of the lower one."""
    lean = xp.asarray(pose)[..., 2]
    return blade.length * xp.stack([-xp.sin(lean), xp.cos(lean)], axis=-1)


def inside(points, pose, blade, width, xp=np) -> tuple:
    """How deep points lie in a blade, and the shortest way out.

    The blade is a stadium, all points within its radius of a segment, drawn out across the way.

    Args:
      points: [P, 3].
      pose: [3].
      blade: `tools.Blade`.
      width: of this blade, m.
      xp: numpy or `tensors`.

    Returns:
      depth [P], m, 0 outside, and way [P, 3] of that length.
    """
    points = xp.asarray(points, np.float64)
    axis = blade_axis(pose, blade, xp)
    relative = points[:, :2] - xp.asarray(pose)[:2]
    along = xp.clip(xp.dot(relative, axis) / xp.dot(axis, axis), 0.0, 1.0)
    away = relative - along[:, None] * axis
    distance = xp.hypot(away[:, 0], away[:, 1])
    # On the segment itself there is no nearest side: out to the front.
    front = xp.stack([axis[1], -axis[0]], axis=0) / blade.length
    normal = xp.where(distance[:, None] > 1e-12, away / xp.maximum(distance, 1e-12)[:, None], front)
    return _way_out(points, blade.radius - distance, normal, width, xp)


def inside_wheel(points, pose, radius, width, xp=np) -> tuple:
    """How deep points lie in a wheel, and the shortest way out; as `inside`.

    Args:
      points: [P, 3].
      pose: u and height (m) of the axle first.
      radius, width: m.
      xp: numpy or `tensors`.
    """
    points = xp.asarray(points, np.float64)
    away = points[:, :2] - xp.asarray(pose)[:2]
    distance = xp.hypot(away[:, 0], away[:, 1])[:, None]
    # On the axle there is no nearest side: down.
    down = xp.zeros_like(away) + np.array([0.0, -1.0])
    normal = xp.where(distance > 1e-12, away / xp.maximum(distance, 1e-12), down)
    return _way_out(points, radius - distance[:, 0], normal, width, xp)


def _way_out(points, in_plane, normal, width, xp):
    """Depth [P] and way [P, 3] from depths [P] and normals [P, 2] in the plane of travel."""
    across = points[:, 2]
    beside = width / 2 - xp.abs(across)
    depth = xp.maximum(xp.minimum(in_plane, beside), 0.0)
    is_plane = in_plane <= beside
    in_plane_way = xp.where(is_plane, depth, 0.0)[:, None] * normal
    one = xp.ones_like(across)
    way_across = xp.where(is_plane, 0.0, depth) * xp.where(across < 0, -one, one)
    return depth, xp.concatenate([in_plane_way, way_across[:, None]], axis=1)


def pushed_out(points, pose, blade, width) -> np.ndarray:
    """Points [P, 3] with those inside the blade moved to its nearest face; the others as they
    are."""
    return np.asarray(points) + inside(points, pose, blade, width)[1]


def heap_volume(points, surface, particle_volume: float) -> float:
    """Volume (m3) of soil over the untouched surface.

    Args:
      points: [P, 3].
      surface: [P], height (m) of the untouched surface where each point now is.
      particle_volume: that each point stands for, m3.
    """
    return float(particle_volume * np.count_nonzero(points[:, 1] > surface))


def cut_volume(area, width) -> float:
    """Volume (m3) of a cut of an area (m2, between untouched surface and deepest cut) and a
    width."""
    return float(area * width)
