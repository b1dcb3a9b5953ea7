"""What a tool has swept on a terrain: the state of a soil field, in numpy and float64.

J strips lie side by side across the way, under the tool and beside it; each has bins along the way,
which move with the tool: a path has no end and a step always costs the same. What they remember are
(1) to (9) of docs/soil_field.md; of the outermost bins of the area (4) their share counts, and
`foremost` is at most FORGET before the tool, farther than the bins.

Two calls in a row equal one call over the joined path up to (7), which sees straight pieces.
Coordinates: u (m) along the way, y (m) upwards; lengths are those of the tool's scale
(`tools.Tool`).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from learning_to_simulate import swept

# Bins along the way: their spacing, m (an edge of less than half of it would fall between them),
# and their centres [n] from an origin, m, of which 0 is one.
SPACING = 0.005
OFFSETS = SPACING * np.arange(-110, 151)
OFFSETS.setflags(write=False)
# The tool stays within so much behind and ahead of the origin, m, which follows it by CHUNK bins.
BACK, ON, CHUNK = 0.1, 0.3, 20
WINDOW = 0.45  # m behind and before the tool that count
FORGET = 1.0  # m
# Soil farther behind the tool is at rest, and few drives of a wheel show it: all of it counts as so
# far behind, m; behind a wheel that goes backwards it lies ahead.
FAR = 0.2
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
CUT, SURFACE = 0, 1
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

# Heights [J, k] of the terrain at places u [k] of the strips, m.
Read = Callable[[np.ndarray], np.ndarray]


class Sweep(NamedTuple):
    """State of J strips; a function of terrain and path so far.

    Attributes:
      origin: u of the bins' origin, m; bin k lies at `origin + OFFSETS[k]`.
      pose: [3] u and y of the circle's centre (m) and its turn: lean of a blade, rad.
      memory: [K, 4] of `MOTIONS`, (7).
      travelled: length of the path, m.
      way: sum of ds, m.
      speed: ds over the duration of the last frame, m/s.
      surface: [J, n] height of the terrain before the tool, m.
      profile: [J, n] the lowest of surface and undersides so far, m.
      last: [J, n] distance travelled at the last passage below the surface, m; `-FORGET` where
        there was none.
      area_before: [J, n], (6), m2.
      struck: [J, n], (23), m.
      begun: [J] 1 where the tool has cut as deep as `TOUCH`, less where it has cut less.
      foremost: [J], m.
      dropped: [J] cut area of bins that have been dropped, m2.
    """

    origin: np.float64
    pose: np.ndarray
    memory: np.ndarray
    travelled: np.float64
    way: np.float64
    speed: np.float64
    surface: np.ndarray
    profile: np.ndarray
    last: np.ndarray
    area_before: np.ndarray
    struck: np.ndarray
    begun: np.ndarray
    foremost: np.ndarray
    dropped: np.ndarray

    @property
    def tip(self) -> np.float64:
        """u of the centre, m."""
        return self.pose[0]

    def repeated(self, strips: int) -> 'Sweep':
        """One strip as so many equal ones."""
        of_path, of_strips = self[:6], self[6:]
        return Sweep(*of_path, *(np.repeat(values, strips, axis=0) for values in of_strips))


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


def start(pose, read: Read) -> Sweep:
    """The state at a pose [3] before any motion: the tool has cut nothing yet, wherever it stands.
    ValueError for a terrain that is not finite."""
    surface, nothing = _seen(read, pose[0]), np.float64(0.0)
    never, none = np.zeros_like(surface), np.zeros(len(surface))
    return Sweep(
        pose[0], pose, np.zeros((len(MEMORIES), len(MOTIONS))), nothing, nothing, nothing,
        surface, surface, np.full_like(surface, -FORGET), never, never, none,
        np.full(len(surface), pose[0]), none,
    )  # fmt: skip


def advance(
    state: Sweep, pose, turn: float, radius: float, dt: float, read: Read, strikes: float = 0.0
) -> Sweep:
    """Moves the circle in a straight line to its next pose [3] within dt s; the state before is not
    changed.

    Args:
      turn: x of (7), m.
      radius: m.
      read: called where new bins come into sight.
      strikes: `Tool.strikes`, m.

    Raises:
      ValueError: a terrain that is not finite.
    """
    state = _followed(state, pose[0], read)
    step = pose - state.pose
    length = np.hypot(step[0], step[1])
    height = swept.underside(state.origin + OFFSETS[None], state.pose[None, :2], pose[None, :2],
                             radius)  # fmt: skip
    after = state._replace(**swept.after_step(state, height, pose[0], length))
    ds = length + np.abs(turn)
    motion = np.array([step[0], step[1], turn, ds * ds / dt]) / max(ds, 1e-30)
    fade = np.exp(-ds / np.array(MEMORIES))[:, None]
    deepest = (after.surface - after.profile).max(axis=1)
    begun = np.maximum(state.begun, np.minimum(deepest / TOUCH, 1.0))
    over = begun[:, None] * np.clip(state.surface + strikes - height, 0.0, strikes)
    after = after._replace(begun=begun, struck=np.maximum(state.struck, over))  # (23)
    # (6): what the tool passes over without a cut may come from what it has left.
    is_new = (after.struck > 0) & ~(state.struck > 0) & ~(after.profile < after.surface)
    there = area(state)
    left = np.maximum(there - layer(state, strikes), 0.0)
    known = np.where(is_new, left[:, None], state.area_before)
    return after._replace(
        area_before=swept.area_before(state, after, there, known),
        pose=pose,
        memory=fade * state.memory + (1 - fade) * motion,  # (7)
        way=state.way + ds,
        foremost=np.minimum(after.foremost, pose[0] + FORGET),
        speed=ds / dt,
    )


def follow(origin, tip):
    """Where the bins' origin goes when the tool goes to u = tip, m; by whole chunks, and no farther
    than needed."""
    chunk, offset = CHUNK * SPACING, tip - origin
    on = np.maximum(np.ceil((offset - ON) / chunk), 0.0)
    back = np.maximum(np.ceil((-BACK - offset) / chunk), 0.0)
    return origin + chunk * (on - back)


def _followed(state, tip, read):
    """The state with bins about the coming tip."""
    origin = follow(state.origin, tip)
    if not (shift := round((origin - state.origin) / SPACING)):
        return state
    bins, n = np.arange(len(OFFSETS)), len(OFFSETS)
    is_new, is_lost = ((bins + k < 0) | (bins + k >= n) for k in (shift, -shift))
    old = np.clip(bins + shift, 0, n - 1)
    lost = np.where(is_lost, state.surface - state.profile, 0.0)

    def moved(values, coming):
        return np.where(is_new, coming, values[:, old])

    surface = moved(state.surface, _seen(read, origin))
    return state._replace(
        origin=origin,
        surface=surface,
        profile=moved(state.profile, surface),
        last=moved(state.last, state.travelled - FORGET),
        area_before=moved(state.area_before, 0.0),
        struck=moved(state.struck, 0.0),
        dropped=state.dropped + SPACING * lost.sum(axis=1),
    )


def _seen(read, origin):
    surface = np.asarray(read(origin + OFFSETS), np.float64)
    if not np.isfinite(surface).all():
        raise ValueError('the terrain about the tool holds heights that are not finite')
    return surface


def area(state: Sweep) -> np.ndarray:
    """[J], m2: (4)."""
    distance = np.abs(state.origin + OFFSETS - state.tip)
    share = np.clip((WINDOW - distance) / SPACING + 0.5, 0.0, 1.0)
    return SPACING * np.sum(share * (state.surface - state.profile), axis=1)


def all_cut(state: Sweep) -> np.ndarray:
    """[J], m2: all that was cut, dropped bins among it."""
    return state.dropped + SPACING * (state.surface - state.profile).sum(axis=1)


def layer(state: Sweep, strikes: float) -> np.ndarray:
    """[J], m2: (24)."""
    uncut = 1.0 - np.minimum((state.surface - state.profile) / TOUCH, 1.0)
    passed = np.minimum(state.struck / TOUCH, 1.0)
    return SPACING * (uncut * passed * (strikes - state.struck)).sum(axis=1)


def pressed(state: Sweep, radius: float, angle: float, length: float) -> np.ndarray:
    """[J], m2: (26). The underside of the back goes straight on where it touches the circle, and
    rises backwards by an `angle` of up to pi / 2 rad over its `length`, m; a curled bucket's
    falls."""
    sine, cosine = np.sin(angle), np.cos(angle)
    slope = sine / max(cosine, 1e-9)
    slope = slope if abs(slope) > 1e-6 else 1e-6
    behind = (state.tip - state.origin) - OFFSETS - radius * sine
    most = state.profile - state.pose[1] + radius * cosine
    # Depths in a bin where the part of the back in it begins and ends: what lies between follows
    # exactly, so that a load does not feel the bins.
    begin, end = (
        np.maximum(most - slope * np.clip(behind + side, 0.0, length * cosine), 0.0)
        for side in (-0.5 * SPACING, 0.5 * SPACING)
    )
    return (begin**2 - end**2).sum(axis=1) / (2.0 * slope)


def cone(values, fall: float) -> np.ndarray:
    """The largest of all values [J, n], each lowered by `fall` per bin of distance."""
    # The largest so far from either side, in coordinates in which the slope of a cone is level.
    index = fall * np.arange(values.shape[1])
    forward = np.maximum.accumulate(values + index, axis=1) - index
    backward = np.maximum.accumulate((values - index)[:, ::-1], axis=1)[:, ::-1] + index
    return np.maximum(forward, backward)


def channels(state: Sweep, level: float) -> np.ndarray:
    """float32 [J, n, C] of `CHANNELS`; heights from a level, m."""
    cut = state.surface - state.profile
    touched = np.minimum(cut / TOUCH, 1.0)
    passed = np.maximum(touched, np.minimum(state.struck / TOUCH, 1.0))
    since = np.minimum(state.travelled - state.last, FORGET)
    seen = [
        cut,  # (3)
        state.surface - level,
        FORGET - touched * (FORGET - since),  # (5)
        state.area_before,  # (6)
        np.clip(3.0 * cone(passed, SPACING / REACH), 0.0, 1.0),  # (8)
        cone(cut, RISE * SPACING),  # (9)
        state.struck,  # (23)
    ]
    return np.stack(seen, axis=-1).astype(np.float32)


def scalars(state: Sweep, level: float) -> np.ndarray:
    """float32 [J, S] of `SCALARS`; u from the bins' origin, heights from a level, m."""
    # Farther behind, as of a tool that goes on in the air, it tells nothing of what is near.
    foremost = np.maximum(state.foremost, state.tip - WINDOW) - state.origin
    return columns(
        len(state.surface), state.tip - state.origin, state.pose[1] - level, state.pose[2],
        area(state), foremost, state.way, state.speed, *state.memory.ravel(),
    )  # fmt: skip


def columns(count: int, *values) -> np.ndarray:
    """float32 [count, S] with one column for each of S values: numbers, or arrays [count]."""
    found = np.empty((count, len(values)), np.float32)
    for column, value in enumerate(values):
        found[:, column] = value
    return found
