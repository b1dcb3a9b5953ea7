"""`SoilStepper`: a tool on a terrain, frame by frame; its force, the terrain, particles."""

import copy
from typing import Any, NamedTuple

import numpy as np

from learning_to_simulate.rollout_status import OK, Judgement, RolloutStatus, worse
from learning_to_simulate.soil_field.field import SoilField
from learning_to_simulate.soil_field.passage import Passage
from learning_to_simulate.soil_field.place import UP, Place, checked_pose
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Tool
from learning_to_simulate.soil_field.tracer import Tracer

DT = 1.0 / 60.0  # s
# A pose that is farther than this from the one before is a jump, m/s and rad/s.
FASTEST, FASTEST_TURN = 3.0, 20.0
# In the air a tool that leaves the plane of its passage by more begins a new one: rad, m of the
# field.
TURNED, MOVED = 0.01, 0.005


class SoilFrame(NamedTuple):
    """One frame.

    Attributes:
      pose: float64 [7] of the tool, position (m) and unit quaternion (w, x, y, z).
      force: float64 [3] of the soil on the tool, N, world.
      torque: float64 [3], N m, about the position of the pose, world.
      judgement: the worst since the start; `now`: of this frame alone.
      spread: float64 [6], standard deviation over members of force and torque, along, up, across.
    """

    pose: np.ndarray
    force: np.ndarray
    torque: np.ndarray
    judgement: Judgement
    now: Judgement
    spread: np.ndarray

    @property
    def status(self) -> RolloutStatus:
        """The worst status since the start."""
        return self.judgement.status

    @property
    def reason(self) -> str:
        """Value and limits behind the status, in words; '' where it is OK."""
        return self.judgement.reason


