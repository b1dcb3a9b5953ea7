"""`SoilStepper`: a tool on a terrain, frame by frame; its force, the terrain, particles."""

import copy
from typing import Any

import numpy as np

from learning_to_simulate.native import soil_engine
from learning_to_simulate.native.engines import BEST
from learning_to_simulate.soil_field.engine import SoilFrame
from learning_to_simulate.soil_field.field import SoilField
from learning_to_simulate.soil_field.place import UP, Place, checked_pose, place_of
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Tool
from learning_to_simulate.soil_field.tracer import Followed, Tracer

DT = 1.0 / 60.0  # s


class SoilStepper:
    """A tool on a terrain.

    Several tools may work on one terrain, each with a stepper of its own: each meets what the
    others have left.

    Args:
      field: `SoilField`.
      terrain: is changed.
      tool: of the kind of the field; None for the usual one.
      members: networks that answer; None: all.
      engine: 'best' takes C where a compiler is at hand, 'c' and 'tensorflow' the one.

    Raises:
      ValueError: a tool of another kind; fewer members; an unknown engine.
      native.library.NoCompiler: with 'c', where there is no compiler.
    """

    def __init__(
        self, field: SoilField, terrain: Terrain, tool: Tool | None = None,
        members: int | None = None, engine: str = BEST,
    ):  # fmt: skip
        kind = field.networks.tool
        self.tool = kind() if tool is None else tool
        if not isinstance(self.tool, kind):
            given = getattr(self.tool, 'name', type(self.tool).__name__)
            raise ValueError(f'the model knows a {kind.name}, not a {given}')
        if members is not None and members not in range(1, field.networks.members + 1):
            raise ValueError(f'members is {members}, must lie in [1, {field.networks.members}]')
        self.field, self._terrain = field, terrain
        self._engine = soil_engine.of(field, terrain, self.tool, members, engine)
        self._frame: Any = None
        self._tracer: Any = None

    @property
    def terrain(self) -> Terrain:
        """What the tool works on; another one takes another stepper."""
        return self._terrain

    @property
    def engine(self) -> str:
        """What computes the frames, in words."""
        return self._engine.name

    @property
    def place(self) -> Place:
        """Of the passage that the tool is on; ValueError before the start."""
        _ = self.frame
        return self._engine.place

    @property
    def frame(self) -> SoilFrame:
        """The newest; ValueError before the start."""
        if self._frame is None:
            raise ValueError('the tool stands nowhere yet: call start()')
        return self._frame

    def start(self, pose, particles=None) -> SoilFrame:
        """Sets the tool down from above at a pose [7]; ValueError for what is none, or is under the
        floor. Given `particles` [P, 3], m, are then followed in place of those about the tool."""
        given = None
        if particles is not None:
            given = Followed(self._engine, self.terrain, self.tool, checked_pose(pose), particles)
        self._frame, self._tracer = self._engine.start(pose), given
        return self._frame

    def propose(self, pose, dt: float = DT) -> SoilFrame:
        """The frame in which the tool would reach a pose within dt s; nothing changes."""
        _ = self.frame
        return self._engine.propose(pose, dt)

    def load(self, pose, dt: float = DT) -> np.ndarray:
        """Force and torque of the frame of `propose` alone, float64 [6], N and N m, world; in less
        time. ValueError as of `step`."""
        _ = self.frame
        return self._engine.load(pose, dt)

    def step(self, pose, dt: float = DT) -> SoilFrame:
        """Moves the tool in a straight line to a pose [7] within dt s; ValueError for a pose that
        is none, jumps, or is under the floor, or a time that does not pass: the tool stays where it
        was."""
        _ = self.frame
        place = None if self._tracer is None else self._engine.place
        self._frame = frame = self._engine.step(pose, dt)
        if place is not None:
            if self._engine.place.origin is not place.origin:
                self._tracer.begin(frame.pose)
                self._tracer.weigh(frame.payload)
            else:
                self._tracer.step(frame, dt)
        return frame

    @property
    def heights(self) -> np.ndarray:
        """float64 [nx, nz], m: those of the terrain, and over them what a bucket holds, as recorded
        maps count it."""
        found, held, scale = self.terrain.heights.copy(), self.frame.payload, self.tool.scale
        if held:
            x, z = np.meshgrid(*self.terrain.middles, indexing='ij')
            pose = self.frame.pose
            ahead, _, across = np.moveaxis(
                place_of(pose).local(np.stack([x, 0 * x, z], axis=-1)), -1, 0
            )
            long = scale * self.tool.shape.reach  # type: ignore[attr-defined]
            there = (ahead <= 0) & (ahead > -long) & (np.abs(across) <= self.tool.width / 2)
            found[there] += held / max(there.sum(), 1) / np.prod(self.terrain.cell)
        return found

    def particles(self) -> np.ndarray:
        """float32 [P, 3], m: places of particles: those that `start` was given, else some about the
        tool. These are followed from the first call on; until then soil is what the terrain looks
        like."""
        if self._tracer is None:
            self._tracer = Tracer(self._engine, self.terrain, self.tool, self.frame.pose)
        return self._tracer.points()

    def clone(self) -> 'SoilStepper':
        """A stepper of its own at the same point, on a terrain of its own."""
        other = copy.copy(self)
        other._terrain = self.terrain.clone()
        other._engine = self._engine.clone(other.terrain)
        if self._tracer is not None:
            other._tracer = self._tracer.clone(other._engine, other.terrain)
        return other

    def stiffness(self, dt: float = DT, reach: float = 1e-4) -> np.ndarray:
        """How force and torque [6] answer to where the tool goes next: [6, 3] by u and height (m)
        and lean (rad) of the coming pose, N/m and so on, from central differences over `reach` m
        (rad times 0.1 m) in a frame of dt s."""
        place, nowhere = self.place, np.zeros(3)
        ways = [[place.along, nowhere], [UP, nowhere], [nowhere, place.across]]
        columns = [self._engine.tangent(np.concatenate(way), dt, reach) for way in ways]
        return np.stack(columns, axis=1)
