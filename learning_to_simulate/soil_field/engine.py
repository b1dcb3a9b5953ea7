"""Frames of a tool on a terrain: what they hold, what is refused, and the engine in Python.

`TfEngine` is the reference; `native.soil_engine.CEngine` is its twin in C.
"""

import copy
import functools
import numbers
from typing import Any, NamedTuple

import numpy as np

from learning_to_simulate.live.poses import turned
from learning_to_simulate.rollout_status import OK, Judgement, RolloutStatus, worse
from learning_to_simulate.soil_field import sweep
from learning_to_simulate.soil_field.field import APART
from learning_to_simulate.soil_field.passage import Passage
from learning_to_simulate.soil_field.place import Place, checked_pose, place_of
from learning_to_simulate.soil_field.tools import STANDARD_DENSITY, STANDARD_GRAVITY

# A pose that is farther than this from the one before is a jump, m/s and rad/s.
FASTEST, FASTEST_TURN = 3.0, 20.0
# In the air a tool that leaves the plane of its passage by more begins a new one: rad, m of the
# field. So does one that is lifted over what it has cut.
TURNED, MOVED = 0.01, 0.005


class SoilFrame(NamedTuple):
    """One frame.

    Attributes:
      pose: float64 [7] of the tool, position (m) and unit quaternion (w, x, y, z).
      force: float64 [3] of the soil on the tool, N, world.
      torque: float64 [3], N m, about the position of the pose, world.
      judgement: the worst since the start; `now`: of this frame alone.
      spread: float64 [6], standard deviation over members of force and torque along the ground of
        the place, square to it, and across.
      bound: N, of the error of the force, see `SoilField.bound`; NaN where it is not known.
      payload: m3 of soil in a bucket; its weight is part of force and torque.
    """

    pose: np.ndarray
    force: np.ndarray
    torque: np.ndarray
    judgement: Judgement
    now: Judgement
    spread: np.ndarray
    bound: float
    payload: float = 0.0

    @property
    def status(self) -> RolloutStatus:
        return self.judgement.status

    @property
    def reason(self) -> str:
        return self.judgement.reason


def unit_pose(pose) -> np.ndarray:
    """A pose of its own, its quaternion of length 1, that nobody writes into; ValueError as
    `checked_pose`."""
    pose = checked_pose(pose)
    pose[3:] /= np.linalg.norm(pose[3:])
    pose.setflags(write=False)
    return pose


def refuse_floor(pose, tool, terrain) -> None:
    """Raises ValueError for a pose of a tool under the floor of its terrain."""
    if pose[1] - tool.radius < terrain.floor:
        raise ValueError(
            f'the tool would be at {pose[1] - tool.radius:.4g} m, under the floor of the '
            f'terrain at {terrain.floor:.4g} m'
        )


def refuse_step(pose, last, dt, tool, terrain) -> None:
    """Raises ValueError for a step from a pose to another that no tool makes within dt s."""
    if not (isinstance(dt, numbers.Real) and 0 < dt < np.inf):
        raise ValueError(f'dt is {dt} s, must be positive and finite')
    speed = np.linalg.norm(pose[:3] - last[:3]) / dt
    turn = 2 * np.arccos(min(abs(float(pose[3:] @ last[3:])), 1.0)) / dt
    if speed > FASTEST or turn > FASTEST_TURN:
        raise ValueError(
            f'the pose jumps: {speed:.3g} m/s and {turn:.3g} rad/s, at most {FASTEST} and '
            f'{FASTEST_TURN} are taken: give poses between, or a longer dt; to set the tool down '
            f'elsewhere call start()'
        )
    refuse_floor(pose, tool, terrain)


