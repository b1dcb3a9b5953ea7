"""`Soil`: from mode scores to particles and to the height of the surface."""

import numpy as np

from pca_tools.subspace import Subspace


def surface(points, extent, up_axis: int, nx: int, nz: int) -> np.ndarray:
    """Heights of particles on a grid.

    Args:
      points: [N, 3], m.
      extent: [2, 2], m, lowest and highest of the two level axes; particles beyond it count in the
        cells of the rim.
      up_axis: axis against gravity.
      nx, nz: cells along the two axes.

    Returns:
      float32 [nx, nz], m, of the highest particle of each cell; NaN where a cell has none.

    Raises:
      ValueError: no cells.
    """
    if nx < 1 or nz < 1:
        raise ValueError(f'a height map of {nx} x {nz} cells has none')
    low, high = np.transpose(extent)
    plan = np.delete(points, up_axis, axis=1)
    cell = (plan - low) / (high - low) * (nx, nz)
    cell = np.clip(np.nan_to_num(cell).astype(int), 0, (nx - 1, nz - 1))
    heights = np.full(nx * nz, -np.inf, np.float32)
    np.maximum.at(heights, cell[:, 0] * nz + cell[:, 1], points[:, up_axis])
    return np.where(np.isinf(heights), np.float32(np.nan), heights).reshape(nx, nz)


class Soil:
    """Decodes frames of one subspace, in float32.

    Args:
      subspace: of the model.
      up_axis: axis against gravity.

    Attributes:
      subspace: as given.
      extent: float64 [2, 2], m: of the bed at rest, see `plan_extent`; what a height map spans.
    """

    def __init__(self, subspace: Subspace, up_axis: int):
        self.subspace = subspace
        self._components = np.ascontiguousarray(subspace.components, np.float32)
        self._mean = np.asarray(subspace.mean, np.float32)
        self._up = up_axis
        self.extent = plan_extent(subspace.initial, up_axis)

    def particles(self, modes) -> np.ndarray:
        """float32 [..., N, D], m, of scores [..., r, D] (inverse PCA)."""
        return self._components @ np.asarray(modes, np.float32) + self._mean

    def height_map(self, modes, nx: int, nz: int) -> np.ndarray:
        """Heights of the surface on a grid.

        Args:
          modes: [r, D] scores, m.
          nx, nz: cells along the drive and across it, over `extent`; particles beyond it count in
            the cells of the rim.

        Returns:
          float32 [nx, nz], m, of the highest particle of each cell; NaN where a cell has none.

        Raises:
          ValueError: no cells.
        """
        return surface(self.particles(modes), self.extent, self._up, nx, nz)


def plan_extent(points, up: int) -> np.ndarray:
    """float64 [2, 2], m: lowest and highest of each axis of a bed [N, D] seen from above."""
    plan = np.delete(np.asarray(points, np.float64), up, axis=1)
    return np.stack([plan.min(axis=0), plan.max(axis=0)], axis=1)
