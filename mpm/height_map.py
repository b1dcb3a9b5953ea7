"""The height of the soil over the bin, from all of its particles: what raw runs record each frame.

A cell of the map is 1.5 solver cells long and one wide. Each particle brings the volume V that it
was packed with, spread over 3 x 3 map cells by quadratic B-splines w whose sum is one; what would
fall beyond a wall stays in the cell at the wall. With a the area of a map cell, the height of
cell c is the flat surface and what has come since the packing (places x0),

    h_c = surface + V / a * (sum_i w_c(x_i) - sum_i w_c(x0_i)).

So a flat bed is flat to the last bit, and the map keeps the volume exactly, told in packed soil:
loose soil stands as high as if it were packed, and soil under an overhang or in a bucket counts.
"""

import numba
import numpy as np

from mpm.columns import JIT, index
from mpm.packing import particle_volume
from mpm.scenes import CORNER, Bin

LONG = 1.5  # solver cells along the way


def shape_of(box: Bin) -> tuple[int, int]:
    """Cells of the map along the bin and across it."""
    return round(box.size[0] / (LONG * box.dx)), round(box.size[2] / box.dz)


class HeightMap:
    """Reads the heights of a bin, whose flat bed has the particles `packed` [N, 3], m."""

    def __init__(self, box: Bin, packed: np.ndarray):
        self._shape, self._surface = shape_of(box), box.surface
        self._cell = box.size[0] / self._shape[0], box.size[2] / self._shape[1]
        self._rise = particle_volume(box) / (self._cell[0] * self._cell[1])
        self._flat = self._sums(packed)

    def __call__(self, particles: np.ndarray) -> np.ndarray:
        """Heights float64 [nx, nz], m, of particles [N, 3] (or more columns)."""
        return self._surface + self._rise * (self._sums(particles) - self._flat)

    def _sums(self, particles):
        sums = np.zeros(self._shape)
        _spread(np.ascontiguousarray(particles), CORNER, *self._cell, sums)
        return sums


@numba.njit(inline='always', **JIT)
def _bounded(value, count):
    return index(min(max(value, 0), count - 1))


@numba.njit(**JIT)
def _spread(particles, corner, length, width, sums):
    """Adds the weight of each particle to the cells about it."""
    nx, nz = sums.shape
    for n in range(len(particles)):
        # From the lower corner in cells, from the middle of the nearest cell within +-0.5.
        x, z = (particles[n, 0] - corner) / length, (particles[n, 2] - corner) / width
        i, k = int(np.floor(x)), int(np.floor(z))
        a, c = x - i - 0.5, z - k - 0.5
        along = 0.5 * (0.5 - a) ** 2, 0.75 - a * a, 0.5 * (0.5 + a) ** 2
        across = 0.5 * (0.5 - c) ** 2, 0.75 - c * c, 0.5 * (0.5 + c) ** 2
        for di in range(3):
            row = _bounded(i + di - 1, nx)
            for dk in range(3):
                sums[row, _bounded(k + dk - 1, nz)] += along[di] * across[dk]
