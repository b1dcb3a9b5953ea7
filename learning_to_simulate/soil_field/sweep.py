"""What a tool has swept on a terrain: the state of a soil field, in numpy and float64.

A tool is a circle drawn out across the way: the round lower edge of a blade or bucket, or the rim
of a wheel. Columns lie side by side across the way, under the tool and beside it; each has bins
along the way. The bins are a ring about the tool: where it leaves them, those behind are dropped
and new ones are read from the terrain, so that a path has no end and a step always costs the same.
What they remember are (1) to (9) of docs/soil_field.md; of the outermost bins of the area (4) their
share counts, and `foremost` is at most WINDOW before the tool.

Two calls in a row equal one call over the joined path up to (7), which sees straight pieces; moving
path and terrain together changes nothing. Coordinates: u (m) along the way, y (m) upwards; lengths
are those of the tool's scale (`tools.Tool`).
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from learning_to_simulate import swept

WINDOW = 0.45  # m behind and before the tool that count
FORGET = 1.0  # m
MEMORIES = (0.0005, 0.002, 0.008, 0.03)  # m
# A place counts as fully cut below this depth, m; between, it counts by its depth, so that nothing
# jumps when the tool first touches the soil.
TOUCH = 0.002
# Soil farther than this from all that was cut has not moved, m.
REACH = 0.35
# How steeply the zone that has moved rises away from the cut: rise per length.
RISE = 0.5
# Channels of the bins of a frame: (3), height of the terrain over the level, (5), (6), (8), (9),
# (23).
CHANNELS = ('cut', 'surface', 'since', 'area_before', 'influence', 'disturbed', 'struck')
CUT, SURFACE, SINCE, AREA_BEFORE, INFLUENCE, DISTURBED, STRUCK = range(7)
MOTIONS = ('along', 'up', 'turn', 'pace')  # d / ds, and ds over its duration, m/s: (7)
# Scalars of a frame that come from the path; those of `tools.Tool.scalars` and `OF_PASSAGE` follow.
SCALARS = (
    'tip', 'height', 'lean', 'area', 'foremost', 'way', 'speed',
    *(f'{name}_{i}' for i in range(len(MEMORIES)) for name in MOTIONS),
)  # fmt: skip

# Soil that the tool has moved and not left behind, m2 (`passage`); how far below the tool the floor
# is, and a wall ahead, m; soil of the layers that the tool can have left, m2: (24); how far behind
# it a wall is, m; soil in place of the back of a blade, m2: (26).
OF_PASSAGE = ('carried', 'below', 'ahead', 'layer', 'behind', 'pressed')

Read = Callable[[np.ndarray], np.ndarray]


@dataclasses.dataclass(frozen=True)
class Grid:
    """Bins along the way.

    Attributes:
      spacing: of the bins, m; an edge of less than half of it would fall between them.
      behind, ahead: how far they reach behind and ahead of the origin, m.
      back, on: the tool stays within so much behind and ahead of the origin, m.
      chunk: bins by which the origin follows.
    """

    spacing: float = 0.005
    behind: float = 0.55
    ahead: float = 0.75
    back: float = 0.1
    on: float = 0.3
    chunk: int = 20

    @property
    def offsets(self) -> np.ndarray:
        """[n] centres of the bins from the origin, m; 0 is one."""
        first, last = round(self.behind / self.spacing), round(self.ahead / self.spacing)
        return self.spacing * np.arange(-first, last + 1)


GRID = Grid()


class Sweep(NamedTuple):
    """State of B columns; a function of terrain and path so far.

    Attributes:
      origin: [B] u of the bins' origin, m; bin k lies at `origin + grid.offsets[k]`.
      surface: [B, n] height of the terrain before the tool, m.
      profile: [B, n] the lowest of surface and undersides so far, m.
      last: [B, n] distance travelled at the last passage below the surface, m; `-FORGET` where
        there was none.
      area_before: [B, n], (6), m2.
      struck: [B, n], (23), m.
      begun: [B] 1 where the tool has cut as deep as `TOUCH`, less where it has cut less.
      pose: [B, 3] u and y of the circle's centre (m) and its turn: lean of a blade, rad.
      memory: [B, K, 4] of `MOTIONS`, (7).
      travelled: [B] length of the path, m.
      way: [B] sum of ds, m.
      foremost: [B], m.
      speed: [B] ds over the duration of the last frame, m/s.
      dropped: [B] cut area of bins that have been dropped, m2.
    """

    origin: np.ndarray
    surface: np.ndarray
    profile: np.ndarray
    last: np.ndarray
    area_before: np.ndarray
    struck: np.ndarray
    begun: np.ndarray
    pose: np.ndarray
    memory: np.ndarray
    travelled: np.ndarray
    way: np.ndarray
    foremost: np.ndarray
    speed: np.ndarray
    dropped: np.ndarray

    @property
    def tip(self) -> np.ndarray:
        """u [B] of the centre, m."""
        return self.pose[:, 0]


class Frame(NamedTuple):
    """What the networks see of B frames of one tool.

    Attributes:
      bins: float32 [B, J, n, C] of `CHANNELS`.
      scalars: float32 [B, J, S]: `SCALARS`, then those of the tool.
    """

    bins: np.ndarray
    scalars: np.ndarray

    def at(self, which) -> 'Frame':
        """Some of the frames."""
        return Frame(self.bins[which], self.scalars[which])


def start(pose, read: Read, grid: Grid = GRID) -> Sweep:
    """The state before any motion. The tool has cut nothing yet, wherever it stands.

    Args:
      pose: [B, 3], see `Sweep`.
      read: heights [B, k] of the terrain at places u [B, k] of the columns, m.
      grid: bins.

    Raises:
      ValueError: poses or heights that are not finite.
    """
    pose = _checked('pose', pose)
    origin = pose[:, 0].copy()
    surface = _checked('terrain', read(origin[:, None] + grid.offsets))
    none, never = np.zeros_like(origin), np.zeros_like(surface)
    return Sweep(
        origin, surface, surface, np.full_like(surface, -FORGET), never, never, none, pose,
        np.zeros((len(pose), len(MEMORIES), len(MOTIONS))), none, none, origin, none, none,
    )  # fmt: skip


def advance(
    state: Sweep, pose, turn, radius, dt: float, read: Read, grid: Grid = GRID, strikes: float = 0.0
) -> Sweep:
    """Moves the circles in a straight line to their next poses; the state before is not changed.

    Args:
      state: before.
      pose: [B, 3], see `Sweep`.
      turn: [B], x of (7), m.
      radius: [B], m.
      dt: duration, s.
      read: see `start`; called where new bins come into sight.
      grid: bins.
      strikes: `Tool.strikes`, m.

    Raises:
      ValueError: a time that does not pass; poses that are not finite.
    """
    swept.check_time(dt)
    pose = _checked('pose', pose)
    state = _followed(state, pose[:, 0], read, grid)
    step = pose - state.pose
    length = np.hypot(step[:, 0], step[:, 1])
    bins = state.origin[:, None] + grid.offsets
    height = swept.underside(bins, state.pose[:, :2], pose[:, :2], np.asarray(radius)[:, None])
    after = state._replace(**swept.after_step(state, height, pose[:, 0], length))
    ds = length + np.abs(turn)
    motion = np.stack([step[:, 0], step[:, 1], turn, ds**2 / dt], axis=1)
    motion /= np.maximum(ds, 1e-30)[:, None]
    fade = np.exp(-ds[:, None] / np.array(MEMORIES))[..., None]
    deepest = (after.surface - after.profile).max(axis=1)
    begun = np.maximum(state.begun, np.minimum(deepest / TOUCH, 1.0))
    over = begun[:, None] * np.clip(state.surface + strikes - height, 0.0, strikes)
    after = after._replace(begun=begun, struck=np.maximum(state.struck, over))  # (23)
    # (6): what the tool passes over without a cut may come from what it has left.
    is_new = (after.struck > 0) & ~(state.struck > 0) & ~(after.profile < after.surface)
    there = area(state, grid)
    left = np.maximum(there - layer(state, strikes, grid), 0.0)
    known = np.where(is_new, left[:, None], state.area_before)
    return after._replace(
        area_before=swept.area_before(state, after, there, known),
        pose=pose,
        memory=fade * state.memory + (1 - fade) * motion[:, None],  # (7)
        way=state.way + ds,
        foremost=np.minimum(after.foremost, pose[:, 0] + WINDOW),
        speed=ds / dt,
    )


def follow(origin, tip, grid: Grid = GRID):
    """Where the bins' origins [...] go when tools go to u = tip [...], m; by whole chunks, and no
    farther than needed."""
    chunk, offset = grid.chunk * grid.spacing, tip - origin
    on = np.maximum(np.ceil((offset - grid.on) / chunk), 0.0)
    back = np.maximum(np.ceil((-grid.back - offset) / chunk), 0.0)
    return origin + chunk * (on - back)


def _followed(state, tip, read, grid):
    """The state with bins about the coming tips [B]."""
    coming = follow(state.origin, tip, grid)
    shift = np.rint((coming - state.origin) / grid.spacing).astype(int)
    return _shifted(state, shift, coming, read, grid) if shift.any() else state


def _shifted(state, shift, origin, read, grid):
    """The state with the origins of its columns moved by bins [B] to u [B]."""
    n = state.surface.shape[1]
    index = np.arange(n) + shift[:, None]
    is_new = (index < 0) | (index >= n)
    old = np.clip(index, 0, n - 1)
    coming = _checked('terrain', read(origin[:, None] + grid.offsets))
    surface = np.where(is_new, coming, _taken(state.surface, old))
    place = np.arange(n) - shift[:, None]
    lost = np.where((place < 0) | (place >= n), state.surface - state.profile, 0.0)
    return state._replace(
        origin=origin,
        surface=surface,
        profile=np.where(is_new, surface, _taken(state.profile, old)),
        last=np.where(is_new, state.travelled[:, None] - FORGET, _taken(state.last, old)),
        area_before=np.where(is_new, 0.0, _taken(state.area_before, old)),
        struck=np.where(is_new, 0.0, _taken(state.struck, old)),
        dropped=state.dropped + grid.spacing * lost.sum(axis=1),
    )


def _taken(values, index):
    return np.take_along_axis(values, index, axis=1)


def area(state: Sweep, grid: Grid = GRID) -> np.ndarray:
    """[B], m2: (4)."""
    cut = state.surface - state.profile
    distance = np.abs(state.origin[:, None] + grid.offsets - state.tip[:, None])
    share = np.clip((WINDOW - distance) / grid.spacing + 0.5, 0.0, 1.0)
    return grid.spacing * np.sum(share * cut, axis=1)


def all_cut(state: Sweep, grid: Grid = GRID) -> np.ndarray:
    """[B], m2: all that was cut, dropped bins among it."""
    return state.dropped + grid.spacing * (state.surface - state.profile).sum(axis=1)


def layer(state: Sweep, strikes: float, grid: Grid = GRID) -> np.ndarray:
    """[B], m2: (24)."""
    uncut = 1.0 - np.minimum((state.surface - state.profile) / TOUCH, 1.0)
    passed = np.minimum(state.struck / TOUCH, 1.0)
    return grid.spacing * (uncut * passed * (strikes - state.struck)).sum(axis=1)


def pressed(state: Sweep, radius, angle: float, length: float, grid: Grid = GRID) -> np.ndarray:
    """[B], m2: (26). The underside of the back goes straight on where it touches the circle, and
    rises backwards by an `angle` of 0 to pi / 2 rad over its `length`, m."""
    sine, cosine = np.sin(angle), np.cos(angle)
    slope = max(sine / max(cosine, 1e-9), 1e-6)
    behind = (state.tip - state.origin)[:, None] - grid.offsets - radius * sine
    most = state.profile - state.pose[:, 1:2] + radius * cosine
    # Depths in a bin where the part of the back in it begins and ends: what lies between follows
    # exactly, so that a load does not feel the bins.
    begin, end = (
        np.maximum(most - slope * np.clip(behind + side, 0.0, length * cosine), 0.0)
        for side in (-0.5 * grid.spacing, 0.5 * grid.spacing)
    )
    return (begin**2 - end**2).sum(axis=1) / (2.0 * slope)


def cone(values, fall: float) -> np.ndarray:
    """C: the largest of all values [B, n], each lowered by `fall` per bin of distance."""
    # The largest so far from either side, in coordinates in which the slope of a cone is level.
    index = fall * np.arange(values.shape[1])
    forward = np.maximum.accumulate(values + index, axis=1) - index
    backward = np.maximum.accumulate((values - index)[:, ::-1], axis=1)[:, ::-1] + index
    return np.maximum(forward, backward)


def channels(state: Sweep, level, grid: Grid = GRID) -> np.ndarray:
    """float32 [B, n, C] of `CHANNELS`; heights from a level [B], m."""
    cut = state.surface - state.profile
    touched = np.minimum(cut / TOUCH, 1.0)
    passed = np.maximum(touched, np.minimum(state.struck / TOUCH, 1.0))
    since = np.minimum(state.travelled[:, None] - state.last, FORGET)
    seen = [
        cut,  # (3)
        state.surface - np.asarray(level)[:, None],
        FORGET - touched * (FORGET - since),  # (5)
        state.area_before,  # (6)
        np.clip(3.0 * cone(passed, grid.spacing / REACH), 0.0, 1.0),  # (8)
        cone(cut, RISE * grid.spacing),  # (9)
        state.struck,  # (23)
    ]
    return np.stack(seen, axis=-1).astype(np.float32)


def scalars(state: Sweep, level, grid: Grid = GRID) -> np.ndarray:
    """float32 [B, S] of `SCALARS`; u from the bins' origin, heights from a level [B], m."""
    own = [
        state.tip - state.origin,
        state.pose[:, 1] - level,
        state.pose[:, 2],
        area(state, grid),
        # Farther behind, as of a tool that goes on in the air, it tells nothing of what is near.
        np.maximum(state.foremost, state.tip - WINDOW) - state.origin,
        state.way,
        state.speed,
    ]
    memory = state.memory.reshape(len(state.way), -1)
    return np.concatenate([np.stack(own, axis=1), memory], axis=1).astype(np.float32)


def _checked(name, values):
    values = np.asarray(values, np.float64)
    if not np.isfinite(values).all():
        column = int(np.argwhere(~np.isfinite(values))[0][0])
        raise ValueError(f'{name} of column {column} is not finite: {values[column]}')
    return values
