"""`Passage`: one tool on its way over a terrain, from where it was set down."""

from collections.abc import Callable

import numpy as np

from learning_to_simulate.soil_field import strips as strips_lib
from learning_to_simulate.soil_field import sweep
from learning_to_simulate.soil_field.place import place_of
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import STANDARD_GRAVITY, Tool

AHEAD = 0.7  # m of the field, farther walls do not matter
EVEN = 1e-3  # m of the field by which strips may differ and count as one
_SET_DOWN = 0.05  # m of the field above all soil, from where a tool is set down


class Passage:
    """The sweep of a tool over a terrain.

    What the terrain was before the tool came is remembered as long as the bins reach there; the
    heights of the terrain are kept as the tool has left them by now.

    Args:
      terrain: is changed, if `rise` is given.
      tool: what goes.
      pose: [7] of the first frame.
      rise: gives how far the surface has risen [K] since, of this passage and places [K, 2] u from
        the origin and across, all in m of the field; or None.
      set_down: whether the tool comes from above; else it stands in soil that it has not moved.
      even: whether all strips count as the middle one; None: where they are.
      grid: bins.

    Attributes:
      place, scale, strips: of the passage.
      state: `sweep.Sweep`; one row for each strip.
      level: height that those of frames count from, m of the field.
    """

    def __init__(
        self, terrain: Terrain, tool: Tool, pose, rise: Callable | None = None,
        set_down: bool = True, even: bool | None = None, grid: sweep.Grid = sweep.GRID,
    ):  # fmt: skip
        self.terrain, self.tool, self.scale = terrain, tool, tool.scale
        self._rise, self._grid = rise, grid
        self.place = place_of(pose)
        self._values = tool.values(terrain.soil)
        # s of the field: in the root of scale over g.
        self._time = np.sqrt(STANDARD_GRAVITY / terrain.soil.gravity * self.scale)
        self._pose = self.seen(pose)
        self.strips = strips_lib.strips_of(tool)
        if even is None:
            read = self._read(self._pose[:1] + grid.offsets)
            even = bool(np.ptp(read, axis=0).max() <= EVEN)
        if even:
            self.strips = strips_lib.EVEN
        self._radius = np.full(len(self.strips.centres), tool.radius / self.scale)
        first = self._rows(self._pose)
        self.state = sweep.start(first, self._read, grid)
        self.level = float(self.state.surface.mean())
        if set_down:
            surface, above = self.state.surface, first.copy()
            above[:, 1] = max(first[0, 1], surface.max() + self._radius[0] + _SET_DOWN)
            self.state = sweep.start(above, lambda u: surface, grid)
            self._advance(first, 0.0, 1.0)
        # Of cells in sight, by their number: what they were before the tool.
        self._cells, self._before = np.zeros(0, np.int64), np.zeros(0)
        self._is_stale = False
        self._see()

    def seen(self, pose) -> np.ndarray:
        """u, y (m of the field) and lean (rad) of a pose [7]."""
        u, y, _ = self.place.local(pose[:3]) / self.scale
        return np.array([u, y, self.place.turns(pose)[0]])

    def _rows(self, pose):
        return np.repeat(pose[None], len(self.strips.centres), axis=0)

    def _read(self, u):
        u = np.broadcast_to(u, (len(self.strips.centres), np.shape(u)[-1]))
        return strips_lib.heights(self.terrain, self.place, self.scale, self.strips, u)

    def _advance(self, rows, turn, dt):
        turn = np.full(len(rows), turn)
        self.state = sweep.advance(self.state, rows, turn, self._radius, dt, self._read, self._grid)

    def step(self, pose, dt: float) -> None:
        """Moves the tool to a pose [7] within dt s.

        Raises:
          ValueError: see `sweep.advance`.
        """
        coming = self.seen(pose)
        change = coming - self._pose
        change[2] = (change[2] + np.pi) % (2 * np.pi) - np.pi
        origin = self.state.origin[0]
        if sweep.follow(origin, coming[0], self._grid) != origin:
            self.update()  # the last chance of cells that the bins leave
        self._advance(self._rows(coming), self.tool.turn(change, self.scale), dt / self._time)
        self._pose, self._is_stale = coming, True
        if self.state.origin[0] != origin:
            self._see()

    def _see(self):
        """Remembers what cells were that have come into sight, and forgets those out of sight."""
        low, high = self.state.origin[0] + self._grid.offsets[[0, -1]]
        cells = self._within(low, high)[0]
        known = np.searchsorted(self._cells, cells)
        known = np.minimum(known, max(len(self._cells) - 1, 0))
        is_known = self._cells[known] == cells if len(self._cells) else np.zeros(len(cells), bool)
        heights = self.terrain.heights.ravel()[cells]
        if len(self._cells):
            heights = np.where(is_known, self._before[known], heights)
        self._cells, self._before = cells, heights

    def update(self) -> None:
        """Writes the heights about the tool into its terrain."""
        if not self._is_stale or self._rise is None:
            return
        self._is_stale = False
        cells, places, before = self.surroundings()
        rise = self.scale * self._rise(self, places)
        self.terrain.write(cells, before + rise)

    def surroundings(self):
        """The cells about the tool: their numbers int [K] in the flat map, places [K, 2] u from the
        origin and across (m of the field), and heights [K] before the tool, m."""
        tip, chunk = self.state.tip[0], self._grid.chunk * self._grid.spacing
        cells, u, z = self._within(tip - sweep.WINDOW - chunk, tip + sweep.WINDOW)
        at = np.minimum(np.searchsorted(self._cells, cells), max(len(self._cells) - 1, 0))
        known = self._cells[at] == cells if len(self._cells) else np.zeros(len(cells), bool)
        places = np.stack([u - self.state.origin[0], z], axis=1)
        return cells[known], places[known], self._before[at[known]]

    def _within(self, low, high):
        """Ascending numbers of the cells between places low and high along the way (m of the
        field) and near enough across, u and distance across of their middles."""
        reach = self.tool.width / self.scale / 2 + strips_lib.BESIDE
        corners = np.array([[u, 0.0, z] for u in (low, high) for z in (-reach, reach)])
        found = self.place.world(self.scale * corners)[:, [0, 2]]
        t = self.terrain
        first = np.floor((found.min(axis=0) - t.corner) / t.cell).astype(int)
        last = np.ceil((found.max(axis=0) - t.corner) / t.cell).astype(int)
        spans = [np.arange(max(first[i], 0), min(last[i], t.shape[i])) for i in range(2)]
        i, k = (index.ravel() for index in np.meshgrid(*spans, indexing='ij'))
        x, z = t.middles
        points = np.stack([x[i], np.zeros(len(i)), z[k]], axis=1)
        u, _, across = (self.place.local(points) / self.scale).T
        inside = (u >= low) & (u <= high) & (np.abs(across) <= reach)
        return (i * t.shape[1] + k)[inside], u[inside], across[inside]

    @property
    def frame(self) -> sweep.Frame:
        """What the networks see now, [1, J, ...]."""
        s, level = self.state, np.full(len(self.strips.centres), self.level)
        ahead = self.terrain.ahead(self.place, self.scale * s.tip[0]) / self.scale
        own = np.append(self._values, min(ahead, AHEAD)).astype(np.float32)
        of_path = sweep.scalars(s, level, self._grid)
        own = np.broadcast_to(own, (len(level), len(own)))
        bins = sweep.channels(s, level, self._grid)
        return sweep.Frame(bins[None], np.concatenate([of_path, own], axis=1)[None])