class TfEngine:
    """Frames by numpy and TensorFlow, of what `SoilStepper` takes; `name` says what computes them,
    and `why` not C ('' where nobody asked)."""

    def __init__(self, field, terrain, tool, members, why: str = ''):
        self._field, self._terrain, self._tool, self._members = field, terrain, tool, members
        self.name = f'TensorFlow{why}'
        self._units = tool.units(terrain.soil)
        self._rise = functools.partial(field.rise, members=members)
        self._passage: Any = None
        self._frame: Any = None
        self._number = 0
        terrain.works_in_python = True
        terrain.add_work(self)

    @property
    def place(self) -> Place:
        return self._passage.place

    def update(self) -> None:
        if self._passage is not None:
            self._passage.update()

    @property
    def footprint(self):
        return None if self._passage is None else self._passage.footprint

    def _finish(self):
        """Ends the passage: its soil comes to rest."""
        if self._passage is not None:
            self._passage.update()
            self._terrain.settle(self._passage.surroundings()[0])
            self._passage = None

    def start(self, pose) -> SoilFrame:
        """See `SoilStepper`; so are `propose`, `load` and `step`. What terrains ask for:
        `Terrain.add_work`."""
        pose = unit_pose(pose)
        refuse_floor(pose, self._tool, self._terrain)
        place_of(pose)  # refuses what would leave the tool without a passage
        if self._passage is not None:
            self._passage.give_and_take(keeps=False)
        self._finish()
        self._passage, self._number = Passage(self._terrain, self._tool, pose, self._rise), 0
        self._frame = self._seen(self._passage, pose, OK)
        return self._frame

    def propose(self, pose, dt: float) -> SoilFrame:
        return self._proposed(pose, dt)[1]

    def load(self, pose, dt: float) -> np.ndarray:
        frame = self.propose(pose, dt)
        return np.concatenate([frame.force, frame.torque])

    def step(self, pose, dt: float) -> SoilFrame:
        passage, frame = self._proposed(pose, dt)
        if passage.place.origin is not self._passage.place.origin:  # a new one, not a renewed one
            self._finish()
        self._passage, self._frame = passage, frame
        if len(passage.gone):
            self._terrain.settle(passage.gone, keep=passage.surroundings()[0])
        passage.give_and_take()
        self._number += 1
        return frame

    def tangent(self, direction, dt: float, reach: float) -> np.ndarray:
        """[6]: derivative of force and torque in the coming frame along a direction [6] of its pose
        from the newest on, a shift (m) and a turn about the axes of the world (rad).

        Args:
          dt: duration of the coming frame, s.
          reach: m on either side of the difference; of a turn tenths of a rad per m.
        """
        pose, ends = self._frame.pose, []
        shift, turn = np.reshape(direction, (2, 3))
        step = reach / (np.linalg.norm(shift) + 0.1 * np.linalg.norm(turn))
        for way in (step, -step):
            there = np.append(pose[:3] + way * shift, turned(pose[3:], way * turn))
            ends.append(self.load(there, dt))
        return (ends[0] - ends[1]) / (2.0 * step)

    def _proposed(self, pose, dt):
        last, pose = self._frame, unit_pose(pose)
        refuse_step(pose, last.pose, dt, self._tool, self._terrain)
        if self._terrain.is_crowded(self):
            _ = self._terrain.heights  # as other tools have left them by now
        self._passage.meet()
        passage, gone = copy.copy(self._passage), None
        if passage.is_due:
            passage = passage.renewed(last.pose)
            gone = passage.gone
        (_, yaw, _), aside = passage.place.turns(pose), passage.place.local(pose[:3])[2]
        leaves = abs(yaw) > TURNED or abs(aside) / passage.scale > MOVED or passage.is_over
        if leaves and not passage.bears:
            fresh = Passage(self._terrain, self._tool, pose, self._rise, brought=passage.payload)
            if not np.any(self._field.loads(fresh.frame, 1)):
                return fresh, self._seen(fresh, pose, last.judgement)
        passage.step(pose, dt)
        if gone is not None:  # its bins are about the tool, so the step has left none
            passage.gone = gone
        return passage, self._seen(passage, pose, last.judgement)

    @property
    def spot(self):
        """Where the tool is, [2] x and z, and its width, m; None before the start."""
        return None if self._frame is None else (self._frame.pose[[0, 2]], self._tool.width)

    def _conditions(self, passage, pose):
        place, t, width = passage.place, self._terrain, self._tool.width
        _, yaw, roll = place.turns(pose)
        ends = pose[[0, 2]] + np.outer([-width / 2, width / 2], place.across[[0, 2]]) - t.corner
        beyond = np.maximum(-ends, ends - t.cell * t.shape).max()
        beside = min(t.wall(pose[:3], way) for way in (place.across, -place.across)) - width / 2
        over_floor = pose[1] - self._tool.radius - t.floor
        spots = [other.spot for other in t.others(self) if other.spot is not None]
        others = [
            (width + w) / 2 + passage.scale * APART - np.hypot(*(spot - pose[[0, 2]]))
            for spot, w in spots
        ]
        found = [place.local(pose[:3])[2], max(beyond, 0.0),
                 max(passage.scale * self._tool.least_soil - over_floor, 0.0), max([0.0, *others]),
                 t.cell.max()]  # fmt: skip
        leans = self._tool.leans(float(passage.state.pose[2]))
        of_passage = passage.crossfall, passage.slope, passage.turning, leans
        near = max(self._tool.wall_beside - beside / passage.scale, 0.0)
        all_found = *np.array(found) / passage.scale, *of_passage, near, passage.heel
        return np.array([yaw, roll, *all_found])

    def _seen(self, passage, pose, before):
        frame = passage.frame
        loads = self._field.loads(frame, self._members)[:, 0].astype(np.float64) * self._units
        bears, held = None, passage.held  # a blade on its head may touch soil without a load
        if loads.any():
            share = self._field.contact(passage, self._members) * (1.0 - held.replaces)
            loads, bears = share * loads, share > 0
        mean = loads.mean(axis=0)
        # A bucket that is about to take soil up stays with the soil that it has cut.
        passage.bears = bool(mean.any()) or held.weighs > held.area
        found = self._conditions(passage, pose)[None]
        values = self._field.judged(frame, found, bears, held.area > 0)
        now = self._field.limits.judge(values, self._number, bool(np.isfinite(mean).all()))
        force, torque = passage.place.unlaid(mean[:3]), passage.place.unlaid(mean[3:])
        weight = STANDARD_DENSITY * STANDARD_GRAVITY * held.weighs * self._tool.width
        weight /= passage.scale
        force[1] -= weight * self._units[0]
        torque -= weight * held.middle * self._units[3] * passage.place.across
        spread = loads.std(axis=0)
        for values in (force, torque, spread):
            values.setflags(write=False)
        bound = self._field.bound(mean[:3], spread[:3], self._units[0], self._members)
        volume = held.area * passage.scale**2 * self._tool.width
        return SoilFrame(pose, force, torque, worse(before, now), now, spread, bound, volume)

    def clone(self, terrain) -> 'TfEngine':
        """The same at the same point, on a clone of the terrain."""
        other = copy.copy(self)
        other._terrain = terrain
        terrain.works_in_python = True
        terrain.add_work(other)
        if self._passage is not None:
            other._passage = self._passage.clone(terrain)
        return other

    def anchor(self, pose, set_down: bool = False) -> 'TfAnchor':
        """From where particles are followed, of the tool at a pose [7]; `set_down` from above, else
        it stands in soil that it has not moved."""
        return TfAnchor(self._field, self._terrain, self._tool, pose, self._members, set_down)


