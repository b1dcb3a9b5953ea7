"""The axes of a scene: along the way of travel (u), up (y), across it; and poses read from rigid
particles.

A tool moves in the plane of u and y. What a method may know of a body follows from the scene: all
motion of a prescribed one, turn and travel of a driven one.
"""

import dataclasses

import numpy as np

from learning_to_simulate.scene import RigidMotion

# Particles lower than this share of the body's height make up its lowest row (and likewise above).
_ROW_SHARE = 0.25


def up_vector(dim: int, up_axis: int) -> np.ndarray:
    """float32 [D], 1 along the axis against gravity."""
    return np.eye(dim, dtype=np.float32)[up_axis]


def height_of(values, up_axis: int, mean=np.mean, axis: int = -1):
    """Mean of the up component [...] of values [..., R, D] of the particles of a body; `axis` is
    that of the particles where others lie between them and the components. `mean` of numpy or
    TensorFlow."""
    return mean(values[..., up_axis], axis=axis)


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
      middle: coordinate of the bed's middle plane across the way, m.
    """

    axis: int
    sign: int
    up: int
    middle: float = 0.0

    @classmethod
    def of_bodies(cls, bodies, up: int) -> 'Axes':
        """The axis and way of the longest net travel in most of the groups of bodies
        (each [S, T, R, D], m); `middle` is 0."""
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
        """[..., 2] u and y of points [..., D] of the world, m; D is 2 or 3."""
        return np.stack([self.sign * points[..., self.axis], points[..., self.up]], axis=-1)

    def width(self, points) -> np.ndarray:
        """[S] extent across the way of points [S, R, D], m; 0 where there is no third axis."""
        flat = points.shape[-1] < 3
        return np.zeros(len(points)) if flat else np.ptp(points[..., self.across], axis=1)


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


def hidden_height(body: np.ndarray, scene, history: int) -> np.ndarray:
    """Bodies [S, T, R, D] as a method may see them: of a driven one the height is held from the
    last given frame on."""
    if scene.rigid_motion != RigidMotion.DRIVEN:
        return body
    centre = body[..., scene.up_axis].mean(axis=2)
    known = np.where(np.arange(body.shape[1]) < history, centre, centre[:, history - 1 : history])
    seen = body.copy()
    seen[..., scene.up_axis] += (known - centre)[:, :, None]
    return seen
