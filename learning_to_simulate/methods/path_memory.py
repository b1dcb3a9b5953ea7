"""What a tool has done since the start of its run, as inputs of a network in the subspace.

Modes stand still, so the path is read at places that stand still along the way (depth of the
deepest cut, how recently the tool was there, how much it had swept when it first came) and at
places about the tool; with them go pose, velocity and its fading memories, deepest and foremost
point, swept area and width. All are functions of the known motion: they are the same whether a run
is read whole or frame by frame, and no prediction enters them.

The state is that of `swept_field.tool_path`, on a bed that counts as flat: what a bed is like at
the start, a network in the subspace knows from its modes.
"""

import dataclasses

import numpy as np

from learning_to_simulate.methods import swept_features
from learning_to_simulate.methods.swept_field import tool_path
from learning_to_simulate.methods.tool_motion import TravelFrame, blade_pose

# Half the thickness of the blade of the scenes; only how far its cut reaches past it hangs on it.
EDGE_RADIUS = 0.014
PLACES, BUMPS = 20, 12
# Offsets about the tool, m, as dense as what the soil there has felt is recent.
ABOUT = np.array([-0.3, -0.2, -0.13, -0.085, -0.055, -0.03, -0.015, 0.0, 0.015, 0.03, 0.055, 0.085,
                  0.13, 0.2])  # fmt: skip
RECENT = 0.15  # m of travel over which a passage fades
AT_ONCE = 2**20  # bins of all runs whose frames are read together, 50 MB
MARGIN = 0.1  # m that the places reach beyond the paths of training
_RATES = np.tile([0.1, 0.1, 1.0], 1 + len(tool_path.TIME_SCALES))  # m/s, m/s, rad/s
_SCALAR = {name: i for i, name in enumerate(tool_path.SCALARS)}
_N_RATES = len(_RATES)
WIDTH = 9 + _N_RATES + BUMPS + 3 * PLACES + 3 * len(ABOUT)


