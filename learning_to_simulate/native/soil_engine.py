"""The soil field in C: `CEngine`, a tool on a terrain, and who gets which engine.

It gives the frames of `soil_field.engine.TfEngine` to round-off.
"""

import ctypes
import weakref

import numpy as np

from learning_to_simulate.native import engines, library, soil_data
from learning_to_simulate.native.binding import Instance, Loaded
from learning_to_simulate.rollout_status import OK, Judgement, RolloutStatus
from learning_to_simulate.soil_field import engine, passage
from learning_to_simulate.soil_field.place import Place, place_of

_GROUNDS: weakref.WeakKeyDictionary = weakref.WeakKeyDictionary()  # terrain -> `lts_terrain`


def of(field, terrain, tool, members: int | None = None, kind: str = engines.BEST):
    """The engine of a `SoilStepper`; arguments and errors as there."""
    return engines.chosen(
        kind,
        lambda: CEngine(Loaded.of(soil_data.values(field)), terrain, tool, members),
        lambda why: engine.TfEngine(field, terrain, tool, members, why),
    )


def ground_of(terrain):
    """`lts_terrain` of a terrain, whose heights it shares; the same for all tools on it."""
    if terrain not in _GROUNDS:
        heights, soil = terrain.heights, terrain.soil
        ground = library.structures()['lts_terrain']()
        ground.heights = heights.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
        ground.n[:], ground.walled, ground.floor = terrain.shape, terrain.walled, terrain.floor
        ground.corner[:], ground.cell[:] = terrain.corner, terrain.cell
        ground.friction_angle_deg = soil.friction_angle_deg
        ground.density, ground.gravity = soil.density, soil.gravity
        ground.alive = heights
        _GROUNDS[terrain] = ground
    return _GROUNDS[terrain]


class _Tool(Instance):
    """A tool in C, of a `Loaded` model and what `SoilStepper` takes."""

    _prefix = 'lts_soil'

    def __init__(self, loaded: Loaded, terrain, tool, members):
        self.terrain, self.tool, self._members = terrain, tool, members
        self._ground = ground_of(terrain)
        form = library.structures()['lts_soil_tool'](*library.tool_numbers(tool))
        super().__init__(loaded, ctypes.addressof(form), ctypes.addressof(self._ground))
        # The library writes into heights of the ground and reads the model until the tool leaves.
        kept = self._memory, self._ground, loaded
        weakref.finalize(self, _close, loaded.c, self.soil, *kept)
        if members is not None:
            self.call('members', members)

    def settle(self, pose=None):
        """Lets tools that the library does not know write what they have done, before a step to the
        address of a pose reads heights; None: anyway."""
        if self.terrain.works_in_python and (
            pose is None or self.terrain.is_crowded(self) or self.call('reads', pose)
        ):
            _ = self.terrain.heights

    @property
    def place(self) -> Place:
        found = np.empty((3, 3))
        self.call('place', found)
        return Place(*found)

    def displaced(self, rest) -> np.ndarray:
        """float32 [P, 3], m, world: where particles are now that were at rest [P, 3]."""
        points = np.array(rest, np.float64, order='C')
        self.call('displacement', points, len(points), points)
        return points.astype(np.float32)

    def clone(self, terrain):
        """A tool of its own at the same point, on a terrain that has the content of the other."""
        other = type(self)(self.loaded, terrain, self.tool, self._members)
        other.call('clone', self.soil)
        return other


def _close(c, soil, *kept):
    """Leaves the terrain; what is kept may go then."""
    del kept
    c.lts_soil_close(soil)


