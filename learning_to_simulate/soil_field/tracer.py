"""Particles about a tool, moved by the network of the soil: given ones, or a lattice of its own.

A network tells how far each has moved since an anchor, a passage that began in the middle of the
way; when the bins of that are about to move on (after 0.3 m ahead, 0.1 m back), particles stay as
they are and a new anchor begins. The displacement grows from 0 there, so nothing jumps.
"""

import copy
from typing import Self

import numpy as np

from learning_to_simulate.live.poses import rotation_matrix
from learning_to_simulate.soil_field import payload, sweep
from learning_to_simulate.soil_field.place import BESIDE, place_of
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Tool

# Of the lattice, m of the field, and its layers: it reaches 0.15 m deep.
SPACING, LAYERS = 0.02, 8


class Followed:
    """Given particles [P, 3], m, world, from before a tool is set down at a pose [7].

    What a bucket takes up goes with it; what it pours comes to lie before its edge.
    """

    def __init__(self, engine, terrain: Terrain, tool: Tool, pose, points):
        self._engine, self._terrain, self._tool = engine, terrain, tool
        self._begin(pose, np.array(points, np.float64))
        # Particles per m3, if they fill a box.
        box = np.ptp(self._rest, axis=0).prod() if len(self._rest) else 0.0
        self._density = len(self._rest) / max(box, 1e-9)
        self._anchored = engine.anchor(pose, set_down=True)

    def _begin(self, pose, points):
        self._pose, self._rest, self._payload = pose, points, 0.0
        self._held = np.zeros(len(points), bool)
        self._in_tool = np.zeros((len(points), 3))  # of those held, from the pose, along its axes

    def begin(self, pose) -> None:
        """Goes on about a tool that has begun a new passage at a pose [7]."""
        self._rest, self._pose = self.points().astype(np.float64), pose
        self._anchor()

    def step(self, frame, dt: float) -> None:
        """Follows the tool to its newest `SoilFrame`, which it has reached within dt s."""
        if self._anchored.leaves(frame.pose):
            self._rest = self.points().astype(np.float64)
            self._anchor()
        self._anchored.follow(frame.pose, dt)
        self._pose = frame.pose
        self.weigh(frame.payload)

    def weigh(self, volume: float) -> None:
        """Takes up or pours particles where the bucket holds another volume now, m3."""
        before, self._payload = self._payload, volume
        if volume == before:
            return
        points, t, tool = self.points().astype(np.float64), self._terrain, self._tool
        place, scale = place_of(self._pose), tool.scale
        shape, lean = tool.shape, place.turns(self._pose)[0]  # type: ignore[attr-defined]
        ahead, _, across = place.local(points).T / scale

        def put(which, u):
            points[which] = place.world(scale * np.stack([u, 0 * u, across[which]], axis=1))

        held = np.flatnonzero(self._held)
        if volume > before:
            # The highest behind the edge, over the terrain now that this soil is gone.
            behind = (ahead <= 0.0) & (ahead > -shape.reach)
            behind &= ~self._held & (np.abs(across) <= tool.width / scale / 2)
            over = np.where(behind, points[:, 1] - t.at(points[:, 0], points[:, 2]), -np.inf)
            count = min(round((volume - before) * self._density), int(behind.sum()))
            self._held[np.argsort(-over, kind='stable')[:count]] = True
        else:
            nearest = held[np.argsort(-ahead[held], kind='stable')]
            poured = nearest[: len(held) - round(len(held) * volume / before)]
            put(poured, payload.FALLS_AHEAD + payload.FALLS_APART * np.linspace(-1, 1, len(poured)))
            points[poured, 1] = t.at(points[poured, 0], points[poured, 2])
            self._held[poured] = False
        held = np.flatnonzero(self._held)
        held = held[np.argsort(ahead[held], kind='stable')]
        area = volume / scale**2 / tool.width
        u, up = payload.places(shape, lean, t.soil.friction, area, len(held)).T
        put(held, u)
        points[held, 1] = self._pose[1] + scale * up
        self._in_tool[held] = (points[held] - self._pose[:3]) @ rotation_matrix(self._pose[3:])
        self._rest = points
        self._anchor()

    def _anchor(self):
        self._anchored = self._engine.anchor(self._pose)

    def points(self) -> np.ndarray:
        """float32 [P, 3], m, world."""
        points = self._anchored.displaced(self._rest)
        if self._held.any():
            now = self._in_tool[self._held] @ rotation_matrix(self._pose[3:]).T
            points[self._held] = now + self._pose[:3]
        return points

    def clone(self, engine, terrain: Terrain) -> Self:
        """The same particles, about a tool on a clone of the terrain with an engine of its own."""
        other = copy.copy(self)
        other._engine, other._terrain = engine, terrain
        other._anchored = self._anchored.clone(terrain)
        other._held, other._in_tool = self._held.copy(), self._in_tool.copy()
        return other


class Tracer(Followed):
    """Particles on a lattice under the terrain about a tool at a pose [7]; the terrain is not
    changed. Where an anchor begins, the lattice is filled where the tool comes to."""

    def __init__(self, engine, terrain: Terrain, tool: Tool, pose):
        self._engine, self._terrain, self._tool = engine, terrain, tool
        self._spacing = SPACING * tool.scale
        self._begin(pose, np.zeros((0, 3)))
        self._density = self._spacing**-3
        self.begin(pose)

    def begin(self, pose) -> None:
        """See `Followed`; only what the bucket holds goes on with it."""
        held = self._held
        self._rest, self._in_tool, self._held = self._rest[held], self._in_tool[held], held[held]
        self._columns = np.zeros((0, 2), np.int64)  # of the lattice that have particles
        self._pose = pose
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
        stay = is_near(self._rest) | self._held
        self._rest = np.concatenate([self._rest[stay], added])
        self._held = np.concatenate([self._held[stay], np.zeros(len(added), bool)])
        self._in_tool = np.concatenate([self._in_tool[stay], np.zeros_like(added)])
