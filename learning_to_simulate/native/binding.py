"""Models of the C library, called by ctypes: `CSubspace` and `CField`, each one run of a model.

They are thin: what a user steps is a `live.stepper.Stepper` (`engines`). Here arguments are checked
so far that C survives them, and every call has the name that lts.h or lts_field.h gives it.
"""

import abc
import ctypes
from typing import NamedTuple

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live.poses import numbers
from learning_to_simulate.native import c_values, field_data, library, model_data
from learning_to_simulate.rollout_status import Judgement, RolloutStatus
from learning_to_simulate.scene import RigidMotion

KERNELS = ('scalar', 'vector4', 'avx2', 'avx512')
_MOTIONS = (RigidMotion.NONE, RigidMotion.PRESCRIBED, RigidMotion.DRIVEN, RigidMotion.PREDICTED)


class KernelLacks(ValueError):
    """This machine lacks the instructions of a kernel."""


class CInstance(abc.ABC):
    """One run of a model, in memory of its own.

    Args:
      loaded: `library.declared` of a shared library.
      model: address of its `lts_model` or `lts_field_model`.
      kernel: 'best', 'avx512', 'avx2', 'vector4' (SSE2, NEON) or 'scalar'.

    Raises:
      ValueError: a model of another ABI version, a kernel that this machine lacks.
    """

    PREFIX = 'lts_'  # of the functions and structures of its kind

    def __init__(self, loaded: ctypes.CDLL, model: int, kernel: str = 'best'):
        self._c, self._model = loaded, model
        self._data = None  # keeps what the model points to
        self._d = library.structures()[f'{self.PREFIX}description']()
        self._done(self._function('describe')(model, ctypes.addressof(self._d)))
        if kernel not in ('best', *KERNELS):
            raise ValueError(f'kernel is {kernel!r}, must be best, {", ".join(KERNELS)}')
        self._memory = np.empty(self._function('size')(model), np.uint8)
        soil = ctypes.c_void_p()
        code = self._function('init')(
            model,
            self._memory.ctypes.data,
            self._memory.nbytes,
            library.constants()[f'LTS_{kernel.upper()}'],
            ctypes.byref(soil),
        )
        if code < 0:
            raise KernelLacks(f'this machine lacks kernel {kernel!r}')
        self._soil = soil.value
        self._result = library.structures()[f'{self.PREFIX}result']()
        # Every call uses the same structure: an address costs a microsecond.
        self._at_result = ctypes.addressof(self._result)

    @classmethod
    def _made(cls, fields: dict, *args, **options):
        """Of the values of a model, by the library of this machine."""
        data = c_values.Structure(f'{cls.PREFIX}model', fields)
        made = cls(library.load(), ctypes.addressof(data.value), *args, **options)
        made._data = data
        return made

    @classmethod
    def open(cls, path: str, symbol: str, **options):
        """A model of a shared library that an exported project built.

        Args:
          path: of the library.
          symbol: name of its model, `lts_...`.
          **options: of the constructor.

        Raises:
          ValueError: no such library, or no such model in it.
        """
        try:
            loaded = library.declared(ctypes.CDLL(path))
            model = ctypes.addressof(ctypes.c_char.in_dll(loaded, symbol))
        except (OSError, ValueError, AttributeError) as error:
            raise ValueError(f'{path}: no library of the model {symbol} ({error})') from error
        return cls(loaded, model, **options)

    def another(self):
        """Another run of the same model."""
        made = type(self)(self._c, self._model, self.kernel)
        made._data = self._data
        return made

    @property
    def description(self):
        """`lts_description` or `lts_field_description`: sizes, axes, digest."""
        return self._d

    @property
    def model(self) -> int:
        """Address of the model."""
        return self._model

    @property
    def address(self) -> int:
        """Of the instance, for calls of the headers that have no method here."""
        return self._soil  # type: ignore[return-value]

    @property
    def kernel(self) -> str:
        """Which arithmetic runs, one of `KERNELS`."""
        return KERNELS[self._function('kernel')(self._soil)]

    def particles(self) -> np.ndarray:
        """float32 [N, 3] of the soil in the newest frame, m.

        Raises:
          ValueError: before the start, or without a subspace.
        """
        if not self._d.n_soil:
            raise ValueError('particles need a subspace: the model has none')
        points = np.empty((self._d.n_soil, 3), np.float32)
        self._done(self._function('particles')(self._soil, points.ctypes.data, len(points)))
        return points

    def height_map(self, origin, cell: float, shape) -> np.ndarray:
        """Highest particle centre in each cell of a grid across the up axis.

        Args:
          origin: [2] outer corner of the first cell along the two other axes, m.
          cell: size of a cell, m.
          shape: (cells along the first axis, along the second).

        Returns:
          float32 `shape`, m; NaN where a cell holds no particle.

        Raises:
          ValueError: as `particles`, or a grid without cells.
        """
        if not self._d.n_soil:
            raise ValueError('a height map needs a subspace: the model has none')
        grid = library.structures()['lts_grid'](
            (ctypes.c_double * 2)(*numbers('origin', origin, (2,))),
            float(cell),
            (ctypes.c_int32 * 2)(*map(int, shape)),
        )
        if not (cell > 0 and min(grid.n) > 0):
            raise ValueError(f'a grid of {tuple(shape)} cells of {cell} m has no cells')
        heights = np.empty(tuple(grid.n), np.float32)
        at = ctypes.addressof(grid), heights.ctypes.data
        self._done(self._function('height_map')(self._soil, *at))
        return heights

    @property
    def judgement(self) -> Judgement:
        """As lts_judge: of a model in a subspace the worst since the start, of a field that of the
        newest frame."""
        found = library.structures()['lts_judgement']()
        status = self._done(self._function('judge')(self._soil, ctypes.addressof(found)))
        status, c = found.status or status, library.constants()
        if not found.status:
            return Judgement(RolloutStatus.OK)
        kind = RolloutStatus.EXTRAPOLATING
        if status & c['LTS_NON_FINITE']:
            kind = RolloutStatus.NON_FINITE
            return Judgement(kind, found.frame, found.node, 'a prediction is not finite')
        if status & c['LTS_LEFT_BOUNDS']:
            kind = RolloutStatus.LEFT_BOUNDS
        reason = f'{self._measure(found)} {found.value:.4g} is outside '
        reason += f'[{found.low:.4g}, {found.high:.4g}] of training'
        return Judgement(kind, found.frame, found.node, reason)

    @abc.abstractmethod
    def _measure(self, found):
        """What left its range."""

    def save(self) -> bytes:
        """The state, for `load_state`."""
        state = ctypes.create_string_buffer(self._state_size())
        self._done(self._function('save')(self._soil, state, len(state)))
        return state.raw

    def _state_size(self):
        return self._function('state_size')(self._model)

    def load_state(self, state: bytes) -> None:
        """Goes back to a saved state; what follows is the same bit by bit.

        Raises:
          ValueError: damaged bytes, or those of another model; the state stays as it was.
        """
        self._done(self._function('load')(self._soil, state, len(state)))

    def copy_state(self, other) -> None:
        """Takes over the state of another run of the same model.

        Raises:
          ValueError: a run of another model.
        """
        self._done(self._function('clone')(self._soil, other._soil))

    def _function(self, name):
        return getattr(self._c, self.PREFIX + name)

    def _done(self, code):
        """The code of a call, or its error."""
        if code < 0:
            raise ValueError(self._c.lts_error_text(code).decode())
        return code


