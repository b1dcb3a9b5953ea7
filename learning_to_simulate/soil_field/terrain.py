"""`Terrain`: the ground that tools work on, a map of heights."""

import weakref

import numpy as np

from learning_to_simulate.live.poses import numbers
from learning_to_simulate.soil_field.tools import Soil
from pca_tools import files

CELL = 0.02  # m, of a terrain of a given size
# Of `Terrain.settle`: most rounds, and m of height between neighbours that may stay too much.
SLIDES, SLOPE_TOLERANCE = 400, 1e-4
# Soil slides between all neighbours of a kind at once, so that no side of a heap comes first: the
# share of what is too steep that moves, and offsets of the neighbours. More than 1 / 2 and 1 / 4
# would swing.
SLIDE_WAYS = (0.42, (1, 0)), (0.42, (0, 1)), (0.22, (1, 1), (1, -1))
_FIXED = 'cell', 'corner', 'soil', 'floor', 'walled'


class Terrain:
    """Heights on a level grid of cells; y is up, x and z lie on the ground, all in metres.

    Heights may change, all else stays: tools on a terrain have taken it in.

    Args:
      heights: [nx, nz] at the middles of the cells.
      cell: side of a cell, or [2] along x and z.
      corner: [2] lowest x and z of the map.
      soil: what it consists of.
      floor: below it there is no soil.
      walled: whether the border is a wall, as that of a bin.

    Raises:
      ValueError: heights that are not finite or lie below the floor; cells of no size.
    """

    def __init__(self, heights, cell=CELL, corner=(0.0, 0.0), soil=None, floor=None, walled=False):
        # `write` needs a flat view.
        self._heights = np.ascontiguousarray(numbers('heights', heights, (None, None)))
        self._works: list = []  # weak references to what changes heights on being asked
        self.works_in_python = False  # whether some of that is unknown to the C library
        self.cell = np.broadcast_to(numbers('cell', cell, (), (2,)), 2).copy()
        self.corner = numbers('corner', corner, (2,))
        self.soil = Soil() if soil is None else soil
        self.walled = bool(walled)
        if not isinstance(self.soil, Soil):
            raise ValueError(f'soil is {soil!r}: lts.Soil(...) was expected')
        if not self._heights.size or not (self.cell > 0).all():
            raise ValueError(f'{self.shape} cells of {cell} m: positive numbers were expected')
        lowest = float(self._heights.min())
        self.floor = lowest - 1.0 if floor is None else float(floor)
        if not self.floor <= lowest:
            raise ValueError(f'the floor at {self.floor} m lies above heights of {lowest} m')
        self.cell.setflags(write=False)
        self.corner.setflags(write=False)

    def __setattr__(self, name, value):
        if name in _FIXED and name in vars(self):
            raise AttributeError(f'{name} of a terrain stays as it is: make another lts.Terrain')
        super().__setattr__(name, value)

    @property
    def heights(self) -> np.ndarray:
        """float64 [nx, nz], m, as all tools have left them by now; may be written into."""
        for work in self._alive():
            work.update()
        return self._heights

    def _alive(self):
        found = [(reference, reference()) for reference in self._works]
        self._works = [reference for reference, work in found if work is not None]
        return [work for _, work in found if work is not None]

    @property
    def seen(self) -> np.ndarray:
        """`heights` without what tools have still to write."""
        return self._heights

    def add_work(self, work) -> None:
        """From now on calls `work.update()` before heights are read, as long as `work` lives;
        `work.footprint` is the centre [2] (x, z) and the radius (m) of what it changes, or None."""
        self._works.append(weakref.ref(work))

    def others(self, work) -> list:
        return [other for other in self._alive() if other is not work]

    def is_crowded(self, work) -> bool:
        """Whether another work changes places that one changes."""
        if len(self._works) < 2 or work.footprint is None:
            return False
        others = [o.footprint for o in self.others(work) if o.footprint is not None]
        here, reach = work.footprint
        return any(np.hypot(*(there - here)) < reach + other for there, other in others)

    def pour(self, cells, volume: float) -> None:
        """Spreads a volume (m3) evenly over some cells [K] (numbers in the flat map), where it
        slides to its angle of repose; none: it is lost."""
        self._heights.reshape(-1)[cells] += volume / max(np.size(cells), 1) / np.prod(self.cell)
        self.settle(cells)

    def settle(self, cells, keep=()) -> None:
        """Lets soil slide where the slope at some cells [K] (numbers in the flat map), or near
        them, is steeper than its angle of repose, which is its friction angle; no soil is lost, and
        cells `keep` stay as they are."""
        if not np.size(cells):
            return
        i, k = np.divmod(cells, self.shape[1])

        def about(margin):
            low = np.maximum([i.min(), k.min()] - margin, 0)
            high = np.minimum([i.max(), k.max()] + margin + 1, self.shape)
            return low, high, self._heights[low[0] : high[0], low[1] : high[1]]

        # As far as a heap of all that stands out here runs.
        run = np.ptp(about(np.ones(2, int))[2]) / (self.soil.friction * self.cell)
        low, high, box = about(np.ceil(run).astype(int) + 1)
        numbers = np.arange(self._heights.size).reshape(self.shape)
        free = ~np.isin(numbers[low[0] : high[0], low[1] : high[1]], keep)
        groups = []
        for share, *ways in SLIDE_WAYS:
            group = []
            for dx, dz in ways:
                a, b = _pair(dx, dz)
                steepest = self.soil.friction * np.hypot(*(self.cell * [dx, dz]))
                # Between cells of which one is kept no slope is too steep.
                group.append((a, b, np.where(free[a] & free[b], steepest, np.inf)))
            groups.append((share, group))
        for _ in range(SLIDES):
            most = 0.0
            for share, group in groups:
                moved = np.zeros_like(box)
                for a, b, steepest in group:
                    # What one cell gives its neighbour gets, so the volume stays.
                    fall = box[a] - box[b]
                    excess = fall - np.clip(fall, -steepest, steepest)
                    moved[a] -= share * excess
                    moved[b] += share * excess
                    most = max(most, float(np.abs(excess).max(initial=0.0)))
                box += moved
            if most <= SLOPE_TOLERANCE:
                break

    @classmethod
    def flat(cls, size, height=0.0, cell=CELL, corner=(0.0, 0.0), **more):
        """A level terrain of a size [2] along x and z, m; see the class for the rest."""
        size = numbers('size', size, (2,))
        if not (size > 0).all():
            raise ValueError(f'size is {size} m, must be positive')
        counts = np.maximum(np.rint(size / cell), 1).astype(int)
        return cls(np.full(counts, float(height)), cell, corner, **more)

    def clone(self, soil: Soil | None = None) -> 'Terrain':
        """A terrain of its own with the same content, or of another soil."""
        soil = self.soil if soil is None else soil
        return Terrain(self.heights, self.cell, self.corner, soil, self.floor, self.walled)

    def save(self, path: str) -> None:
        """Writes the terrain to an `.npz` file."""
        files.write_npz(
            path, heights=self.heights, cell=self.cell, corner=self.corner, floor=self.floor,
            walled=self.walled,
            soil=np.array([self.soil.friction_angle_deg, self.soil.density, self.soil.gravity]),
        )  # fmt: skip

    @classmethod
    def load(cls, path: str) -> 'Terrain':
        """Reads what `save` has written; FileNotFoundError, or ValueError where it holds no
        terrain."""
        arrays = files.read_npz(path)
        try:
            heights, cell, corner = (arrays[name] for name in ('heights', 'cell', 'corner'))
            soil = Soil(*map(float, arrays['soil']))
            floor, walled = float(arrays['floor']), bool(arrays['walled'])
            return cls(heights, cell, corner, soil, floor, walled)
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f'{path}: is no terrain: {error}') from error

    @property
    def shape(self) -> tuple[int, int]:
        return self._heights.shape

    def write(self, cells, heights) -> None:
        """Sets the heights [K] (m) of cells of some numbers [K] in the flat map; at the floor soil
        ends."""
        self._heights.reshape(-1)[cells] = np.maximum(heights, self.floor)

    @property
    def middles(self) -> tuple[np.ndarray, np.ndarray]:
        """x [nx] and z [nz] of the middles of the cells, m."""
        x, z = (
            self.corner[i] + self.cell[i] * (np.arange(n) + 0.5) for i, n in enumerate(self.shape)
        )
        return x, z

    def wall(self, here, way) -> float:
        """Distance (m) from a point to the wall in a direction, both [3]; infinite where there is
        none."""
        if not self.walled:
            return np.inf
        # On each axis the border that the way runs to; the nearer one is met first.
        ends = [self.corner, self.corner + self.cell * self.shape]
        ways = [
            (ends[int(way[axis] > 0)][i] - here[axis]) / way[axis]
            for i, axis in enumerate((0, 2))
            if abs(way[axis]) > 1e-12
        ]
        return float(min(ways))

    def at(self, x, z) -> np.ndarray:
        """Heights (m) at places x, z (m, arrays of one shape), bilinear between the middles of the
        cells; beyond the map, its border."""
        nx, nz = self.shape
        row, a = _cell_of((np.asarray(x) - self.corner[0]) / self.cell[0], nx)
        column, b = _cell_of((np.asarray(z) - self.corner[1]) / self.cell[1], nz)
        # Weighted so that a level terrain is level to the last bit.
        h = self.heights
        low, high = min(1, nx - 1), min(1, nz - 1)
        near = h[row, column] + b * (h[row, column + high] - h[row, column])
        far = h[row + low, column] + b * (h[row + low, column + high] - h[row + low, column])
        return near + a * (far - near)


def _cell_of(place, count):
    """Lower neighbour of places in cells, and the share of the way to the upper one."""
    place = np.clip(place - 0.5, 0.0, count - 1.0)
    low = np.minimum(place.astype(np.int64), max(count - 2, 0))
    return low, place - low


def _pair(dx, dz):
    """Slices of all cells that have a neighbour at an offset (dx of 0 or 1), and of those."""
    span = {-1: (slice(1, None), slice(None, -1)), 0: (slice(None), slice(None)),
            1: (slice(None, -1), slice(1, None))}  # fmt: skip
    return (span[dx][0], span[dz][0]), (span[dx][1], span[dz][1])
