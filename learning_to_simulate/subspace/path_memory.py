"""What a tool has done since the start of its run, as inputs of a network in the subspace.

Modes stand still, so the path is read at places that stand still along the way (depth of the
deepest cut, how recently the tool was there, how much it had swept when it first came) and at
places about the tool; with them go pose, velocity and its fading memories, deepest and foremost
point, swept area and width. All are functions of the known motion: they are the same whether a run
is read whole or frame by frame, and no prediction enters them.

The bed counts as flat: what it is like at the start, a network in the subspace knows from its
modes.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

from learning_to_simulate import swept
from learning_to_simulate.axes import Axes, blade_pose
from learning_to_simulate.swept import EDGE_RADIUS, SweptBed, SweptGrid

PLACES, BUMPS = 20, 12
# Offsets about the tool, m, as dense as what the soil there has felt is recent.
ABOUT = np.array([-0.3, -0.2, -0.13, -0.085, -0.055, -0.03, -0.015, 0.0, 0.015, 0.03, 0.055, 0.085,
                  0.13, 0.2])  # fmt: skip
RECENT = 0.15  # m of travel over which a passage fades
MARGIN = 0.1  # m that the places reach beyond the paths of training
TIME_SCALES = (0.05, 0.2)  # over which memories of the velocity fade, s
_RATES = np.tile([0.1, 0.1, 1.0], 1 + len(TIME_SCALES))  # m/s, m/s, rad/s
WIDTH = 9 + len(_RATES) + BUMPS + 3 * PLACES + 3 * len(ABOUT)


class Memory(NamedTuple):
    """What S tools have done so far.

    Attributes:
      swept: `SweptBed`.
      lean, width: float64 [S], rad and m.
      velocity: float64 [S, 3], of u and height (m/s) and lean (rad/s), in the last frame.
      faded: float64 [S, K, 3], its memories, one for each of the `TIME_SCALES`.
      area_before: float64 [S, n], m2, how much had been swept when a bin was first cut.
    """

    swept: SweptBed
    lean: np.ndarray
    width: np.ndarray
    velocity: np.ndarray
    faded: np.ndarray
    area_before: np.ndarray


@dataclasses.dataclass(frozen=True)
class PathMemory:
    """Reads the paths of a scene: height of the resting bed, m; smallest and largest place of the
    tool in the training runs, m along the way; s per frame; bins of the memory."""

    axes: Axes
    surface: float
    reach: tuple[float, float]
    dt: float
    grid: SweptGrid = SweptGrid(EDGE_RADIUS)

    @classmethod
    def of_runs(cls, bodies, axes: Axes, surface: float | None, dt: float) -> 'PathMemory':
        """The reader for training runs, list of bodies [S, T, R, D], m, that are prescribed; the
        surface is where the tools begin if it is not known."""
        tips = [blade_pose(body, axes)[0] for body in bodies]
        if surface is None:
            surface = np.mean([tip[:, 0, 1].mean() for tip in tips])
        reach = min(t[..., 0].min() for t in tips), max(t[..., 0].max() for t in tips)
        return cls(axes, float(surface), (float(reach[0]), float(reach[1])), dt)

    @classmethod
    def of_statistics(cls, values, scene) -> 'PathMemory':
        """The reader of `to_statistics`: axis, sign, surface and both ends of the reach."""
        axis, sign, surface, *reach = map(float, values)
        axes = Axes(int(axis), int(sign), scene.up_axis)
        return cls(axes, surface, (reach[0], reach[1]), scene.dt)

    def to_statistics(self) -> np.ndarray:
        return np.array([self.axes.axis, self.axes.sign, self.surface, *self.reach], float)

    def start(self, body) -> Memory:
        """Of bodies [S, R, D], m, in their first frame."""
        pose = self._pose(body)
        begun, count = swept.start(self.grid, pose[:, :2], self.surface), len(pose)
        return Memory(
            begun, pose[:, 2], self.axes.width(body), np.zeros((count, 3)),
            np.zeros((count, len(TIME_SCALES), 3)), np.zeros_like(begun.surface),
        )  # fmt: skip

    def advance(self, memory: Memory, body) -> Memory:
        """The memory one frame later; ValueError for a body that leaves the bins, or is not
        finite."""
        pose, before = self._pose(body), memory.swept
        after = swept.advance(self.grid, before, pose[:, :2], self.dt)
        turn = (pose[:, 2] - memory.lean) / self.dt
        velocity = np.concatenate([after.velocity, turn[:, None]], axis=1)
        # dm/dt = (v - m) / tau, exactly for a velocity that is constant within the frame.
        fade = np.exp(-self.dt / np.array(TIME_SCALES))[:, None]
        area = swept.swept_area(self.grid, before)
        return Memory(
            after, pose[:, 2], memory.width, velocity,
            fade * memory.faded + (1 - fade) * velocity[:, None],
            swept.area_before(before, after, area, memory.area_before),
        )  # fmt: skip

    def values(self, memory: Memory) -> np.ndarray:
        """float32 [S, WIDTH], of order one."""
        s, first = memory.swept, memory.swept.origin
        tip, height = s.tip, s.position[:, 1] - self.surface
        area = swept.swept_area(self.grid, s)
        low, high = self.reach[0] - MARGIN, self.reach[1] + MARGIN
        tool = [
            (tip - low) / 0.15, height / 0.05, np.maximum(-height, 0.0) / 0.05, memory.lean,
            area / 0.01, np.sqrt(np.maximum(area, 0.0)) / 0.1,
            (s.foremost - low) / 0.15, (s.foremost - tip) / 0.1, memory.width / 0.2,
        ]  # fmt: skip
        rates = np.concatenate([memory.velocity, memory.faded.reshape(len(tip), -1)], axis=1)
        since = np.minimum(s.travelled[:, None] - s.last, self.grid.forget)
        bins = np.stack([s.surface - s.profile, since, memory.area_before], axis=-1)
        centres = np.linspace(*self.reach, BUMPS)
        bumps = np.exp(-(((tip[:, None] - centres) / (centres[1] - centres[0])) ** 2))
        # Places on the bed, not from where the tool began: modes stand still.
        places = np.linspace(low, high, PLACES) - first[:, None]
        still = swept.channels_at(self.grid, bins, places)
        about = swept.channels_at(self.grid, bins, (tip - first)[:, None] + ABOUT)
        parts = [
            np.stack(tool, axis=1),
            rates / _RATES,
            bumps,
            still[..., 0] / 0.03,
            np.exp(-still[..., 1] / RECENT),
            np.sqrt(still[..., 2] + 1e-6) / 0.05,
            about[..., 0] / 0.03,
            np.tile(-height[:, None] / 0.05, len(ABOUT)),  # of the flat bed
            np.exp(-about[..., 1] / RECENT),
        ]
        return np.concatenate(parts, axis=1).astype(np.float32)

    def read(self, bodies) -> np.ndarray:
        """Values float32 [S, T, WIDTH] of whole runs [S, T, R, D]."""
        memory = self.start(bodies[:, 0])
        found = [self.values(memory)]
        for t in range(1, bodies.shape[1]):
            memory = self.advance(memory, bodies[:, t])
            found.append(self.values(memory))
        return np.stack(found, axis=1)

    def _pose(self, body):
        tip, lean = blade_pose(np.asarray(body, np.float64)[:, None], self.axes)
        return np.concatenate([tip[:, 0], lean], axis=1)