class TfAnchor:
    """A passage that leaves the terrain alone; how far particles have moved since it began at a
    pose [7]. Arguments of `SoilStepper` and `TfEngine.anchor`."""

    def __init__(self, field, terrain, tool, pose, members, set_down):
        self._field, self._members = field, members
        self._passage = Passage(terrain, tool, pose, set_down=set_down)

    @property
    def place(self) -> Place:
        return self._passage.place

    def leaves(self, pose) -> bool:
        """Whether the bins move on where the tool goes to a pose [7]."""
        origin = self._passage.state.origin
        return sweep.follow(origin, self._passage.seen(pose)[0]) != origin

    def follow(self, pose, dt: float) -> None:
        if not self._passage.lifts(self._passage.seen(pose)):
            self._passage.step(pose, dt)

    def displaced(self, rest) -> np.ndarray:
        """float32 [P, 3], m, world: where particles are now that were at rest [P, 3]."""
        passage, points = self._passage, rest.astype(np.float32)
        local = passage.place.laid(passage.place.local(rest)) / passage.scale
        places = local - [passage.state.origin, passage.level, 0.0]
        moved = self._field.displacement(passage, places, self._members)
        now = np.flatnonzero(moved.any(axis=1))
        # Those that rest are as they were, to the last bit.
        points[now] = rest[now] + passage.place.unlaid(passage.scale * moved[now])
        return points

    def clone(self, terrain) -> 'TfAnchor':
        other = copy.copy(self)
        other._passage = self._passage.clone(terrain)
        return other
