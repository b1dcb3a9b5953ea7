"""Where a tool works on a terrain: its vertical plane of travel, and the world seen from there.

The world has y up, x and z on the ground, in metres. A tool that stands upright with the identity
as its quaternion looks along -x. Its place has three axes, right-handed: along the way (where the
tool looks, level), up, across. A turn or shift of the whole scene changes the place and nothing
that is seen from it.
"""

import math
from typing import NamedTuple

import numpy as np

UP = np.array([0.0, 1.0, 0.0])
# Along, up and across of a tool with the identity as its quaternion.
UPRIGHT = np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])


class Place(NamedTuple):
    """The frame of a passage.

    Attributes:
      origin: [3] of the world, m: where u and the distance across are 0; its height is 0.
      along, across: [3] unit vectors, level.
    """

    origin: np.ndarray
    along: np.ndarray
    across: np.ndarray

    @property
    def axes(self) -> np.ndarray:
        """[3, 3] rows along, up, across."""
        return np.stack([self.along, UP, self.across])

    def local(self, points) -> np.ndarray:
        """u, y and distance across [..., 3] of points [..., 3] of the world, m."""
        return (np.asarray(points, np.float64) - self.origin) @ self.axes.T

    def world(self, points) -> np.ndarray:
        """The inverse of `local`."""
        return self.vectors(points) + self.origin

    def vectors(self, vectors) -> np.ndarray:
        """Vectors [..., 3] along, up, across in axes of the world."""
        return np.asarray(vectors, np.float64) @ self.axes

    def turns(self, pose) -> np.ndarray:
        """Lean, yaw and roll [..., 3] (rad) of poses [..., 7].

        With the rotation L of the tool seen from here: lean is where L takes the axis up,
        atan2(-(L up)_along, (L up)_up), positive where the top lies behind; yaw is where it takes
        the axis across, atan2((L across)_along, (L across)_across), roll the rise of that.
        """
        local = self.axes @ rotation(pose) @ UPRIGHT.T
        up, across = local[..., 1], local[..., 2]
        lean = np.arctan2(-up[..., 0], up[..., 1])
        yaw = np.arctan2(across[..., 0], across[..., 2])
        roll = np.arctan2(across[..., 1], np.hypot(across[..., 0], across[..., 2]))
        return np.stack([lean, yaw, roll], axis=-1)


def place_of(pose) -> Place:
    """The place of a tool at a pose [7] that goes where it looks; ValueError for a pose that is not
    finite, or a tool on its side, so that it looks nowhere."""
    pose = checked_pose(pose)
    across = rotation(pose) @ UPRIGHT[2] * np.array([1.0, 0.0, 1.0])
    length = np.linalg.norm(across)
    if length < 1e-3:
        raise ValueError(f'the tool lies on its side (quaternion {pose[3:]}): it looks nowhere')
    across = across / length
    return Place(pose[:3] * np.array([1.0, 0.0, 1.0]), np.cross(UP, across), across)


def checked_pose(pose) -> np.ndarray:
    """A pose [7] as float64; ValueError for another shape, values that are not finite, or a
    quaternion that is not of length 1 (to 1e-3)."""
    pose = np.asarray(pose, np.float64)
    if pose.shape != (7,) or not np.isfinite(pose).all():
        raise ValueError(f'pose is {pose}, place in m and unit quaternion [7] were expected')
    if abs(np.linalg.norm(pose[3:]) - 1.0) > 1e-3:
        raise ValueError(f'quaternion {pose[3:]} (w, x, y, z) must have length 1')
    return pose


def rotation(pose) -> np.ndarray:
    """Matrices [..., 3, 3] of the unit quaternions (w, x, y, z) of poses [..., 7]."""
    w, x, y, z = np.moveaxis(np.asarray(pose, np.float64)[..., 3:], -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def turned(quaternion, rotation) -> np.ndarray:
    """A quaternion [4] (w, x, y, z) after a further rotation by a vector [3], rad."""
    x, y, z = (float(value) for value in rotation)  # numbers: arrays take five times as long
    angle = math.sqrt(x * x + y * y + z * z)
    share = math.sin(angle / 2) / max(angle, 1e-300)
    w, x, y, z = math.cos(angle / 2), share * x, share * y, share * z
    a, b, c, d = (float(value) for value in quaternion)
    return np.array([
        w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c,
        w * c + y * a + z * b - x * d, w * d + z * a + x * c - y * b,
    ])  # fmt: skip
