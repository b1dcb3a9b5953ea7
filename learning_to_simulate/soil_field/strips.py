"""Strips of terrain under a tool and beside it: the columns of a sweep.

Under a blade of width w lie five strips of w / 5, beside it on either side three of 0.1 m. The
height of a strip at some place along the way is the mean over its width. Where all strips are
equal, one as wide as the tool does.
"""

from typing import NamedTuple

import numpy as np

from learning_to_simulate.soil_field.place import Place
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Tool

N_BESIDE, BESIDE_WIDTH = 3, 0.1  # strips on either side, m of the field
BESIDE = N_BESIDE * BESIDE_WIDTH  # soil farther beside the tool has not moved, m of the field
ACROSS = np.array([-0.4, -0.2, 0.0, 0.2, 0.4])  # where a strip is read, in its widths


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


def strips_of(tool: Tool, even: bool = False) -> Strips:
    """The strips of a tool; one on even terrain, and for a tool that knows no neighbours."""
    width, count = tool.width / tool.scale, tool.columns
    if even or count == 1:
        return Strips(np.zeros(1), np.array([width]), slice(0, 1))
    under = (np.arange(count) - (count - 1) / 2) * width / count
    beside = width / 2 + BESIDE_WIDTH * (np.arange(N_BESIDE) + 0.5)
    return Strips(
        np.concatenate([-beside[::-1], under, beside]),
        np.concatenate(
            [np.full(N_BESIDE, BESIDE_WIDTH), np.full(count, width / count),
             np.full(N_BESIDE, BESIDE_WIDTH)]
        ),
        slice(N_BESIDE, N_BESIDE + count),
    )  # fmt: skip


def heights(terrain: Terrain, place: Place, scale: float, strips: Strips, u) -> np.ndarray:
    """Heights [J, k] of strips at places u [k] along the way, on its graded ground, all in m of the
    field, from a terrain in m of the world."""
    across = strips.centres[:, None] + strips.widths[:, None] * ACROSS
    along, over = scale * place.cosine * np.asarray(u)[:, None], scale * across[:, None, :]
    x, z = (place.origin[i] + place.along[i] * along + place.across[i] * over for i in (0, 2))
    return terrain.at(x, z).mean(axis=-1) / scale