def _at(array):
    """Address of an array; None for None."""
    return None if array is None else array.ctypes.data


class SubspaceResult(NamedTuple):
    """One frame of a model in a subspace.

    Attributes:
      modes: float64 [r, 3] scores, m.
      force: float32 [3] on the body, N, or None where the scene has no force.
      rigid_pose: float64 [R, 3] particles of the body that are nodes, m.
      status: bits of lts.h for this frame; 0 where all is well.
    """

    modes: np.ndarray
    force: np.ndarray | None
    rigid_pose: np.ndarray
    status: int


class CSubspace(CInstance):
    """One run of a model in a subspace; arguments as of `CInstance`."""

    def __init__(self, loaded: ctypes.CDLL, model: int, kernel: str = 'best'):
        super().__init__(loaded, model, kernel)
        d = self._d
        self._n, self._motion = d.n_rigid, _MOTIONS[d.motion]
        self._context_names = [name for name in d.context_names.decode().split(',') if name]
        # Every call reads from the same array: an address costs a microsecond.
        self._pose = np.empty((self._n, 3))
        self._at_pose = self._pose.ctypes.data

    @classmethod
    def of(
        cls, model, n_rigid: int, subspace=None, rigid_correction=True, starts=(), kernel='best'
    ) -> 'CSubspace':
        """Of a `subspace_model.Model`, with its weights as they are now.

        Args:
          model, n_rigid, subspace, rigid_correction, starts: of `model_data.values`.
          kernel: of `CInstance`.

        Raises:
          ValueError: as `model_data.values`; a kernel that this machine lacks.
          library.NoCompiler, library.CompileFailed: as `library.load`.
        """
        fields = model_data.values(model, n_rigid, subspace, rigid_correction, starts)
        return cls._made(fields, kernel)

    def reset(self, history, context=None) -> None:
        """Starts from the last H frames [H, R + r, 3], m, with a context [C] where there is one."""
        history = np.ascontiguousarray(
            numbers('history', history, (H, self._n + self._d.n_modes, 3))
        )
        self._done(self._c.lts_reset(self._soil, _at(history), _at(self._checked(context))))

    def _checked(self, context):
        names = self._context_names
        if (context is None) == bool(names):
            raise ValueError(f'the scene takes context {names}, got {context}')
        return numbers('context', context, (len(names),)) if names else None

    def start(self, start: int = 0, pose=None, twist=None, context=None) -> None:
        """Starts from soil at rest.

        Args:
          start: index of one of the starts; -1 takes the one whose context is nearest.
          pose: of the body, [7]: reference point, m, and rotation w, x, y, z from its attitude in
            the training run; None: where it was there.
          twist: [6], its motion so far: linear, m/s, and angular velocity, rad/s; None: at rest.
          context: [C]; None: that of the start.

        Raises:
          ValueError: no such start, wrong shape, values that are not finite, no rotation.
        """
        count = self._d.n_start
        if not -1 <= start < max(count, 1) or not count:
            raise ValueError(f'start is {start}, the model has {count} starts')
        pose, twist, context = (
            None if value is None else numbers(name, value, shape)
            for name, value, shape in (
                ('pose', pose, (7,)),
                ('twist', twist, (6,)),
                ('context', context, (len(self._context_names),)),
            )
        )
        self._done(self._c.lts_start(self._soil, start, _at(pose), _at(twist), _at(context)))

    def prepare(self) -> None:
        """Computes all of the coming frame that needs no pose, so that `step` answers sooner."""
        self._done(self._c.lts_prepare(self._soil))

    def set_context(self, context) -> None:
        """Gives the context [C] of the coming frame and those after it."""
        context = self._checked(context)
        if context is None:
            raise ValueError('the scene takes no context')
        self._done(self._c.lts_set_context(self._soil, _at(context)))

    def step(self, rigid_pose=None, context=None) -> SubspaceResult:
        """The next frame, with the body at particles [R, 3], m, where its motion is given."""
        if self._motion.is_known != (rigid_pose is not None):
            takes = 'takes' if rigid_pose is None else 'does not take'
            raise ValueError(f'the body is {self._motion}: step() {takes} a pose')
        at = None
        if rigid_pose is not None:
            self._pose[:] = numbers('rigid_pose', rigid_pose, self._pose.shape)
            at = self._at_pose
        if context is not None:
            self.set_context(context)
        self._done(self._c.lts_frame(self._soil, at, self._at_result))
        return self._newest()

    def step_at(self, pose) -> SubspaceResult:
        """The next frame of a body that was started by `start`, at a pose [7] as there."""
        pose = numbers('pose', pose, (7,))
        self._done(self._c.lts_frame_at(self._soil, _at(pose), self._at_result))
        return self._newest()

    def _newest(self):
        modes, points = np.empty((self._d.n_modes, 3)), np.empty((self._n, 3))
        self._c.lts_modes(self._soil, _at(modes))
        self._c.lts_points(self._soil, _at(points))
        force = np.array(self._result.force, np.float32) if self._d.has_force else None
        return SubspaceResult(modes, force, points, self._result.status)

    def _measure(self, found):
        c, axis = library.constants(), 'xyz'[found.axis] if found.axis >= 0 else ''
        if found.status == c['LTS_OUTSIDE_CONTEXT']:
            return self._context_names[found.axis]
        if found.node >= 0:
            moves = found.status == c['LTS_OUTSIDE_SPEED']
            return f'{"displacement" if moves else "coordinate"} {axis}'
        is_extent = found.status == c['LTS_OUTSIDE_POSE']
        return f'extent of the body {axis}' if is_extent else 'displacement of the body'


