"""`Passage`: one tool on its way over a terrain, from where it was set down."""

import copy
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from learning_to_simulate.soil_field import payload, sweep
from learning_to_simulate.soil_field.place import BESIDE, Place, place_of, strips_of
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import STANDARD_GRAVITY, Tool

# m of the field: walls farther away do not matter, nor floors farther below.
AHEAD, BELOW = 0.7, 0.2
EVEN = 1e-3  # m of the field by which strips may differ and count as one
# m of the field along the way in one frame: farther, cells would go by that no frame saw.
MAX_STEP = sweep.WINDOW
SET_DOWN = 0.05  # m of the field above all soil, from where a tool is set down
UNDER = 0.1  # m of the field along the way from a tool, where terrain counts as under it
CROSSED = 0.05  # m of the field along the way from a tool, where terrain may fall across it
BACK = 0.02  # m of the field behind its foremost place, from where a tool has turned back
# A slope that is steeper than the first, not than the second, and even to so much (m of the field)
# is seen as level: no run was taught one. Where it changes by so much a passage is renewed.
FLAT, STEEP, EVEN_SLOPE, RELAID = 0.01, 0.27, 0.005, 0.04
# Bounds of the factor by which a heap is drawn up for its volume: (20). On ways longer than any run
# it must not pile up before the tool what that has left at its sides.
FACTOR = 0.05, 4.0


class Held(NamedTuple):
    """Soil in a bucket, m2 of the field; what weighs on that, more while it lifts; how far ahead of
    the pose its middle lies, m of the field; share of the load that it replaces."""

    area: float = 0.0
    weighs: float = 0.0
    middle: float = 0.0
    replaces: float = 0.0


