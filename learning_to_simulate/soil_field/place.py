"""Where a tool works on a terrain: its vertical plane of travel, and the world seen from there.

The world has y up, x and z on the ground, in metres. A tool that stands upright with the identity
as its quaternion looks along -x. Its place has three axes, right-handed: along the way (where the
tool looks, level), up, across. A turn or shift of the whole scene changes the place and nothing
that is seen from it.
"""

from typing import NamedTuple

import numpy as np

from learning_to_simulate.live.poses import rotation_matrix

UP = np.array([0.0, 1.0, 0.0])
# Along, up and across of a tool with the identity as its quaternion.
UPRIGHT = np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])


class Place(NamedTuple):
    """The frame of a passage.

    Attributes:
      origin: [3] of the world, m: where u and the distance across are 0; its height is 0.
      along, across: [3] unit vectors, level.
      grade: rise of the ground per way. What is seen `laid` has that ground level.
      height: of that ground over the origin, m.
    """

    origin: np.ndarray
    along: np.ndarray
    across: np.ndarray
    grade: float = 0.0
    height: float = 0.0

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

    def relaid(self, height: float, slope: float) -> 'Place':
        """The same on another ground, a line height + slope * u (m) as it is seen `laid`."""
        c, s, over = self.cosine, self.grade * self.cosine, height - self.height
        grade = (self.grade + slope) / (1.0 - self.grade * slope)
        return self._replace(grade=grade, height=self.height + c * over + grade * s * over)

    @property
    def cosine(self) -> float:
        """Of the angle of the graded ground."""
        return 1.0 / float(np.hypot(1.0, self.grade))

    def laid(self, local) -> np.ndarray:
        """Points [..., 3] of `local`, along the graded ground, square to it and across."""
        u, y, across = np.moveaxis(local, -1, 0)
        over, c, s = y - self.height, self.cosine, self.grade * self.cosine
        return np.stack([c * u + s * over, self.height - s * u + c * over, across], axis=-1)

    def unlaid(self, vectors) -> np.ndarray:
        """Vectors [..., 3] along the graded ground, square to it and across, in axes of the
        world."""
        on, off, across = np.moveaxis(np.asarray(vectors, np.float64), -1, 0)
        c, s = self.cosine, self.grade * self.cosine
        return self.vectors(np.stack([c * on - s * off, s * on + c * off, across], axis=-1))

    def turns(self, pose) -> np.ndarray:
        """Lean, yaw and roll [..., 3] (rad) of poses [..., 7].

        With the rotation L of the tool seen from here: lean is where L takes the axis up,
        atan2(-(L up)_along, (L up)_up), positive where the top lies behind; yaw is where it takes
        the axis across, atan2((L across)_along, (L across)_across), roll the rise of that.
        """
        local = self.axes @ rotation_matrix(pose[..., 3:]) @ UPRIGHT.T
        up, across = local[..., 1], local[..., 2]
        lean = np.arctan2(-up[..., 0], up[..., 1])
        yaw = np.arctan2(across[..., 0], across[..., 2])
        roll = np.arctan2(across[..., 1], np.hypot(across[..., 0], across[..., 2]))
        return np.stack([lean, yaw, roll], axis=-1)


def place_of(pose) -> Place:
    """The place of a tool at a pose [7] that goes where it looks; ValueError for a pose that is not
    finite, or a tool on its side, so that it looks nowhere."""
    pose = checked_pose(pose)
    across = rotation_matrix(pose[3:]) @ UPRIGHT[2] * np.array([1.0, 0.0, 1.0])
    length = np.linalg.norm(across)
    if length < 1e-3:
        raise ValueError(f'the tool lies on its side (quaternion {pose[3:]}): it looks nowhere')
    across = across / length
    return Place(pose[:3] * np.array([1.0, 0.0, 1.0]), np.cross(UP, across), across)


def checked_pose(pose) -> np.ndarray:
    """A pose [7] as float64; ValueError for another shape, values that are not finite, or a
    quaternion that is not of length 1 (to 1e-3)."""
    try:
        found = np.asarray(pose, np.float64)
    except (TypeError, ValueError):
        found = np.zeros(0)
    if found.shape != (7,) or not np.isfinite(found).all():
        raise ValueError(f'pose is {pose}, place in m and unit quaternion [7] were expected')
    pose = found
    if abs(np.linalg.norm(pose[3:]) - 1.0) > 1e-3:
        raise ValueError(f'quaternion {pose[3:]} (w, x, y, z) must have length 1')
    return pose
