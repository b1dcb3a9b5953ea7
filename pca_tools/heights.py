"""The map of heights of the soil beside the records: `heights_<split>.npz`.

Raw runs may hold `heights` [T, nx, nz]: the coordinate of the soil's surface along the upward axis,
over a grid of the two horizontal axes, metres (`mpm/height_map.py` says how our solver reads it).
A dataset keeps every fourth frame, to within 0.05 mm: 2 to 47 kB a run of the solver's bins.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from pca_tools.compression import PackedRuns

# Lower corner of the bins of our solver on each axis, m (`mpm.scenes`).
_SOLVER_CORNER = 0.1


class Grid(NamedTuple):
    """Where a map of heights lies, on the two horizontal axes in their order."""

    shape: tuple[int, int]  # cells nx, nz
    corner: tuple[float, float]  # x, z of the lower corner of cell [0, 0], m
    cell: tuple[float, float]  # sides of a cell, m

    def __str__(self) -> str:
        (nx, nz), (x, z), cell = self
        length, width = (1e3 * side for side in cell)
        return f'{nx} x {nz} cells of {length:.4g} x {width:.4g} mm from ({x:g}, {z:g}) m'


def grid_of(parameters: Mapping[str, Any], heights: np.ndarray | None) -> Grid | None:
    """Returns where the map of a run (`heights` [T, nx, nz], m) lies, None for a run without one.

    Its parameters say `heights_corner_m` and `heights_cell_m`, two numbers each; or `bin_m`, as our
    solver writes: its map covers the whole bin. Else: ValueError.
    """
    if heights is None:
        return None
    nx, nz = heights.shape[1:]
    try:
        corner, cell = (parameters.get(f'heights_{name}_m') for name in ('corner', 'cell'))
        if corner is None and cell is None:
            length, _, width = parameters['bin_m']
            corner, cell = (_SOLVER_CORNER, _SOLVER_CORNER), (length / nx, width / nz)
        (x, z), (dx, dz) = (map(float, pair) for pair in (corner, cell))
        if not (np.isfinite([x, z, dx, dz]).all() and dx > 0 and dz > 0):
            raise ValueError(f'corner {corner}, cell {cell}')
    except (KeyError, TypeError, ValueError, OverflowError, ZeroDivisionError) as error:
        needed = 'heights_corner_m [x, z], its lower corner, and heights_cell_m [dx, dz], in metres'
        text = f'parameters do not say where the height map lies: {needed}'
        raise ValueError(text) from error
    return Grid((nx, nz), (x, z), (dx, dz))


def reach(heights: np.ndarray | None, grid: Grid | None) -> float:
    """Returns the largest coordinate of a map, m; 0 without one."""
    if heights is None or grid is None:
        return 0.0
    far = np.add(grid.corner, np.multiply(grid.shape, grid.cell))
    return float(max(np.abs(heights).max(), np.abs([grid.corner, far]).max()))


class Heights(PackedRuns):
    """The maps of a split, unpacked one run at a time: `maps[i]` is float64 [F, nx, nz], m, in
    frame `f * frame_stride` of record i. Steps count from 0, not from a first map, so they do
    not depend on another run."""

    NAME, TITLE, KINDS = 'heights', 'height map', {'corner': ('f', 1), 'cell': ('f', 1)}
    RESOLUTION = 1e-4

    corner: np.ndarray  # float64 [2], x and z of the lower corner of cell [0, 0], m
    cell: np.ndarray  # float64 [2], sides of a cell, m

    @property
    def grid(self) -> Grid:
        """The same and the number of cells, to compare maps by."""
        (nx, nz), (x, z), (dx, dz) = self.rest.shape, self.corner.tolist(), self.cell.tolist()
        return Grid((nx, nz), (x, z), (dx, dz))

    def __str__(self) -> str:
        return str(self.grid)

    def _fits(self) -> bool:
        return (
            self.rest.size > 0
            and self.corner.shape == self.cell.shape == (2,)
            and bool(np.isfinite(self.corner).all() and np.isfinite(self.cell).all())
            and bool((self.cell > 0).all())
        )


read = Heights.read
