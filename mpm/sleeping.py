"""Soil that rests is not stepped.

A particle sleeps where nothing has moved for a while: it is neither near the body nor near soil
that went faster than three thousandths of the body's speed lately. Nodes that sleeping soil touches
do not move, so it is a rigid bed, with its stress kept, to the soil that is awake.
"""

import numpy as np

from mpm.bodies import Body
from mpm.distance import signed_distances
from mpm.grid import Grid

# Soil moves if its mean speed over a period exceeds this share of the body's, and at least SLOWEST.
SHARE = 0.003
SLOWEST = 2e-5  # m/s
PERIOD = 4  # frames between two looks
MEMORY = 2  # periods that soil stays awake after it moved
# In metres: what a tool moves does not shrink with the cells.
SOIL_REACH = 0.04  # around moving soil that is awake
BODY_REACH = 0.08  # around the body


class Sleep:
    """Which particles are awake, from what they did in the last periods; all if it is not on."""

    def __init__(self, grid: Grid, is_on: bool):
        self.is_on = is_on
        self._grid = grid
        self._before, self._limit = None, SLOWEST
        # Period in which a cell last moved; all of them at first, for a body may start with a jerk.
        self._moved = np.zeros(grid.shape, dtype=np.int64)
        self._period = 0

    def awake(self, positions: np.ndarray, body: Body, path: np.ndarray, period: float):
        """Returns bool [N]: which particles at `positions` [N, 3] (m) to step in the coming period
        (s), in which the body has the poses `path` [T, 4]."""
        if not self.is_on:
            return np.ones(len(positions), dtype=bool)
        self._period += 1
        cells = self._cells(positions)
        if self._before is not None:
            way = np.linalg.norm(positions - self._before, axis=1)
            self._moved[tuple(cells[way > self._limit * period].T)] = self._period
        self._before = positions.copy()
        # The body's speed in the coming period, at whose end it is compared with the soil's.
        step = np.abs(np.diff(path, axis=0)) * [1.0, 1.0, body.reach, 1.0]
        speed = np.linalg.norm(step, axis=1).max() * (len(path) - 1) / period
        self._limit = max(SLOWEST, SHARE * speed)
        recent = self._moved >= self._period - MEMORY
        cells_off = np.ceil(SOIL_REACH / self._grid.cell - 1e-9).astype(int)
        return _spread(recent, 2 * cells_off + 1)[tuple(cells.T)] | _near(positions, body, path)

    def nodes_asleep(self, positions: np.ndarray) -> np.ndarray:
        """Returns bool [nodes], in the kernels' order: those that sleeping particles touch."""
        base = np.zeros(self._grid.shape, dtype=bool)
        base[tuple((self._cells(positions - 0.5 * self._grid.cell)).T)] = True
        # Of each three nodes from the first on; from (x, y, z) to the kernels' (y, x, z).
        base = _spread(base, 3, origin=1)
        return base.transpose(1, 0, 2).ravel()

    def _cells(self, positions):
        return np.floor((positions - self._grid.origin) / self._grid.cell).astype(np.int64)


def _near(positions, body, path):
    """Which particles are within BODY_REACH of the body somewhere on its path."""
    half = 0.5 * np.abs(path - path[0]).max(axis=0)
    # Seen from both ends of the path: nothing is farther from both than half the way.
    reach = BODY_REACH + np.linalg.norm(half[[0, 1, 3]]) + half[2] * body.reach
    near = signed_distances(body, path[0], positions) < reach
    if (path[-1] != path[0]).any():
        near |= signed_distances(body, path[-1], positions) < reach
    return near


def _spread(mask, size, origin=0):
    """The mask, spread over boxes of so many cells along each axis."""
    from scipy.ndimage import maximum_filter  # slow to load, and help does not wait for it

    return maximum_filter(mask, size, mode='constant', origin=origin)
