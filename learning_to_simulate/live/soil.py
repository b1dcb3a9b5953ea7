"""The soil of a frame: its particles, the height of its surface, its modes.

A method says how its particles are made, when they are asked for (`ModesSoil` here, `SweptSoil` of
a swept field); the rest is shared.
"""

import abc

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


def plan_extent(points, up: int) -> np.ndarray:
    """float64 [2, 2], m: lowest and highest of each axis of a bed [N, D] seen from above."""
    plan = np.delete(np.asarray(points, np.float64), up, axis=1)
    return np.stack([plan.min(axis=0), plan.max(axis=0)], axis=1)


class Soil(abc.ABC):
    """The soil of one frame.

    Attributes:
      subspace: of its modes, or None.
      up_axis: axis against gravity.
      extent: float64 [2, 2], m: what a height map spans, the bed at rest; see `plan_extent`.
    """

    subspace: Subspace | None
    up_axis: int
    extent: np.ndarray

    @abc.abstractmethod
    def particles(self) -> np.ndarray:
        """float32 [N, D], m; ValueError of a model in a subspace that has none."""

    @property
    def modes(self) -> np.ndarray:
        """float64 [r, D] scores, m; of a method without modes those of its particles, which needs a
        subspace (ValueError)."""
        if self.subspace is None:
            raise ValueError('modes need a subspace: the model folder has none')
        return self.subspace.encode(self.particles())

    def height_map(self, nx: int, nz: int) -> np.ndarray:
        """float32 [nx, nz] heights of the surface over the bed at rest, along the drive and across
        it, m: see `surface`."""
        return surface(self.particles(), self.extent, self.up_axis, nx, nz)


class Decoder:
    """Decodes the scores of one subspace, in float32.

    Attributes:
      subspace, up_axis, extent: as of `Soil`.
    """

    def __init__(self, subspace: Subspace, up_axis: int):
        self.subspace, self.up_axis = subspace, up_axis
        self._components = np.ascontiguousarray(subspace.components, np.float32)
        self._mean = np.asarray(subspace.mean, np.float32)
        self.extent = plan_extent(subspace.initial, up_axis)

    def particles(self, modes) -> np.ndarray:
        """float32 [..., N, D], m, of scores [..., r, D] (inverse PCA)."""
        return self._components @ np.asarray(modes, np.float32) + self._mean


class ModesSoil(Soil):
    """The soil of a frame of a model in a subspace: scores float64 [r, D], m, and the `Decoder`
    that turns them into particles; None without a subspace."""

    def __init__(self, modes, decoder: Decoder | None):
        self._modes, self._decoder = modes, decoder
        self.subspace = None
        if decoder is not None:
            self.subspace, self.up_axis = decoder.subspace, decoder.up_axis
            self.extent = decoder.extent

    @property
    def modes(self) -> np.ndarray:
        """Its own, as given."""
        return self._modes

    def particles(self) -> np.ndarray:
        """See `Soil`."""
        if self._decoder is None:
            raise ValueError('particles need a subspace: the model has none')
        return self._decoder.particles(self._modes)
