"""The background grid of a bin."""

from typing import NamedTuple

import numpy as np

from mpm.scenes import CORNER, Bin

PAD = 3  # nodes outside the bin on the low side


class Grid(NamedTuple):
    """The background grid of a bin. A NamedTuple, so that kernels can take it.

    Attributes:
        shape: nodes per axis.
        origin: position of node (0, 0, 0), m.
        dx: cell size, m.
        walls: node indices (x low, x high, floor, z low, z high) of the sticky walls, and 1 if
            the walls across z are smooth instead.
    """

    shape: tuple
    origin: tuple
    dx: float
    walls: tuple

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return self.shape[0] * self.shape[1] * self.shape[2]


def make_grid(box: Bin) -> Grid:
    """Returns the grid of a bin; its walls and floor lie on planes of nodes.

    Raises:
        ValueError: if length or width are not a whole number of cells.
    """
    width = box.size[2] + 2 * box.wall_gap
    cells = [box.size[0] / box.dx, box.height / box.dx, width / box.dx]
    for name, count in (('length', cells[0]), ('width', cells[2])):
        if abs(count - round(count)) > 1e-6:
            raise ValueError(f'the {name} of the bin must be whole cells, got {count:.6g}')
    nx, ny, nz = round(cells[0]), int(np.ceil(cells[1])), round(cells[2])
    return Grid(
        shape=(nx + 2 * PAD + 1, ny + 2 * PAD + 1, nz + 2 * PAD + 1),
        origin=(*(CORNER - PAD * box.dx,) * 2, CORNER - box.wall_gap - PAD * box.dx),
        dx=box.dx,
        walls=(PAD, PAD + nx, PAD, PAD, PAD + nz, 0),
    )