@dataclasses.dataclass(frozen=True)
class PathMemory:
    """Reads the paths of a scene.

    Attributes:
      frame: the way of travel.
      surface: height of the resting bed, m.
      reach: smallest and largest place (m along the way) of the tool in the training runs.
      dt: s per frame.
      grid: bins of the memory.
    """

    frame: TravelFrame
    surface: float
    reach: tuple[float, float]
    dt: float
    grid: swept_features.SweptGrid = swept_features.SweptGrid(EDGE_RADIUS)

    @classmethod
    def of_runs(cls, bodies, scene, surface=None) -> 'PathMemory':
        """The reader for training runs.

        Args:
          bodies: list of [S, T, R, D] rigid particles, m.
          scene: with a prescribed body.
          surface: m; None takes where the tools begin.
        """
        frames = [TravelFrame.of(body, scene.up_axis) for body in bodies]
        frame = max(frames, key=frames.count)
        tips = [blade_pose(body, frame)[0] for body in bodies]
        if surface is None:
            surface = np.mean([tip[:, 0, 1].mean() for tip in tips])
        reach = min(t[..., 0].min() for t in tips), max(t[..., 0].max() for t in tips)
        return cls(frame, float(surface), (float(reach[0]), float(reach[1])), scene.dt)

    @classmethod
    def of_statistics(cls, values, scene) -> 'PathMemory':
        """The reader of `to_statistics`: axis, sign, surface and both ends of the reach."""
        axis, sign, surface, *reach = map(float, values)
        frame = TravelFrame(int(axis), int(sign), scene.up_axis)
        return cls(frame, surface, (reach[0], reach[1]), scene.dt)

    def to_statistics(self) -> np.ndarray:
        """float64 [5], see `of_statistics`."""
        return np.array([self.frame.axis, self.frame.sign, self.surface, *self.reach], float)

    def start(self, body) -> tuple[tool_path.ToolState, np.ndarray]:
        """Memory (its state, and the tools' widths [S], m) of bodies [S, R, D], m, in their first
        frame."""
        pose = self._pose(body)
        across = 3 - self.frame.axis - self.frame.up
        width = np.ptp(body[..., across], axis=1) if body.shape[-1] == 3 else np.zeros(len(body))
        return tool_path.start(self.grid, self._bed(len(pose)), pose), width

    def advance(self, memory, body):
        """The memory one frame later.

        Raises:
          ValueError: a body that leaves the bins, or that is not finite.
        """
        state, width = memory
        return tool_path.advance(self.grid, state, self._pose(body), self.dt), width

    def values(self, memory) -> np.ndarray:
        """float32 [S, WIDTH], of order one."""
        state, width = memory
        frame = tool_path.frame(self.grid, self._bed(len(width)), width, state)
        bins, s = frame.bins, frame.scalars.astype(np.float64)
        s = {name: s[:, i] for name, i in _SCALAR.items()}
        first = state.swept.origin
        tip, foremost = s['tip'] + first, s['foremost'] + first
        low, high = self.reach[0] - MARGIN, self.reach[1] + MARGIN
        tool = [
            (tip - low) / 0.15, s['height'] / 0.05, np.maximum(-s['height'], 0.0) / 0.05, s['lean'],
            s['area'] / 0.01, np.sqrt(np.maximum(s['area'], 0.0)) / 0.1,
            (foremost - low) / 0.15, (foremost - tip) / 0.1, s['half_width'] / 0.1,
        ]  # fmt: skip
        names = tool_path.SCALARS[_SCALAR['speed'] :][:_N_RATES]
        rates = [s[name] / scale for name, scale in zip(names, _RATES, strict=True)]
        centres = np.linspace(*self.reach, BUMPS)
        bumps = np.exp(-(((tip[:, None] - centres) / (centres[1] - centres[0])) ** 2))
        still = self._at(bins, np.linspace(low, high, PLACES) - first[:, None])
        about = self._at(bins, s['tip'][:, None] + ABOUT)
        parts = [
            np.stack(tool + rates, axis=1),
            bumps,
            still[..., tool_path.CUT] / 0.03,
            np.exp(-still[..., tool_path.SINCE] / RECENT),
            np.sqrt(still[..., tool_path.AREA_BEFORE] + 1e-6) / 0.05,
            about[..., tool_path.CUT] / 0.03,
            (about[..., tool_path.SURFACE] - s['height'][:, None]) / 0.05,
            np.exp(-about[..., tool_path.SINCE] / RECENT),
        ]
        return np.concatenate(parts, axis=1).astype(np.float32)

    def read(self, bodies) -> np.ndarray:
        """Values float32 [S, T, WIDTH] of whole runs [S, T, R, D]."""
        n_run, n_frame = bodies.shape[:2]
        found = np.empty((n_run, n_frame, WIDTH), np.float32)
        at_once = max(1, AT_ONCE // (n_run * len(self.grid.offsets)))
        memory, waiting = self.start(bodies[:, 0]), []
        for t in range(n_frame):
            memory = self.advance(memory, bodies[:, t]) if t else memory
            waiting.append(memory)
            if len(waiting) == at_once or t == n_frame - 1:
                values = self.values(_joined(waiting)).reshape(len(waiting), n_run, WIDTH)
                found[:, t + 1 - len(waiting) : t + 1] = np.moveaxis(values, 0, 1)
                waiting = []
        return found

    def _bed(self, count):
        return tool_path.Bed(
            np.full((count, len(self.grid.offsets)), self.surface),
            np.full(count, self.surface),
            np.full(count, self.reach[1]),
        )

    def _pose(self, body):
        tip, lean = blade_pose(np.asarray(body, np.float64)[:, None], self.frame)
        return np.concatenate([tip[:, 0], lean], axis=1)

    def _at(self, bins, places):
        """Channels [S, P, C] of bins at places [S, P], m from the first position."""
        place = (places - self.grid.offsets[0]) / self.grid.spacing
        place = np.clip(place, 0.0, bins.shape[1] - 1.0)
        low = np.minimum(place.astype(np.int64), bins.shape[1] - 2)
        share, row = (place - low)[..., None], np.arange(len(bins))[:, None]
        return (1.0 - share) * bins[row, low] + share * bins[row, low + 1]


def _joined(memories):
    """Memories of several frames as one of more tools."""
    states, widths = zip(*memories)
    swept, *others = (list(parts) for parts in zip(*states))
    swept = swept_features.SweptBed(*map(np.concatenate, zip(*swept)))
    return tool_path.ToolState(swept, *map(np.concatenate, others)), np.concatenate(widths)