class FieldResult(NamedTuple):
    """One frame of a swept field.

    Attributes:
      force: float64 [3] on the tool, world, N.
      torque: float64 [3] about its reference point, N m.
      bound: N, root mean square per component that 95 % of frames like those of valid keep; None
        where the model was not calibrated.
      status: bits of lts.h; 0 where all is well.
      point: float64 [3] the tool's reference point, m; of a wheel with its predicted height.
    """

    force: np.ndarray
    torque: np.ndarray
    bound: float | None
    status: int
    point: np.ndarray


class CField(CInstance):
    """One run of a swept field.

    Args:
      loaded, model, kernel: of `CInstance`.
      members: networks that answer; None: all.
      particle_members: those that answer for the particles, where they are fewer.

    Raises:
      ValueError: as `CInstance`; no such members.
    """

    PREFIX = 'lts_field_'

    def __init__(
        self,
        loaded: ctypes.CDLL,
        model: int,
        kernel: str = 'best',
        members: int | None = None,
        particle_members: int | None = None,
    ):
        super().__init__(loaded, model, kernel)
        self._names = self._d.scalar_names.decode().split(',')
        self._is_wheel = self._d.tool == library.constants()['LTS_FIELD_WHEEL']
        of_force = self._d.n_member if members is None else members
        of_particles = of_force if particle_members is None else particle_members
        for name, count in (('members', of_force), ('particle_members', of_particles)):
            if not 1 <= count <= self._d.n_member:
                raise ValueError(f'{name} is {count}, must lie in [1, {self._d.n_member}]')
        self._members = of_force, of_particles
        self._done(loaded.lts_field_members(self._soil, of_force, of_particles))
        # Every call reads from the same array: an address costs a microsecond.
        self._pose = np.empty(7)
        self._at_pose = self._pose.ctypes.data

    @classmethod
    def of(cls, field, kernel: str = 'best', starts=None, subspace=None, **options) -> 'CField':
        """Of a `SweptField`, with its weights as they are now; `starts` and `subspace` of a wheel
        as of `field_data.values`.

        Raises:
          ValueError: inputs that C does not know; a wheel without starts.
          library.NoCompiler, library.CompileFailed: as `library.load`.
        """
        return cls._made(field_data.values(field, starts, subspace), kernel, **options)

    @classmethod
    def load(cls, model_path: str, **options) -> 'CField':
        """Of a model folder; raises as `field_data.read` and `of`."""
        field, parts = field_data.read(model_path)
        return cls.of(field, **parts, **options)

    def another(self) -> 'CField':
        """Another run of the same model, with as many members."""
        made = CField(self._c, self._model, self.kernel, *self._members)
        made._data = self._data
        return made

    def start(
        self,
        pose=None,
        velocity=None,
        bed=None,
        blade_width: float | None = None,
        index: int | None = None,
        context=None,
    ) -> Judgement:
        """Begins where the tool is; returns how the start is to be judged.

        Args:
          pose: [7] middle of the blade's lower edge, m, and its rotation w, x, y, z from upright;
            of a wheel its axle, None for that of the recorded start.
          velocity: [6] linear, m/s, and angular, rad/s; None: at rest.
          bed: None for the flat bed of the training; [N, 3] particles, m; or anything with `places`
            and `heights`, as a height map of the method. None of a wheel: that of its start.
          blade_width: m; None for the usual one.
          index: of a wheel, which of its recorded starts; None for the one whose context is
            nearest, or the first.
          context: [C] of a wheel; None for that of the start.

        Raises:
          ValueError: not a pose, a velocity, a bed, a width, a start or a context; the state stays
            as it was.
        """
        if pose is not None or not self._is_wheel:
            self._take(pose)
        width = 0.0 if blade_width is None else float(blade_width)
        if not (blade_width is None or 0 < width < np.inf and not self._is_wheel):
            raise ValueError(f'blade_width is {blade_width}, must be positive, and of a blade')
        twist = None if velocity is None else numbers('velocity', velocity, (6,))
        given = None if bed is None else self._bed(bed)
        at_bed = None if bed is None else ctypes.addressof(given)
        if not self._is_wheel:
            if index is not None or context is not None:
                raise ValueError('a blade has no recorded starts and no context')
            at = self._at_pose, _at(twist), at_bed
            self._done(self._c.lts_field_start(self._soil, *at, width))
            return self.judgement
        if index is not None and not 0 <= index < self._d.n_start:
            raise ValueError(f'start is {index}, must lie in [0, {self._d.n_start - 1}]')
        of_scene = None if context is None else self._read_context(context)
        at_pose = None if pose is None else self._at_pose
        at = at_pose, _at(twist), at_bed, _at(of_scene)
        self._done(self._c.lts_field_start_wheel(self._soil, -1 if index is None else index, *at))
        return self.judgement

    def start_of(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Pose [7] and context [C] of a recorded start of a wheel.

        Raises:
          ValueError: there is no such start.
        """
        pose, context = np.empty(7), np.empty(max(self._d.n_context, 1))
        self._done(self._c.lts_field_start_pose(self._model, index, _at(pose)))
        self._done(self._c.lts_field_start_context(self._model, index, _at(context)))
        return pose, context

    def _read_context(self, context):
        names = [name for name in self._d.context_names.decode().split(',') if name]
        if isinstance(context, dict):
            if set(context) != set(names):
                raise ValueError(f'context names {sorted(context)}, must name {names}')
            context = [context[name] for name in names]
        return numbers('context', context, (len(names),))

    def context(self) -> np.ndarray:
        """float64 [C] of a wheel in the newest frame."""
        found = np.empty(self._d.n_context)
        self._done(self._c.lts_field_context(self._soil, _at(found)))
        return found

    def renew(self) -> None:
        """Begins anew where the tool is, on the bed as the model now sees it."""
        self._done(self._c.lts_field_renew(self._soil))

    def _bed(self, bed):
        made = library.structures()['lts_field_bed']()
        if hasattr(bed, 'heights'):
            places, heights = (numbers(n, getattr(bed, n), (None,)) for n in ('places', 'heights'))
            if len(places) != len(heights) or len(places) < 2:
                raise ValueError(
                    f'a height map has {len(places)} places and {len(heights)} heights: two rows '
                    f'of one length of at least 2 were expected'
                )
            order = np.argsort(places)
            parts = {'places': places[order], 'heights': heights[order]}
            made.n = len(places)
        else:
            n = self._d.n_soil
            parts = {'particles': np.ascontiguousarray(numbers('bed', bed, (n, 3)), np.float32)}
        for name, array in parts.items():
            setattr(made, name, array.ctypes.data_as(dict(made._fields_)[name]))
        made.alive = parts
        return made

    def step(self, pose, dt: float | None = None, context=None) -> FieldResult:
        """Moves the tool in a straight line to its next pose.

        Args:
          pose: [7], see `start`; the height of a wheel is ignored.
          dt: s; None for the frame time of the training data.
          context: [C] or {name: value} of a wheel in the coming frame and those after it; only the
            load may change. None leaves it as it was.

        Raises:
          ValueError: before `start`; not a pose, a jump, a time that does not pass, a place beyond
            the bins or under the floor; another soil. The state stays as it was.
        """
        self._take(pose)
        if context is not None:
            return self._step_with(self._read_context(context), pose, dt)
        dt = self._d.dt if dt is None else float(dt)
        if not 0 < dt < np.inf:
            raise ValueError(f'dt is {dt} s: time must go on')
        self._done(self._c.lts_field_frame(self._soil, self._at_pose, dt, self._at_result))
        r = self._result
        bound = r.force_bound if self._d.has_bound else None
        return FieldResult(
            np.array(r.force), np.array(r.torque), bound, r.status, np.array(r.point)
        )

    def _step_with(self, context, pose, dt):
        """A step under another load, which a refused one puts back."""
        before = self.context()
        self._done(self._c.lts_field_set_context(self._soil, _at(context)))
        try:
            return self.step(pose, dt)
        except ValueError:
            self._done(self._c.lts_field_set_context(self._soil, _at(before)))
            raise

    def _take(self, pose):
        self._pose[:] = numbers('pose', pose, (7,))

    def moving(self) -> int:
        """How many particles may have moved; the others are left out, exactly."""
        return self._done(self._c.lts_field_moving(self._soil))

    def _measure(self, found):
        return self._names[found.axis]

    def _state_size(self):
        return self._c.lts_field_state_size(self._soil)
