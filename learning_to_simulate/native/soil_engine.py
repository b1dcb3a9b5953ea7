"""The soil field in C: `CEngine`, a tool on a terrain, and who gets which engine.

It gives the frames of `soil_field.engine.TfEngine` to round-off.
"""

import ctypes
import weakref

import numpy as np

from learning_to_simulate.native import c_values, engines, library, soil_data
from learning_to_simulate.native.binding import KERNELS
from learning_to_simulate.rollout_status import OK, Judgement, RolloutStatus
from learning_to_simulate.soil_field import engine, passage
from learning_to_simulate.soil_field.place import Place, place_of

_GROUNDS: weakref.WeakKeyDictionary = weakref.WeakKeyDictionary()  # terrain -> `lts_terrain`


def of(field, terrain, tool, members: int | None = None, kind: str = engines.BEST):
    """The engine of a `SoilStepper`; arguments and errors as there."""
    return engines.chosen(
        kind,
        lambda: CEngine(Library.of(soil_data.values(field)), terrain, tool, members),
        lambda why: engine.TfEngine(field, terrain, tool, members, why),
    )


class Library:
    """A soil field in a shared library; arguments as of `binding.CSubspace`."""

    def __init__(self, loaded: ctypes.CDLL, model: int, kernel: str = 'best', data=None):
        self.c, self.model, self._data = loaded, model, data
        self.kernel = library.constants()[f'LTS_{kernel.upper()}']

    @classmethod
    def of(cls, values: dict, kernel: str = 'best') -> 'Library':
        """Of `soil_data.values`, by the library of this machine."""
        data = c_values.Structure('lts_soil_model', values)
        return cls(library.load(), ctypes.addressof(data.value), kernel, data)

    @classmethod
    def open(cls, path: str, symbol: str) -> 'Library':
        """The model of a name `lts_...` in a library that an exported project built."""
        loaded = library.declared(ctypes.CDLL(path))
        return cls(loaded, ctypes.addressof(ctypes.c_char.in_dll(loaded, symbol)))


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


class _Instance:
    """A tool in memory of its own, of a `Library` and what `SoilStepper` takes."""

    def __init__(self, loaded: Library, terrain, tool, members):
        self.loaded, self.terrain, self.tool, self._members = loaded, terrain, tool, members
        self._ground, c = ground_of(terrain), loaded.c
        form = library.structures()['lts_soil_tool'](*library.tool_numbers(tool))
        given = loaded.model, ctypes.addressof(form), ctypes.addressof(self._ground)
        memory, soil = np.empty(max(c.lts_soil_size(*given), 1), np.uint8), ctypes.c_void_p()
        at = memory.ctypes.data, memory.nbytes, loaded.kernel
        self.check(c.lts_soil_init(*given, *at, ctypes.byref(soil)))
        self.soil = soil.value
        # The library writes into heights of the ground and reads the model until the tool leaves.
        weakref.finalize(self, _close, c, self.soil, memory, self._ground, loaded)
        if members is not None:
            self.call('members', members)

    def check(self, code):
        """Raises ValueError for a code that is an error of lts.h, in its words."""
        if code < 0:
            raise ValueError(self.loaded.c.lts_error_text(code).decode())
        return code

    def settle(self, pose=None):
        """Lets tools that the library does not know write what they have done, before a step to the
        address of a pose reads heights; None: anyway."""
        if self.terrain.works_in_python and (
            pose is None or self.terrain.is_crowded(self) or self.call('reads', pose)
        ):
            _ = self.terrain.heights

    def call(self, name, *values):
        """Calls a function `lts_soil_<name>`; arrays are given by their addresses."""
        given = [x.ctypes.data if isinstance(x, np.ndarray) else x for x in values]
        return self.check(getattr(self.loaded.c, f'lts_soil_{name}')(self.soil, *given))

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

    def _copied(self, terrain):
        other = type(self)(self.loaded, terrain, self.tool, self._members)
        other.call('clone', self.soil)
        return other


def _close(c, soil, *kept):
    """Leaves the terrain; what is kept may go then."""
    del kept
    c.lts_soil_close(soil)


class CEngine(_Instance):
    """Frames by C, of a `Library` and what `SoilStepper` takes; ValueError for a kernel that this
    machine lacks."""

    def __init__(self, loaded: Library, terrain, tool, members=None):
        super().__init__(loaded, terrain, tool, members)
        self.name = f'C ({KERNELS[self.call("kernel")]})'
        # Every step uses the same memory: an address costs a microsecond.
        self._pose, self._result = np.empty(7), library.structures()['lts_soil_result']()
        self._at = self._pose.ctypes.data, ctypes.addressof(self._result)
        size = 20  # pose, force, torque, spread and bound, which begin a result
        self._numbers = np.ctypeslib.as_array(
            ctypes.cast(self._at[1], ctypes.POINTER(ctypes.c_double)), (size,)
        )
        self._last = None  # pose
        self._passage = -1
        self._place: Place | None = None
        self._of = {name: getattr(loaded.c, f'lts_soil_{name}') for name in ('step', 'propose')}
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
        pose = numbers[:7]
        pose.setflags(write=False)
        now = self._judgement(result.now) if result.now.status else OK
        worst = self._judgement(result.worst) if result.status else OK
        force, torque, spread = numbers[7:10], numbers[10:13], numbers[13:19]
        return engine.SoilFrame(pose, force, torque, worst, now, spread, float(numbers[19]))

    def _judgement(self, found):
        text = ctypes.create_string_buffer(200)
        self.call('reason', ctypes.addressof(found), text, len(text))
        status = RolloutStatus.EXTRAPOLATING
        if found.status & library.constants()['LTS_NON_FINITE']:
            status = RolloutStatus.NON_FINITE
        return Judgement(status, found.frame, found.node, text.value.decode())

    def clone(self, terrain) -> 'CEngine':
        other = self._copied(terrain)
        other._last, other._passage, other._place = self._last, self._passage, self._place
        return other

    def anchor(self, pose, set_down: bool = False) -> 'CAnchor':
        return CAnchor.at(self, pose, set_down)


class CAnchor(_Instance):
    """How far particles have moved since a passage began, as `engine.TfAnchor`."""

    @classmethod
    def at(cls, other: _Instance, pose, set_down: bool) -> 'CAnchor':
        found = cls(other.loaded, other.terrain, other.tool, other._members)
        found.settle()
        found.call('anchor', np.array(pose, np.float64), int(set_down))
        return found

    def leaves(self, pose) -> bool:
        return bool(self.call('reads', np.array(pose, np.float64)))

    def follow(self, pose, dt: float) -> None:
        pose = np.array(pose, np.float64)
        self.settle(pose)
        self.call('follow', pose, dt)

    def clone(self, terrain) -> 'CAnchor':
        return self._copied(terrain)
