"""Where a tool works on a terrain: its vertical plane of travel, the world seen from there, and the
strips of terrain under it and beside it.

The world has y up, x and z on the ground, in metres. A tool that stands upright with the identity
as its quaternion looks along -x. Its place has three axes, right-handed: along the way (where the
tool looks, level), up, across. The height of a strip is the mean over its width. Where all strips
are equal, one as wide as the tool does.
"""

from typing import NamedTuple

import numpy as np

from learning_to_simulate.live.poses import UNIT_TOLERANCE, numbers, rotation_matrix
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Tool

UP = np.array([0.0, 1.0, 0.0])
# Along, up and across of a tool with the identity as its quaternion.
UPRIGHT = np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])
N_BESIDE, BESIDE_WIDTH = 3, 0.1  # strips on either side, m of the field
BESIDE = N_BESIDE * BESIDE_WIDTH  # soil farther beside the tool has not moved, m of the field
ACROSS = np.array([-0.4, -0.2, 0.0, 0.2, 0.4])  # where a strip is read, in its widths


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
        """Lean, yaw and roll [..., 3] (rad) of poses [..., 7]: lean is where the tool's turn takes
        the axis up, positive where the top lies behind; yaw is where it takes the axis across, roll
        the rise of that."""
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
    """A copy of a pose [7] as float64; ValueError for another shape, values that are not finite, or
    a quaternion that is not of length 1."""
    pose = numbers('pose (place in m, unit quaternion)', pose, (7,))
    if abs(np.linalg.norm(pose[3:]) - 1.0) > UNIT_TOLERANCE:
        raise ValueError(f'quaternion {pose[3:]} (w, x, y, z) must have length 1')
    return pose


class Strips(NamedTuple):
    """Strips of a tool, in lengths of the field.

    Attributes:
      centres: [J] distance across, ascending.
      widths: [J].
      under: slice of those under the tool.
    """

    centres: np.ndarray
    widths: np.ndarray
    under: slice

    def shares(self, across) -> tuple[np.ndarray, np.ndarray]:
        """The strip below places across [...] (m of the field) and the share of the next one."""
        last = len(self.centres) - 1
        if not last:
            return np.zeros(np.shape(across), np.int64), np.zeros(np.shape(across))
        low = np.clip(np.searchsorted(self.centres, across, side='right') - 1, 0, last - 1)
        gap = self.centres[low + 1] - self.centres[low]
        return low, np.clip((across - self.centres[low]) / gap, 0.0, 1.0)

    def heights(self, terrain: Terrain, place: Place, scale: float, u) -> np.ndarray:
        """Heights [J, k] at places u [k] along the way, on its graded ground, all in m of the
        field, from a terrain in m of the world."""
        across = self.centres[:, None] + self.widths[:, None] * ACROSS
        along, over = scale * place.cosine * np.asarray(u)[:, None], scale * across[:, None, :]
        x, z = (place.origin[i] + place.along[i] * along + place.across[i] * over for i in (0, 2))
        return terrain.at(x, z).mean(axis=-1) / scale


def strips_of(tool: Tool, even: bool = False) -> Strips:
    """The strips of a tool; one on even terrain, and for a tool that knows no neighbours."""
    width, count = tool.width / tool.scale, tool.columns
    if even or count == 1:
        return Strips(np.zeros(1), np.array([width]), slice(0, 1))
    under = (np.arange(count) - (count - 1) / 2) * width / count
    beside = width / 2 + BESIDE_WIDTH * (np.arange(N_BESIDE) + 0.5)
    widths = np.repeat([BESIDE_WIDTH, width / count, BESIDE_WIDTH], [N_BESIDE, count, N_BESIDE])
    centres = np.concatenate([-beside[::-1], under, beside])
    return Strips(centres, widths, slice(N_BESIDE, N_BESIDE + count))