class Passage:
    """The sweep of a tool over a terrain.

    What the terrain was before the tool came is remembered as long as the bins reach there; the
    heights of the terrain are kept as the tool has left them by now. A `copy.copy` may go on to try
    a step and be dropped: it shares what is known of cells. `clone` is for another terrain.

    Slopes, renewed passages and volume: docs/soil_field.md.

    Args:
      terrain: is changed, if `rise` is given.
      tool: what goes.
      pose: [7] of the first frame.
      rise: gives how far the surface has risen [K] since, of this passage and places [K, 2] u from
        the origin and across, all in m of the field; or None.
      set_down: whether the tool comes from above; else it stands in soil that it has not moved.
      place: None for that of the pose.
      lays: whether to see even slopes as level.
      brought: m2 of the field, soil that a bucket holds already.

    Attributes:
      place, scale, strips: of the passage; from one strip it goes over to all of them where even
        terrain ends.
      state: `sweep.Sweep`.
      level: height that those of frames count from, m of the field.
      gone: cells that the bins have left in the last step, to be settled.
      payload: m2 of the field, soil in the bucket when it was last in the air.
      bears: whether the soil bears on the tool in the newest frame, or is about to be taken up.

    Raises:
      ValueError: see `place_of`.
    """

    def __init__(
        self, terrain: Terrain, tool: Tool, pose, rise: Callable | None = None,
        set_down: bool = True, place: Place | None = None, lays: bool = True,
        brought: float = 0.0,
    ):  # fmt: skip
        self.terrain, self.tool, self.scale = terrain, tool, tool.scale
        self._rise = rise
        self._cell = float(np.prod(terrain.cell)) / self.scale**2  # m2 of the field
        self.place = place_of(pose) if place is None else place
        self._values = tool.values(terrain.soil)
        # s of the field: in the root of scale over g.
        self._time = np.sqrt(STANDARD_GRAVITY / terrain.soil.gravity * self.scale)
        self._pose = self.seen(pose)
        self._lays = lays
        # A sharper edge would fall between the bins.
        self._radius = max(tool.radius / self.scale, sweep.SPACING / 2)
        # Whether to look if the terrain goes on being even.
        self._looks = tool.columns > 1 and self._is_even(self._pose[0] + sweep.OFFSETS)
        self.strips = strips_of(tool, self._looks)
        if place is None and lays:
            self.place = self._ground(self._read(self._pose[0] + sweep.OFFSETS), self._pose[0])
            self._pose = self.seen(pose)
            if self._looks and not self._is_even(self._pose[0] + sweep.OFFSETS):
                self._looks, self.strips = False, strips_of(tool)
        self.state = sweep.start(self._pose, self._read)
        self.level = float(self.state.surface.mean())
        if set_down:
            # The way down is swept as well: the first frame has its cut (3) and memory (7).
            surface, above = self.state.surface, self._pose.copy()
            above[1] = max(above[1], surface.max() + self._radius + SET_DOWN)
            self.state = sweep.start(above, lambda u: surface)
            self._advance(self._pose, 0.0, 1.0)
        # Of cells in sight, by their number: heights before the tool, and as it left them, m.
        self._cells, self._before, self._left = np.zeros(0, np.int64), np.zeros(0), np.zeros(0)
        self._is_stale = False
        self.gone = self._cells
        self._left_behind = self._dropped = 0.0  # m3 of the field in d; m2 cut there
        # C less all that was cut when the bins last moved on; way then.
        self._owed = self._owed_at = 0.0
        self._see()
        self._is_stale = set_down
        self.payload, self.bears = brought, True
        self._taken = 0.0  # m2 of the field, taken up in the last step
        self.is_lifted = self.lifts(self._pose)

    def seen(self, pose) -> np.ndarray:
        """u, y (m of the field) and lean (rad) of a pose [7]."""
        # (25); on a slope the lean counts from it.
        u, y, _ = self.place.laid(self.place.local(pose[:3])) / self.scale
        return np.array([u, y, self.place.turns(pose)[0] - np.arctan(self.place.grade)])

    def lifts(self, pose) -> bool:
        """Whether a tool at a pose as it is `seen` is by `Tool.lifted`, where it has turned back at
        all, over the terrain before it."""
        # The paragraph after (22): after a turn back any height above the terrain will do.
        is_back = pose[0] < self.state.foremost[self.strips.under].max() - BACK
        return bool(self._over(pose) > (0.0 if is_back else self.tool.lifted))

    def _over(self, pose):
        """How high a tool at a pose as it is `seen` is over the highest terrain before it that lies
        under it, and over the mean of all in sight, m of the field."""
        surface = self.state.surface[self.strips.under]
        is_under = np.abs(self.state.origin + sweep.OFFSETS - pose[0]) < UNDER
        return pose[1] - self._radius - surface[:, is_under].max(initial=surface.mean())

    @property
    def is_over(self) -> bool:
        """Whether the tool has cut and is lifted since."""
        return self.is_lifted and bool(sweep.all_cut(self.state).any())

    @property
    def is_due(self) -> bool:
        """Whether the way is long, or the ground has another grade, and the tool has just cut
        farther than before."""
        s, under = self.state, self.strips.under
        if self.is_lifted or s.foremost[under].max() != s.tip:
            return False
        is_long = bool(s.way > self.tool.renewed_after)
        return is_long or self._ground(s.surface, s.origin, RELAID) is not self.place

    def renewed(self, pose) -> 'Passage':
        """The passage that goes on from its pose [7], on the terrain as it is by now."""
        self.update()
        place = self._ground(self.state.surface, self.state.origin)
        other = Passage(
            self.terrain, self.tool, pose, self._rise, set_down=False, place=place,
            lays=self._lays, brought=self.payload,
        )  # fmt: skip
        # The memory (7) holds directions, which turn with the ground.
        change = np.arctan(place.grade) - np.arctan(self.place.grade)
        (along, up), c, s = self.state.memory[:, :2].T, np.cos(change), np.sin(change)
        memory = self.state.memory.copy()  # seen from the new ground
        memory[:, :2] = np.stack([c * along + s * up, c * up - s * along], axis=1)
        other.remember(memory, self.state.speed)
        other.gone = np.setdiff1d(self._cells, other._cells, assume_unique=True)
        return other

    def remember(self, memory, speed) -> None:
        """Takes a memory [K, 4] of (7) and a speed of a tool that has come here."""
        self.state = self.state._replace(memory=memory, speed=speed)

    @property
    def crossfall(self) -> float:
        """By how much the terrain before the tool falls across the width w of a tool that sees one
        strip, m of the field: |b| w of the line a + b z that fits the cells under it best. Those
        near its ends count less, by (1 - (2 z / w)^2)^2, so that a rut of its own width is level
        wherever its walls lie among the cells."""
        if self.tool.columns > 1:
            return 0.0
        width, cell = self.tool.width / self.scale, self.terrain.cell.max() / self.scale
        fall = self.place.grade * self.place.cosine * self._places[:, 0]  # along the way
        u, z = (self._places - [self.state.tip, 0.0]).T
        weight = np.maximum(1.0 - (2.0 * z / (width + cell)) ** 2, 0.0) ** 2
        weight[np.abs(u) > CROSSED + cell] = 0.0
        total = max(weight.sum(), 1e-12)
        z = z - weight @ z / total
        # Where all those cells lie in one row, nothing can fall across.
        slope = (weight * z) @ (self._before / self.scale - fall)
        slope /= max((weight * z) @ z, 1e-6 * total)
        return float(abs(slope)) * width

    @property
    def slope(self) -> float:
        """Of the terrain before the tool along the way, against its grade: of the line a + b u that
        fits the mean of the outermost strips best over all bins, b; over STEEP the whole grade."""
        height, slope, _ = _line(self.state.surface)
        whole = self.place.relaid(height, slope).grade
        return whole if abs(whole) > STEEP else slope

    @property
    def heel(self) -> float:
        """Most soil in place of the back of a bucket that curls, so that its heel is lower than its
        edge, (26), m2 of the field: in no run of training was there any."""
        angle, length = self.tool.back(self.state.pose[2])
        if angle >= 0:
            return 0.0
        pressed = sweep.pressed(self.state, self._radius, angle, length)
        return float(pressed[self.strips.under].max())

    @property
    def turning(self) -> float:
        """Share of x in what the tool did on the last 30 mm (7): turns of a blade, slip. That of a
        wheel is negative where its rim is slower than its axle, whichever way it goes, and little
        where it has just turned back."""
        along, x = (float(v) for v in self.state.memory[-1, [0, 2]])
        if not self.tool.bears:
            return x
        return abs(x) if along * x >= 0 else along * x / math.hypot(along, x)

    def _ground(self, surface, origin, least=FLAT) -> Place:
        """The place on the ground of a surface [J, n_bin] about an origin, if it slopes by more."""
        if not self._lays:
            return self.place
        height, slope, off = _line(surface)
        if abs(slope) <= least or off > EVEN_SLOPE:
            return self.place
        place = self.place.relaid(self.scale * (height - slope * origin), slope)
        return place if abs(place.grade) <= STEEP else self.place

    def _is_even(self, u):
        """Whether all strips are equal at places u [k]."""
        strips = strips_of(self.tool)
        read = strips.heights(self.terrain, self.place, self.scale, u)
        return bool(self.place.cosine * np.ptp(read, axis=0).max(initial=0.0) <= EVEN)

    def _look_ahead(self, origin):
        """Takes all strips from where the bins that come into sight are not even."""
        low, high = self._sight()
        coming, half = origin + sweep.OFFSETS, sweep.SPACING / 2
        if not self._is_even(coming[(coming < low - half) | (coming > high + half)]):
            self._take_all()

    def _take_all(self):
        self._looks, self.strips = False, strips_of(self.tool)
        self.state = self.state.repeated(len(self.strips.centres))

    def _read(self, u):
        read = self.strips.heights(self.terrain, self.place, self.scale, u)
        # The heights of (25), which lie at u / cos alpha on the map.
        ground, c = self.place.height / self.scale, self.place.cosine
        return ground + c * (read - ground - self.place.grade * c * u)

    def _advance(self, pose, turn, dt):
        self.state = sweep.advance(
            self.state, pose, turn, self._radius, dt, self._read, self.tool.strikes
        )

    def step(self, pose, dt: float) -> None:
        """Moves the tool in a straight line to a pose [7] within dt s; ValueError for one farther
        away than `MAX_STEP`: the passage is as it was."""
        coming = self.seen(pose)
        change = coming - self._pose
        change[2] = (change[2] + np.pi) % (2 * np.pi) - np.pi
        refuse_far(self.scale, change[0])
        origin, to = self.state.origin, sweep.follow(self.state.origin, coming[0])
        lifts = self.lifts(coming)
        if lifts and not self.is_lifted:
            self.update()  # as the tool leaves it
            self._taken = self._scooped() if self._room.area else 0.0
        if to != origin:
            self.update()  # the last chance of cells that the bins leave
            if self._looks:
                self._look_ahead(to)
            self._owed, self._owed_at = self._owed_now, self.state.travelled
        self._advance(coming, self.tool.turn(change), dt / self._time)
        if self.place.grade and not sweep.all_cut(self.state).any():
            # What is set down straight down on a slope goes back along it: not in the soil.
            foremost = np.minimum(self.state.foremost, self.state.tip)
            self.state = self.state._replace(foremost=foremost)
        self._pose = coming
        self.gone = self.gone[:0]
        if to != origin:
            self._see()
        self._is_stale, self.is_lifted = True, lifts

    @property
    def held(self) -> 'Held':
        """What the bucket holds: (28)."""
        room = self._room
        holds = min(self.payload + self._taken, room.area)
        if not room.holds:
            return Held()
        if self.is_lifted or not sweep.all_cut(self.state).any():
            return Held(holds, holds, room.middle, room.holds * self.is_lifted)
        share = min(max(self._over(self._pose) / self.tool.lifted, 0.0), 1.0)
        more = share * self._scooped() if share > 0 else 0.0
        return Held(holds, holds + more, room.middle, room.holds * share)

    @property
    def _room(self):
        if self._rise is None:
            return payload.Room()
        return self.tool.room(self._lean, self.terrain.soil)

    def _scooped(self):
        """m2 of the field that the bucket takes up where it leaves the soil now: (28)."""
        places = np.stack(np.meshgrid(
            self.state.tip - self.state.origin - self._inside * payload.TAKEN_ALONG,
            self.tool.width / self.scale / 2 * np.array(payload.TAKEN_ACROSS), indexing='ij',
        ), axis=-1).reshape(-1, 2)  # fmt: skip
        rise = np.asarray(self._rise(self, places), np.float64)  # type: ignore[misc]
        over = np.maximum(rise + self._cut_at(places[:, 0]), 0.0)
        most = payload.kept(self.tool.shape, self._lean)  # type: ignore[attr-defined]
        most *= self._inside * float(over.mean())
        return min(max(self._room.area - self.payload, 0.0), most)

    @property
    def _lean(self):
        return float(self._pose[2] + np.arctan(self.place.grade))

    @property
    def _inside(self):
        return self.tool.shape.reach  # type: ignore[attr-defined]

    def _cut_at(self, u):
        """Mean cut of the strips under the tool at places u [k] from the origin, m of the field."""
        cut = (self.state.surface - self.state.profile)[self.strips.under].mean(axis=0)
        return np.interp(u, sweep.OFFSETS, cut)

    def give_and_take(self, keeps: bool = True) -> None:
        """Takes what the bucket has taken up away from the terrain, and pours what it has no room
        for any more (or does not keep) in front of its edge."""
        width = self.tool.width / self.scale
        cells, (u, across) = self._cells, self._places.T
        is_under = np.abs(across) <= width / 2
        ahead = u - self.state.tip
        if self._taken:
            there = is_under & (ahead <= 0.0) & (ahead > -self._inside)
            cut = self._cut_at(u[there] - self.state.origin) / self.place.cosine
            over = np.maximum((self._left - self._before)[there] / self.scale + cut, 0.0)
            found = self._cell * over.sum() / width
            share = min(self._taken / max(found, 1e-12), 1.0)
            self._left[there] -= self.scale * share * over
            self.terrain.write(cells[there], self._left[there])
            self._left_behind += share * found * width
            self.payload += share * found
            self._taken = 0.0
        if (excess := self.payload - (self._room.area if keeps else 0.0)) > 0:
            self.payload -= excess
            there = is_under & (np.abs(ahead - payload.FALLS_AHEAD) <= payload.FALLS_APART)
            self.terrain.pour(cells[there], excess * width * self.scale**3)

    @property
    def carried(self) -> np.ndarray:
        return sweep.all_cut(self.state) + self._owed_now

    @property
    def _owed_now(self):
        # (19) without what is cut now. A chunk of cells leaves at once; over the way of a chunk C
        # goes to what that makes of it, and does not jump.
        goal = -self._left_behind / (self.tool.width / self.scale) - self._dropped
        way = (self.state.travelled - self._owed_at) / (sweep.CHUNK * sweep.SPACING)
        return self._owed + min(way, 1.0) * (goal - self._owed)

    def clone(self, terrain: Terrain) -> 'Passage':
        """The passage on a clone of its terrain."""
        other = copy.copy(self)
        other.terrain = terrain
        other._before, other._left = self._before.copy(), self._left.copy()
        return other

    def _see(self):
        """Remembers what cells were that have come into sight, and forgets those out of sight."""
        cells, u, across = self._within(*self._sight())
        now = self.terrain.seen.ravel()
        before = now[cells]
        left = before.copy()
        _, new, old = np.intersect1d(cells, self._cells, assume_unique=True, return_indices=True)
        # What stayed in sight is still what it was before the tool came: s in (3).
        before[new], left[new] = self._before[old], self._left[old]
        gone = np.ones(len(self._cells), bool)
        gone[old] = False
        self.gone = self._cells[gone]
        # The two sums over d of (19): what rose there, and what was cut there.
        self._left_behind += self._cell * (now[self.gone] - self._before[gone]).sum() / self.scale
        self._dropped = float(self.state.dropped[self.strips.under].mean())
        self._cells, self._before, self._left = cells, before, left
        self._places = np.stack([u, across], axis=1)

    def meet(self) -> None:
        """Takes in what others have changed in sight: the terrain before the tool counts as changed
        by so much, and so do the bins."""
        change = self.terrain.seen.ravel()[self._cells] - self._left
        if not change.any():
            return
        # Heights are as they should be: to write them again would change them for the other, which
        # would write them again.
        self._before += change
        self._left += change
        t, changed = self.terrain, np.flatnonzero(change)
        i, k = np.divmod(self._cells[changed], t.shape[1])
        box = np.zeros((np.ptp(i) + 3, np.ptp(k) + 3))
        box[i - i.min() + 1, k - k.min() + 1] = change[changed]
        first = t.corner + t.cell * [i.min() - 1, k.min() - 1]
        across = strips_of(self.tool)
        bins = self.state.origin + sweep.OFFSETS
        read = across.heights(Terrain(box, t.cell, first), self.place, self.scale, bins)
        read *= self.place.cosine
        if self._looks and np.ptp(read, axis=0).max() > EVEN:
            self._take_all()
        if len(self.strips.centres) != len(read):
            read = read[across.under].mean(axis=0, keepdims=True)
        state = self.state
        self.state = state._replace(surface=state.surface + read, profile=state.profile + read)

    def update(self) -> None:
        """Writes the heights in sight into the terrain: (20)."""
        if self._rise is None:
            return
        self.meet()
        if not self._is_stale or self.is_lifted:
            return
        self._is_stale = False
        cells, places, before = self.surroundings()
        rise = np.asarray(self._rise(self, places), np.float64) / self.place.cosine
        if self._keeps_volume():
            up, down = (np.maximum(sign * rise, 0.0).sum() for sign in (1, -1))
            # (20): heaps in sight hold what is cut in sight, less what heaps behind hold already.
            goal = down - self._left_behind / self._cell
            factor = np.clip(goal / max(up, 1e-12), *FACTOR)
            rise = np.where(rise > 0, factor * rise, rise)
        self.terrain.write(cells, before + self.scale * rise)
        self._left[:] = self.terrain.seen.ravel()[cells]

    def surroundings(self):
        """The cells in sight: their numbers int [K] in the flat map, places [K, 2] u from the
        origin and across (m of the field), and heights [K] before the tool, m."""
        return self._cells, self._places - [self.state.origin, 0.0], self._before

    def _corners(self, low, high):
        """x and z [4, 2] (m) of the corners of what lies between places low and high along the way
        and near enough across (m of the field)."""
        reach = self.tool.width / self.scale / 2 + BESIDE
        ends = [[u * self.place.cosine, 0.0, z] for u in (low, high) for z in (-reach, reach)]
        ends = np.array(ends)
        return self.place.world(self.scale * ends)[:, [0, 2]]

    def _sight(self):
        return self.state.origin + sweep.OFFSETS[[0, -1]]

    @property
    def footprint(self) -> tuple[np.ndarray, float]:
        """Centre [2] (x, z) and radius (m) of what lies in sight."""
        corners = self._corners(*self._sight())
        centre = corners.mean(axis=0)
        return centre, float(np.hypot(*(corners - centre).T).max())

    def _keeps_volume(self):
        """Whether no soil leaves the map."""
        t, corners = self.terrain, self._corners(*self._sight()) - self.terrain.corner
        return t.walled or bool(((corners >= 0) & (corners <= t.cell * t.shape)).all())

    def _within(self, low, high):
        """Ascending numbers of the cells between places low and high along the way (m of the
        field) and near enough across, u and distance across of their middles."""
        reach = self.tool.width / self.scale / 2 + BESIDE
        t, found = self.terrain, self._corners(low, high)
        first = np.floor((found.min(axis=0) - t.corner) / t.cell).astype(int)
        last = np.ceil((found.max(axis=0) - t.corner) / t.cell).astype(int)
        spans = [np.arange(max(first[i], 0), min(last[i], t.shape[i])) for i in range(2)]
        i, k = (index.ravel() for index in np.meshgrid(*spans, indexing='ij'))
        x, z = t.middles
        points = np.stack([x[i], np.zeros(len(i)), z[k]], axis=1)
        u, _, across = (self.place.local(points) / self.scale).T
        u = u / self.place.cosine
        inside = (u >= low) & (u <= high) & (np.abs(across) <= reach)
        return (i * t.shape[1] + k)[inside], u[inside], across[inside]

    @property
    def frame(self) -> sweep.Frame:
        """What the networks see now, [1, J, ...]."""
        s, ground, c = self.state, self.place.height / self.scale, self.place.cosine
        along = self.place.along
        here = self.place.origin + self.scale * c * s.tip * along
        ahead, behind = (
            min(self.terrain.wall(here, way) / self.scale, AHEAD) for way in (along, -along)
        )
        # (25) the other way round: floors lie upright below, also on a slope.
        height = ground + c * (s.pose[1] - ground + self.place.grade * s.pose[0])
        below = height - self._radius - self.terrain.floor / self.scale
        under = self.strips.under
        pressed = np.zeros(len(s.surface))  # (26); beside the tool there is no back
        pressed[under] = sweep.pressed(s, self._radius, *self.tool.back(s.pose[2]))[under]
        own = sweep.columns(
            len(s.surface), *self._values, self.carried, np.clip(below, 0.0, BELOW), ahead,
            sweep.layer(s, self.tool.strikes), behind, pressed,
        )  # fmt: skip
        scalars = np.concatenate([sweep.scalars(s, self.level), own], axis=1)
        return sweep.Frame(sweep.channels(s, self.level)[None], scalars[None])


def _line(surface) -> tuple[float, float, float]:
    """Of the line a + b u through the mean of the outermost of strips [J, n_bin], a and b; how far
    the mean is from it at most, m of the field."""
    mean, u = surface[[0, -1]].mean(axis=0), sweep.OFFSETS
    middle = u.mean()
    slope = float((u - middle) @ mean / ((u - middle) @ (u - middle)))
    height = float(mean.mean()) - slope * middle
    return height, slope, float(np.abs(mean - height - slope * u).max())


def refuse_far(scale: float, along: float) -> None:
    """Raises ValueError for a step along the way, m of the field, that is too long."""
    if abs(along) > MAX_STEP:
        raise ValueError(
            f'the tool goes {scale * along:.4g} m within one frame, at most '
            f'{scale * MAX_STEP:.4g} m can be followed: give poses between'
        )
