"""The axes of a scene: along the way of travel (u), up (y), across it; and poses read from rigid
particles.

A tool moves in the plane of u and y. What a method may know of a body follows from the scene: all
motion of a prescribed one, turn and travel of a driven one.
"""

import dataclasses

import numpy as np

# Particles lower than this share of the body's height make up its lowest row (and likewise above).
_ROW_SHARE = 0.25


def up_vector(dim: int, up_axis: int) -> np.ndarray:
    """float32 [D], 1 along the axis against gravity."""
    return np.eye(dim, dtype=np.float32)[up_axis]


def speed_of(displacement):
    """RMS length [...] of the displacements [..., R, D] of the particles of a body."""
    return np.sqrt((displacement**2).sum(axis=-1).mean(axis=-1))


def without_height(values, up_axis: int, mean=np.mean):
    """Values [..., R, D] of the particles of a body less the mean of their up component, which is
    the body's height or its change."""
    return values - up_vector(values.shape[-1], up_axis) * mean(values, axis=-2, keepdims=True)


def rotation_rows(w, x, y, z) -> list[list]:
    """Rows of the rotation matrix of a unit quaternion, of numbers or of equal arrays."""
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


@dataclasses.dataclass(frozen=True)
class Axes:
    """Axes of a scene.

    Attributes:
      axis: horizontal axis of the world that the tool drives along.
      sign: +1 or -1, the way along it.
      up: axis against gravity.
    """

    axis: int
    sign: int
    up: int

    @classmethod
    def of_bodies(cls, bodies, up: int) -> 'Axes':
        """The axis and way of the longest net travel in most of the groups of bodies
        (each [S, T, R, D], m)."""
        found = []
        for body in bodies:
            centre = body.mean(axis=2)
            travel = (centre[:, -1] - centre[:, 0]).mean(axis=0)
            level = np.where(np.arange(len(travel)) == up, 0.0, travel)
            axis = int(np.argmax(np.abs(level)))
            found.append(cls(axis, 1 if travel[axis] >= 0 else -1, up))
        return max(found, key=found.count)

    @property
    def across(self) -> int:
        return 3 - self.axis - self.up

    def plane(self, points) -> np.ndarray:
        """[..., 2] u and y of points [..., D] of the world, m."""
        return np.stack([self.sign * points[..., self.axis], points[..., self.up]], axis=-1)

    def width(self, points) -> np.ndarray:
        """[S] extent across the way of points [S, R, D], m."""
        return np.ptp(points[..., self.across], axis=1)


def blade_pose(body: np.ndarray, axes: Axes) -> tuple[np.ndarray, np.ndarray]:
    """Pose of a flat blade of particles [S, T, R, D] of its face, m: [S, T, 2] u and y of the
    middle of its lowest row of particles, m, and [S, T] lean in rad: positive where the top lies
    behind. A body of one row has lean 0."""
    points = axes.plane(body)
    height = points[:, 0, :, 1]
    low, high = height.min(axis=1, keepdims=True), height.max(axis=1, keepdims=True)
    share = (height - low) / np.maximum(high - low, 1e-12)
    row, top = (
        np.einsum('strd,sr->std', points, mask / np.maximum(mask.sum(axis=1, keepdims=True), 1.0))
        for mask in ((share <= _ROW_SHARE) * 1.0, (share >= 1 - _ROW_SHARE) * 1.0)
    )
    across = top - row
    flat = (high - low <= 1e-12).reshape(-1, 1)
    return row, np.where(flat, 0.0, np.arctan2(-across[..., 0], np.where(flat, 1, across[..., 1])))


def wheel_pose(body: np.ndarray, axes: Axes):
    """Motion and size of a wheel of particles [S, T, R, D] of its rim, m: [S, T, 2] u and y of its
    centre, m; [S, T] angle in rad that it has turned since frame 0, positive where it rolls
    forward; [S] radius and [S] width, m."""
    points = axes.plane(body)
    centre = points.mean(axis=2)
    spokes = points - centre[:, :, None]
    # Phase of the first spoke against itself in frame 0, summed over all spokes: an average turn.
    start = spokes[:, :1]
    dot = (spokes * start).sum(axis=(2, 3))
    cross = (spokes[..., 1] * start[..., 0] - spokes[..., 0] * start[..., 1]).sum(axis=2)
    # Rolling towards +u turns the top forwards: clockwise with u to the right and y up.
    turned = -np.unwrap(np.arctan2(cross, dot), axis=1)
    radius = np.sqrt((spokes[:, 0] ** 2).sum(axis=-1)).mean(axis=1)
    return centre, turned, radius, axes.width(body[:, 0])