class CEngine(_Tool):
    """Frames by C, of a `Loaded` model and what `SoilStepper` takes; raises as `Instance`."""

    def __init__(self, loaded: Loaded, terrain, tool, members=None):
        super().__init__(loaded, terrain, tool, members)
        self.name = f'C ({self.kernel})'
        # Every step uses the same memory: an address costs a microsecond.
        self._pose, self._result = np.empty(7), library.structures()['lts_soil_result']()
        self._at = self._pose.ctypes.data, ctypes.addressof(self._result)
        size = 21  # pose, force, torque, spread, bound and payload, which begin a result
        self._numbers = np.ctypeslib.as_array(
            ctypes.cast(self._at[1], ctypes.POINTER(ctypes.c_double)), (size,)
        )
        self._last = None  # pose
        self._passage = -1
        self._place: Place | None = None
        self._of = {name: self.function(name) for name in ('step', 'propose')}
        terrain.add_work(self)

    @property
    def place(self) -> Place:
        if self._place is None:
            self._place = super().place
        return self._place

    def update(self) -> None:
        """Writes what all tools of the library have done into the terrain."""
        self.loaded.c.lts_terrain_update(ctypes.addressof(self._ground))

    @property
    def footprint(self):
        if self._last is None:
            return None
        found = np.empty(3)
        self.call('footprint', found)
        return found[:2], found[2]

    @property
    def spot(self):
        return None if self._last is None else (self._last[[0, 2]], self.tool.width)

    def start(self, pose):
        pose = engine.unit_pose(pose)
        engine.refuse_floor(pose, self.tool, self.terrain)
        place_of(pose)
        self.settle()
        self._pose[:] = pose
        self.call('start', *self._at)
        return self._taken()

    def step(self, pose, dt: float):
        self._go('step', pose, dt)
        return self._taken()

    def propose(self, pose, dt: float):
        self._go('propose', pose, dt)
        return self._frame()

    def load(self, pose, dt: float):
        self._go('propose', pose, dt)
        return self._numbers[7:13].copy()

    def tangent(self, direction, dt: float, reach: float):
        self.settle()
        found = np.empty(6)
        self.call('tangent', None, dt, np.array(direction, np.float64), reach, found)
        return found

    def _go(self, name, pose, dt):
        try:
            self._pose[:] = pose
            self.settle(self._at[0])
            code = self._of[name](self.soil, self._at[0], dt, self._at[1])
        except (ValueError, TypeError, ctypes.ArgumentError):
            self._refuse(pose, dt)
            raise
        if code < 0:
            self._refuse(pose, dt)
            self.check(code)

    def _refuse(self, pose, dt):
        """Raises what Python says of a step that C refuses, with its values and limits."""
        pose = engine.unit_pose(pose)
        engine.refuse_step(pose, self._last, dt, self.tool, self.terrain)
        scale = self.tool.scale
        u, before = (self.place.local(x[:3])[0] / scale for x in (pose, self._last))
        passage.refuse_far(scale, u - before)

    def _taken(self):
        if self._result.passage != self._passage or not self._result.frame:
            self._passage, self._place = self._result.passage, None
        frame = self._frame()
        self._last = frame.pose
        return frame

    def _frame(self):
        numbers, result = self._numbers.copy(), self._result
        numbers.setflags(write=False)
        pose = numbers[:7]
        now = self._judgement(result.now) if result.now.status else OK
        worst = self._judgement(result.worst) if result.status else OK
        force, torque, spread = numbers[7:10], numbers[10:13], numbers[13:19]
        return engine.SoilFrame(pose, force, torque, worst, now, spread, *map(float, numbers[19:]))

    def _judgement(self, found):
        text = ctypes.create_string_buffer(200)
        self.call('reason', ctypes.addressof(found), text, len(text))
        status = RolloutStatus.EXTRAPOLATING
        if found.status & library.constants()['LTS_NON_FINITE']:
            status = RolloutStatus.NON_FINITE
        return Judgement(status, found.frame, found.node, text.value.decode())

    def clone(self, terrain) -> 'CEngine':
        other = super().clone(terrain)
        other._last, other._passage, other._place = self._last, self._passage, self._place
        return other

    def anchor(self, pose, set_down: bool = False) -> 'CAnchor':
        found = CAnchor(self.loaded, self.terrain, self.tool, self._members)
        found.settle()
        found.call('anchor', np.array(pose, np.float64), int(set_down))
        return found


class CAnchor(_Tool):
    """How far particles have moved since a passage began, as `engine.TfAnchor`."""

    def leaves(self, pose) -> bool:
        return bool(self.call('reads', np.array(pose, np.float64)))

    def follow(self, pose, dt: float) -> None:
        pose = np.array(pose, np.float64)
        self.settle(pose)
        self.call('follow', pose, dt)
