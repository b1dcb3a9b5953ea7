"""Particles about a tool, moved by the network of the soil: given ones, or a lattice of its own.

A network tells how far each has moved since an anchor, a passage that began in the middle of the
way; when the bins of that are about to move on (after 0.3 m ahead, 0.1 m back), particles stay as
they are and a new anchor begins. The displacement grows from 0 there, so nothing jumps.
"""

import copy
from typing import Self

import numpy as np

from learning_to_simulate.soil_field import sweep
from learning_to_simulate.soil_field.place import BESIDE
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Tool

# Of the lattice, m of the field, and its layers: it reaches 0.15 m deep.
SPACING, LAYERS = 0.02, 8


class Followed:
    """Given particles [P, 3], m, world, from before a tool is set down at a pose [7]."""

    def __init__(self, engine, pose, points):
        self._engine, self._pose, self._rest = engine, pose, np.array(points, np.float64)
        self._anchored = engine.anchor(pose, set_down=True)

    def begin(self, pose) -> None:
        """Goes on about a tool that has begun a new passage at a pose [7]."""
        self._rest, self._pose = self.points().astype(np.float64), pose
        self._anchor()

    def step(self, pose, dt: float) -> None:
        """Follows the tool to a pose [7] that it reaches within dt s."""
        if self._anchored.leaves(pose):
            self._rest = self.points().astype(np.float64)
            self._anchor()
        self._anchored.follow(pose, dt)
        self._pose = pose

    def _anchor(self):
        self._anchored = self._engine.anchor(self._pose)

    def points(self) -> np.ndarray:
        """float32 [P, 3], m, world."""
        return self._anchored.displaced(self._rest)

    def clone(self, engine, terrain: Terrain) -> Self:
        """The same particles, about a tool on a clone of the terrain with an engine of its own."""
        other = copy.copy(self)
        other._engine, other._anchored = engine, self._anchored.clone(terrain)
        return other


class Tracer(Followed):
    """Particles on a lattice under the terrain about a tool at a pose [7]; the terrain is not
    changed. Where an anchor begins, the lattice is filled where the tool comes to."""

    def __init__(self, engine, terrain: Terrain, tool: Tool, pose):
        self._engine, self._terrain, self._tool = engine, terrain, tool
        self._spacing = SPACING * tool.scale
        self.begin(pose)

    def clone(self, engine, terrain: Terrain) -> Self:
        other = super().clone(engine, terrain)
        other._terrain = terrain
        return other

    def begin(self, pose) -> None:
        self._columns = np.zeros((0, 2), np.int64)  # of the lattice that have particles
        self._rest, self._pose = np.zeros((0, 3)), pose
        self._anchor()

    def _anchor(self):
        """Begins anew here; particles that are far behind are forgotten."""
        super()._anchor()
        scale, place, t = self._tool.scale, self._anchored.place, self._terrain
        reach = self._tool.width / 2 + scale * BESIDE
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
        ground = self._spacing * columns
        inside = ((ground >= t.corner) & (ground <= t.corner + t.cell * t.shape)).all(axis=1)
        columns = columns[inside & is_near(np.insert(ground, 1, 0.0, axis=1))]
        known = {tuple(c) for c in self._columns.tolist()}
        fresh = [c for c in columns.tolist() if tuple(c) not in known]
        self._columns = columns
        x, z = np.repeat(self._spacing * np.reshape(fresh, (-1, 2)).T, LAYERS, axis=1)
        below = np.tile(self._spacing * (np.arange(LAYERS) + 0.5), len(fresh))
        added = np.stack([x, t.at(x, z) - below, z], axis=1)
        self._rest = np.concatenate([self._rest[is_near(self._rest)], added])