class SoilStepper:
    """A tool on a terrain.

    Several tools may work on one terrain, each with a stepper of its own: each meets what the
    others have left.

    Args:
      field: `SoilField`.
      terrain: is changed.
      tool: of the kind of the field; None for the usual one.
      members: networks that answer; None: all.

    Raises:
      ValueError: a tool of another kind; fewer members.
    """

    def __init__(
        self, field: SoilField, terrain: Terrain, tool: Tool | None = None,
        members: int | None = None,
    ):  # fmt: skip
        kind = field.networks.tool
        self.tool = kind() if tool is None else tool
        if not isinstance(self.tool, kind):
            raise ValueError(f'the model knows a {kind.name}, not a {self.tool.name}')
        if members is not None and not 1 <= members <= field.networks.members:
            raise ValueError(f'members is {members}, must lie in [1, {field.networks.members}]')
        self.field, self.terrain, self._members = field, terrain, members
        self._units = self.tool.units(terrain.soil)
        self._passage: Any = None
        self._frame: Any = None
        self._tracer: Any = None
        self._number = 0
        terrain.add_work(self)

    def update(self) -> None:
        """Writes what the tool has done into the terrain."""
        if self._passage is not None:
            self._passage.update()

    @property
    def footprint(self):
        """See `Terrain.add_work`."""
        return None if self._passage is None else self._passage.footprint

    def _finish(self):
        """Ends the passage: its soil comes to rest."""
        self.update()
        if self._passage is not None:
            self.terrain.settle(self._passage.surroundings()[0])
            self._passage = None

    @property
    def place(self) -> Place:
        """Of the passage that the tool is on; ValueError before the start."""
        _ = self.frame
        return self._passage.place

    @property
    def frame(self) -> SoilFrame:
        """The newest frame."""
        if self._frame is None:
            raise ValueError('the tool stands nowhere yet: call start()')
        return self._frame

    def start(self, pose) -> SoilFrame:
        """Sets the tool down from above at a pose [7].

        Raises:
          ValueError: a pose that is none, or under the floor of the terrain.
        """
        pose = _pose(pose)
        self._refuse_floor(pose)
        self._finish()
        self._passage, self._number, self._tracer = self._begun(pose), 0, None
        self._frame = self._seen(self._passage, pose, OK)
        return self._frame

    def _begun(self, pose):
        return Passage(self.terrain, self.tool, pose, rise=self._rise)

    def _rise(self, passage, places):
        return self.field.rise(passage, places, self._members)

    def propose(self, pose, dt: float = DT) -> SoilFrame:
        """The frame in which the tool would reach a pose within dt s; nothing changes."""
        return self._proposed(pose, dt)[1]

    def step(self, pose, dt: float = DT) -> SoilFrame:
        """Moves the tool in a straight line to a pose [7] within dt s.

        Raises:
          ValueError: a pose that is none, jumps, or is under the floor; a time that does not pass;
            the tool stays where it was.
        """
        passage, frame = self._proposed(pose, dt)
        is_new = passage.place is not self._passage.place
        if is_new:
            self._finish()
        self._passage, self._frame = passage, frame
        if len(passage.gone):
            self.terrain.settle(passage.gone, keep=passage.surroundings()[0])
        self._number += 1
        if self._tracer is not None:
            if is_new:
                self._tracer = self._traced()
            else:
                self._tracer.step(frame.pose, dt)
        return frame

    def _proposed(self, pose, dt):
        last, pose = self.frame, _pose(pose)
        if not 0 < dt < np.inf:
            raise ValueError(f'dt is {dt} s: time must go on')
        speed = np.linalg.norm(pose[:3] - last.pose[:3]) / dt
        turn = 2 * np.arccos(min(abs(float(pose[3:] @ last.pose[3:])), 1.0)) / dt
        if speed > FASTEST or turn > FASTEST_TURN:
            raise ValueError(
                f'the pose jumps: {speed:.3g} m/s and {turn:.3g} rad/s, at most {FASTEST} and '
                f'{FASTEST_TURN} are taken; call start() anew'
            )
        self._refuse_floor(pose)
        if self.terrain.is_crowded(self):
            _ = self.terrain.heights  # as other tools have left them by now
        self._passage.meet()
        passage = copy.copy(self._passage)
        yaw, _, aside = self._turns(passage, pose)
        in_air = not np.any(self._last_load)
        if in_air and (abs(yaw) > TURNED or abs(aside) > MOVED):
            fresh = self._begun(pose)
            if not np.any(self.field.loads(fresh.frame, 1)):
                return fresh, self._seen(fresh, pose, last.judgement)
        passage.step(pose, dt)
        return passage, self._seen(passage, pose, last.judgement)

    def _refuse_floor(self, pose):
        if pose[1] - self.tool.radius < self.terrain.floor:
            raise ValueError(
                f'the tool would be at {pose[1] - self.tool.radius:.4g} m, under the floor of the '
                f'terrain at {self.terrain.floor:.4g} m'
            )

    @property
    def _last_load(self):
        return np.concatenate([self._frame.force, self._frame.torque])

    def _turns(self, passage, pose):
        _, yaw, roll = passage.place.turns(pose)
        return np.array([yaw, roll, passage.place.local(pose[:3])[2] / passage.scale])

    def _seen(self, passage, pose, before):
        """The frame of a passage at a pose."""
        frame = passage.frame
        loads = self.field.loads(frame, self._members)[:, 0].astype(np.float64) * self._units
        mean = loads.mean(axis=0)
        turns = self._turns(passage, pose)
        values = self.field.judged(frame, turns[None])
        now = self.field.limits.judge(values, self._number, bool(np.isfinite(mean).all()))
        force, torque = passage.place.vectors(mean[:3]), passage.place.vectors(mean[3:])
        return SoilFrame(pose, force, torque, worse(before, now), now, loads.std(axis=0))

    def particles(self) -> np.ndarray:
        """float32 [N, 3], m: places of particles about the tool.

        They are followed from the first call on; until then soil is what the terrain looks like.
        """
        if self._tracer is None:
            self._tracer = self._traced()
        return self._tracer.points()

    def _traced(self):
        return Tracer(self.field, self.terrain, self.tool, self.frame.pose, self._members)

    def clone(self) -> 'SoilStepper':
        """A stepper of its own at the same point, on a terrain of its own."""
        terrain = self.terrain.clone()
        other = SoilStepper(self.field, terrain, self.tool, self._members)
        if self._passage is not None:
            other._passage = self._passage.clone(terrain, other._rise)
        if self._tracer is not None:
            other._tracer = self._tracer.clone(terrain)
        other._frame, other._number = self._frame, self._number
        return other

    def stiffness(self, dt: float = DT, reach: float = 1e-4) -> np.ndarray:
        """How force and torque [6] answer to where the tool goes next: [6, 3] by u and height (m)
        and lean (rad) of the coming pose, N/m and so on, from central differences.

        Args:
          dt: duration of the coming frame, s.
          reach: m, and rad times 0.1 m, of the differences.
        """
        place = self._passage.place
        pose, columns = self.frame.pose, []
        for way in (place.along, UP, None):
            ends = []
            for sign in (1.0, -1.0):
                there = pose.copy()
                if way is None:
                    there[3:] = turned(pose[3:], sign * reach / 0.1 * place.across)
                else:
                    there[:3] += sign * reach * way
                frame = self.propose(there, dt)
                ends.append(np.concatenate([frame.force, frame.torque]))
            columns.append((ends[0] - ends[1]) / (2.0 * reach / (0.1 if way is None else 1.0)))
        return np.stack(columns, axis=1)


def turned(quaternion, rotation) -> np.ndarray:
    """A quaternion [4] (w, x, y, z) after a further rotation by a vector [3], rad."""
    angle = np.linalg.norm(rotation)
    axis = np.asarray(rotation) / max(angle, 1e-300)
    w, v = np.cos(angle / 2), np.sin(angle / 2) * axis
    w0, v0 = quaternion[0], np.asarray(quaternion[1:])
    return np.append(w * w0 - v @ v0, w * v0 + w0 * v + np.cross(v, v0))


def _pose(pose) -> np.ndarray:
    """A pose of its own, its quaternion of length 1, that nobody writes into."""
    pose = checked_pose(pose).copy()
    pose[3:] /= np.linalg.norm(pose[3:])
    pose.setflags(write=False)
    return pose
