"""What a tool has done since the start of its run, as inputs of a network in the subspace.

Modes stand still, so the path is read at places that stand still along the way (depth of the
deepest cut, how recently the tool was there, how much it had swept when it first came) and at
places about the tool; with them go pose, velocity and its fading memories, deepest and foremost
point, swept area and width. All are functions of the known motion: they are the same whether a run
is read whole or frame by frame, and no prediction enters them.

The state is that of `blade`, on a bed that counts as flat: what a bed is like at
the start, a network in the subspace knows from its modes.
"""

import dataclasses

import numpy as np

from learning_to_simulate.tool import blade, swept
from learning_to_simulate.tool.axes import Axes, blade_pose
from learning_to_simulate.tool.swept import SweptGrid

PLACES, BUMPS = 20, 12
# Offsets about the tool, m, as dense as what the soil there has felt is recent.
ABOUT = np.array([-0.3, -0.2, -0.13, -0.085, -0.055, -0.03, -0.015, 0.0, 0.015, 0.03, 0.055, 0.085,
                  0.13, 0.2])  # fmt: skip
RECENT = 0.15  # m of travel over which a passage fades
MARGIN = 0.1  # m that the places reach beyond the paths of training
_RATES = np.tile([0.1, 0.1, 1.0], 1 + len(blade.TIME_SCALES))  # m/s, m/s, rad/s
_SCALAR = {name: i for i, name in enumerate(blade.SCALARS)}
_N_RATES = len(_RATES)
WIDTH = 9 + _N_RATES + BUMPS + 3 * PLACES + 3 * len(ABOUT)


@dataclasses.dataclass(frozen=True)
class PathMemory:
    """Reads the paths of a scene.

    Attributes:
      axes: of the scene.
      surface: height of the resting bed, m.
      reach: smallest and largest place (m along the way) of the tool in the training runs.
      dt: s per frame.
      grid: bins of the memory.
    """

    axes: Axes
    surface: float
    reach: tuple[float, float]
    dt: float
    grid: SweptGrid = SweptGrid(blade.EDGE_RADIUS)

    @classmethod
    def of_runs(cls, bodies, scene, surface=None) -> 'PathMemory':
        """The reader for training runs.

        Args:
          bodies: list of [S, T, R, D] rigid particles, m.
          scene: with a prescribed body.
          surface: m; None takes where the tools begin.
        """
        axes = Axes.of_bodies(bodies, scene.up_axis)
        tips = [blade_pose(body, axes)[0] for body in bodies]
        if surface is None:
            surface = np.mean([tip[:, 0, 1].mean() for tip in tips])
        reach = min(t[..., 0].min() for t in tips), max(t[..., 0].max() for t in tips)
        return cls(axes, float(surface), (float(reach[0]), float(reach[1])), scene.dt)

    @classmethod
    def of_statistics(cls, values, scene) -> 'PathMemory':
        """The reader of `to_statistics`: axis, sign, surface and both ends of the reach."""
        axis, sign, surface, *reach = map(float, values)
        axes = Axes(int(axis), int(sign), scene.up_axis)
        return cls(axes, surface, (reach[0], reach[1]), scene.dt)

    def to_statistics(self) -> np.ndarray:
        """float64 [5], see `of_statistics`."""
        return np.array([self.axes.axis, self.axes.sign, self.surface, *self.reach], float)

    def start(self, body) -> tuple[blade.BladeState, np.ndarray]:
        """Memory (its state, and the tools' widths [S], m) of bodies [S, R, D], m, in their first
        frame."""
        pose = self._pose(body)
        return blade.start(self.grid, self._bed(len(pose)), pose), self.axes.width(body)

    def advance(self, memory, body):
        """The memory one frame later.

        Raises:
          ValueError: a body that leaves the bins, or that is not finite.
        """
        state, width = memory
        return blade.advance(self.grid, state, self._pose(body), self.dt), width

    def values(self, memory) -> np.ndarray:
        """float32 [S, WIDTH], of order one."""
        state, width = memory
        frame = blade.frame(self.grid, self._bed(len(width)), width, state)
        bins, s = frame.bins, frame.scalars.astype(np.float64)
        s = {name: s[:, i] for name, i in _SCALAR.items()}
        # Places on the bed, not from where the tool began: modes stand still.
        first = state.swept.origin
        tip, foremost = s['tip'] + first, s['foremost'] + first
        low, high = self.reach[0] - MARGIN, self.reach[1] + MARGIN
        tool = [
            (tip - low) / 0.15, s['height'] / 0.05, np.maximum(-s['height'], 0.0) / 0.05, s['lean'],
            s['area'] / 0.01, np.sqrt(np.maximum(s['area'], 0.0)) / 0.1,
            (foremost - low) / 0.15, (foremost - tip) / 0.1, s['half_width'] / 0.1,
        ]  # fmt: skip
        names = blade.SCALARS[_SCALAR['speed'] :][:_N_RATES]
        rates = [s[name] / scale for name, scale in zip(names, _RATES, strict=True)]
        centres = np.linspace(*self.reach, BUMPS)
        bumps = np.exp(-(((tip[:, None] - centres) / (centres[1] - centres[0])) ** 2))
        still = swept.channels_at(self.grid, bins, np.linspace(low, high, PLACES) - first[:, None])
        about = swept.channels_at(self.grid, bins, s['tip'][:, None] + ABOUT)
        parts = [
            np.stack(tool + rates, axis=1),
            bumps,
            still[..., blade.CUT] / 0.03,
            np.exp(-still[..., blade.SINCE] / RECENT),
            np.sqrt(still[..., blade.AREA_BEFORE] + 1e-6) / 0.05,
            about[..., blade.CUT] / 0.03,
            (about[..., blade.SURFACE] - s['height'][:, None]) / 0.05,
            np.exp(-about[..., blade.SINCE] / RECENT),
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

    def _bed(self, count):
        return swept.Bed(
            np.full((count, len(self.grid.offsets)), self.surface),
            np.full(count, self.surface),
            np.full(count, self.reach[1]),
        )

    def _pose(self, body):
        tip, lean = blade_pose(np.asarray(body, np.float64)[:, None], self.axes)
        return np.concatenate([tip[:, 0], lean], axis=1)
