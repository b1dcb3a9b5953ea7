"""The soil of a frame: from its modes to particles, and to the height of its surface."""

import numpy as np

from pca_tools.subspace import Subspace


class Particles:
    """Soil whose nodes [..., N, D] are particles themselves; `extent` [2, 2], m, is what a height
    map spans, lowest and highest of each level axis of the bed at rest [N, D]."""

    def __init__(self, initial, up_axis: int):
        self.up_axis = up_axis
        plan = np.delete(np.asarray(initial, np.float64), up_axis, axis=1)
        self.extent = np.stack([plan.min(axis=0), plan.max(axis=0)], axis=1)

    def particles(self, modes) -> np.ndarray:
        """float32 [..., N, D], m."""
        return np.asarray(modes, np.float32)

    def height_map(self, modes, nx: int, nz: int) -> np.ndarray:
        """float32 [nx, nz] heights of the surface over the bed at rest, along the drive and across
        it, m: of the highest particle of each cell, NaN where a cell has none. Particles beyond the
        extent count in the cells of the rim. ValueError for no cells."""
        if nx < 1 or nz < 1:
            raise ValueError(f'a height map of {nx} x {nz} cells has none')
        points, (low, high) = self.particles(modes), self.extent.T
        plan = np.delete(points, self.up_axis, axis=1)
        cell = (plan - low) / (high - low) * (nx, nz)
        cell = np.clip(np.nan_to_num(cell).astype(int), 0, (nx - 1, nz - 1))
        heights = np.full(nx * nz, -np.inf, np.float32)
        np.maximum.at(heights, cell[:, 0] * nz + cell[:, 1], points[:, self.up_axis])
        return np.where(np.isinf(heights), np.float32(np.nan), heights).reshape(nx, nz)


class Decoder(Particles):
    """Decodes the scores of a subspace, in float32."""

    def __init__(self, subspace: Subspace, up_axis: int):
        super().__init__(subspace.initial, up_axis)
        self._components = np.ascontiguousarray(subspace.components, np.float32)
        self._mean = np.asarray(subspace.mean, np.float32)

    def particles(self, modes) -> np.ndarray:
        """float32 [..., N, D], m, of scores [..., r, D] (inverse PCA)."""
        return self._components @ np.asarray(modes, np.float32) + self._mean


def known(decoder: Particles | None) -> Particles:
    """A decoder; ValueError without a subspace."""
    if decoder is None:
        raise ValueError('particles need a subspace: the model has none')
    return decoder
