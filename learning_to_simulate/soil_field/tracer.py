"""`Tracer`: particles of the soil about a tool, from where somebody first asks for them.

Particles stand on a lattice under the terrain. A network tells how far each has moved since an
anchor, a passage that began in the middle of the way; when the bins of that are about to move on
(after 0.3 m ahead, 0.1 m back), particles stay as they are and a new anchor begins, with more of
the lattice where the tool comes to. The displacement grows from 0 there, so nothing jumps.
"""

import copy

import numpy as np

from learning_to_simulate.soil_field import strips as strips_lib
from learning_to_simulate.soil_field import sweep
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Tool

# Of the lattice, m of the field, and its layers: it reaches 0.15 m deep.
SPACING, LAYERS = 0.02, 8


class Tracer:
    """Particles about a tool with an engine at a pose [7]; the terrain is not changed."""

    def __init__(self, engine, terrain: Terrain, tool: Tool, pose):
        self._engine, self._terrain, self._tool = engine, terrain, tool
        self._spacing = SPACING * tool.scale
        self._columns = np.zeros((0, 2), np.int64)  # of the lattice that have particles
        self._rest = np.zeros((0, 3))
        self._pose = pose
        self._anchor()

    def _anchor(self):
        """Begins anew here; particles that are far behind are forgotten."""
        self._anchored = self._engine.anchor(self._pose)
        scale, place = self._tool.scale, self._anchored.place
        reach = self._tool.width / 2 + scale * strips_lib.BESIDE
        low, high = (scale * v for v in (-sweep.WINDOW, sweep.WINDOW + sweep.ON))

        def is_near(points):  # the tool stands at the origin of the place
            local = place.local(points)
            return (local[:, 0] >= low) & (local[:, 0] <= high) & (np.abs(local[:, 2]) <= reach)

        # Columns stand on one lattice of the whole terrain, so that old and new ones do not mix.
        ends = np.array([[u, 0, z] for u in (low, high) for z in (-reach, reach)])
        ends = place.world(ends)[:, [0, 2]]
        first, last = (np.rint(f(axis=0) / self._spacing).astype(int) for f in (ends.min, ends.max))
        spans = [np.arange(first[i], last[i] + 1) for i in range(2)]
        columns = np.stack(np.meshgrid(*spans, indexing='ij'), axis=-1).reshape(-1, 2)
        x, z = self._spacing * columns.T
        limits = self._terrain.corner + self._terrain.cell * self._terrain.shape
        inside = np.all(
            (np.stack([x, z], 1) >= self._terrain.corner) & (np.stack([x, z], 1) <= limits), axis=1
        )
        columns = columns[inside & is_near(np.stack([x, 0 * x, z], axis=1))]
        known = {tuple(c) for c in self._columns.tolist()}
        fresh = np.array([c for c in columns.tolist() if tuple(c) not in known], np.int64)
        fresh = fresh.reshape(-1, 2)
        self._columns = columns
        x, z = np.repeat(self._spacing * fresh.T, LAYERS, axis=1)
        below = np.tile(self._spacing * (np.arange(LAYERS) + 0.5), len(fresh))
        added = np.stack([x, self._terrain.at(x, z) - below, z], axis=1)
        self._rest = np.concatenate([self._rest[is_near(self._rest)], added])

    def step(self, pose, dt: float) -> None:
        """Follows the tool to a pose [7] that it reaches within dt s."""
        if self._anchored.leaves(pose):
            self._rest = self.points().astype(np.float64)
            self._anchor()
        self._anchored.follow(pose, dt)
        self._pose = pose

    def clone(self, engine, terrain: Terrain) -> 'Tracer':
        """The same particles, about a tool on a clone of the terrain with an engine of its own."""
        other = copy.copy(self)
        other._engine, other._terrain = engine, terrain
        other._anchored = self._anchored.clone(terrain)
        return other

    def points(self) -> np.ndarray:
        """float32 [N, 3], m, world."""
        return self._anchored.displaced(self._rest)
