"""`FieldSoil`: from what a tool has swept to particles and to the height of the surface.

It stands where `live.soil.Soil` stands for models in a subspace; a `Swept` takes the place of the
modes. Nothing is computed before particles are asked for.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from learning_to_simulate.live import soil
from learning_to_simulate.methods.swept_field.tool_path import Frame


class Ground(NamedTuple):
    """A bed before its tool moved.

    Attributes:
      points: float64 [N, 3], world, m.
      places: float64 [N, 3] the same as u, height, distance from the middle plane.
      origin: float64 [3] u of the tool's first place, level of the bed, 0; m.
      size: float64 [S] of the tool, see `tools`.
    """

    points: np.ndarray
    places: np.ndarray
    origin: np.ndarray
    size: np.ndarray

    @property
    def local(self) -> np.ndarray:
        """float32 [N, 3]: `places` from the origin, as the networks take them."""
        return (self.places - self.origin).astype(np.float32)


class Swept(NamedTuple):
    """One frame of a tool on its bed: all that the soil follows from.

    Attributes:
      frame: `Frame` of [1, ...].
      pose: float64 [K] of the tool, see `tools`.
      ground: the bed.
    """

    frame: Frame
    pose: np.ndarray
    ground: Ground


class FieldSoil:
    """Computes the soil of a field.

    Args:
      field: `SweptField`.
      subspace: for those who want modes, or None.
      members: networks that answer; None: all.

    Attributes:
      field, subspace, members: as given.
      extent: float64 [2, 2], m: of the bed at rest seen from above; what a height map spans.
    """

    def __init__(self, field, subspace=None, members: int | None = None):
        self.field, self.subspace, self.members = field, subspace, members
        self.extent = soil.plan_extent(field.rest, field.axes.up)

    def particles(self, swept) -> np.ndarray:
        """float32 [N, 3], m, of a `Swept`, or [T, N, 3] of a sequence of them; none of it inside
        the tool."""
        if not isinstance(swept, Swept):
            return np.stack([self.particles(one) for one in swept])
        field, ground = self.field, swept.ground
        moved = field.displacement(swept.frame, ground.local, self.members)
        # Those that rest are as they were given, to the last bit.
        now = np.flatnonzero(moved[:, 0].any(axis=(0, 2)))
        points = ground.points.astype(np.float32)
        there = ground.places[now] + moved[:, 0, now].mean(axis=0)
        there = there + field.tool.inside(there, swept.pose, ground.size)[1]
        points[now] = ground.points[now] + field.axes.world(there - ground.places[now])
        return points

    def height_map(self, swept: Swept, nx: int, nz: int) -> np.ndarray:
        """float32 [nx, nz] heights of the surface, m; as `live.soil.Soil.height_map`."""
        return soil.surface(self.particles(swept), self.extent, self.field.axes.up, nx, nz)

    def modes(self, swept) -> np.ndarray:
        """float64 [T, r, 3] scores, m, of frames.

        Raises:
          ValueError: without a subspace.
        """
        if self.subspace is None:
            raise ValueError('modes need a subspace: the model folder has none')
        return np.stack([self.subspace.encode(self.particles(one)) for one in swept])


class SweptFrames(Sequence):
    """The frames of a rollout, in place of its modes; as an array they are those modes.

    Args:
      frames: list of `Swept`.
      of: `FieldSoil`.
    """

    def __init__(self, frames, of: FieldSoil):
        self._frames, self._soil = frames, of

    def __len__(self):
        return len(self._frames)

    def __getitem__(self, index):
        return self._frames[index]

    def __array__(self, dtype=None, copy=None):
        return np.asarray(self._soil.modes(self._frames), dtype)
