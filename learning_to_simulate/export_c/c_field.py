"""`CField`: a swept field of the C library, called by ctypes.

Example:
    soil = CField.load('models/excavation/swept_field')
    soil.start(pose)
    frame = soil.step(next_pose)         # force, torque, bound, status; no particle is computed
    points = soil.particles()            # only where they are asked for

A wheel begins where a recorded one stood: `start(index=..., context=...)`, then `step(pose,
context=...)`; `frame.point` is its axle, with the height that was predicted.
"""

import ctypes
from typing import NamedTuple

import numpy as np

from learning_to_simulate.export_c import c_header, c_library, c_values, field_data
from learning_to_simulate.export_c.c_instance import CInstance
from learning_to_simulate.live.poses import numbers
from learning_to_simulate.rollout_status import Judgement, RolloutStatus


class FieldFrame(NamedTuple):
    """One frame.

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
      library: `c_library.declared` of a shared library.
      model: address of its `lts_field_model`.
      kernel: 'best' or one of `c_instance.KERNELS`.
      members: networks that answer; None: all.
      particle_members: those that answer for the particles, where they are fewer.

    Raises:
      ValueError: a model of another ABI version, a kernel that this machine lacks, no such members.
    """

    PREFIX = 'lts_field_'

    def __init__(
        self,
        library,
        model: int,
        kernel: str = 'best',
        members: int | None = None,
        particle_members: int | None = None,
    ):
        super().__init__(library, model, kernel)
        self._names = self._d.scalar_names.decode().split(',')
        self._is_wheel = self._d.tool == c_header.constants()['LTS_FIELD_WHEEL']
        of_force = self._d.n_member if members is None else members
        of_particles = of_force if particle_members is None else particle_members
        for name, count in (('members', of_force), ('particle_members', of_particles)):
            if not 1 <= count <= self._d.n_member:
                raise ValueError(f'{name} is {count}, must lie in [1, {self._d.n_member}]')
        self._done(library.lts_field_members(self._soil, of_force, of_particles))
        # Every call reads from the same array: an address costs a microsecond.
        self._pose = np.empty(7)
        self._at_pose = self._pose.ctypes.data
        self._data = None

    @classmethod
    def of(cls, field, kernel: str = 'best', starts=None, subspace=None, **options) -> 'CField':
        """Of a `SweptField`, with its weights as they are now; `starts` and `subspace` of a wheel
        as of `field_data.values`.

        Raises:
          ValueError: inputs that C does not know; a wheel without starts.
          c_library.NoCompiler, c_library.CompileFailed: as `c_library.load`.
        """
        values = field_data.values(field, starts, subspace)
        data = c_values.Structure('lts_field_model', values)
        made = cls(c_library.load(), ctypes.addressof(data.value), kernel, **options)
        made._data = data
        return made

    @classmethod
    def load(cls, model_path: str, **options) -> 'CField':
        """Of a model folder; raises as `swept_field.field.load` and `of`."""
        field, parts = field_data.read(model_path)
        return cls.of(field, **parts, **options)

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
        at_twist = None if twist is None else twist.ctypes.data
        at_bed = None if bed is None else ctypes.addressof(given)
        if not self._is_wheel:
            if index is not None or context is not None:
                raise ValueError('a blade has no recorded starts and no context')
            self._done(self._c.lts_field_start(self._soil, self._at_pose, at_twist, at_bed, width))
            return self.judgement
        if index is not None and not 0 <= index < self._d.n_start:
            raise ValueError(f'start is {index}, must lie in [0, {self._d.n_start - 1}]')
        values = None if context is None else self._read_context(context)
        self._done(
            self._c.lts_field_start_wheel(
                self._soil,
                -1 if index is None else index,
                None if pose is None else self._at_pose,
                at_twist,
                at_bed,
                None if values is None else values.ctypes.data,
            )
        )
        return self.judgement

    def start_of(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Pose [7] and context [C] of a recorded start of a wheel.

        Raises:
          ValueError: there is no such start.
        """
        pose, context = np.empty(7), np.empty(max(self._d.n_context, 1))
        self._done(self._c.lts_field_start_pose(self._model, index, pose.ctypes.data))
        self._done(self._c.lts_field_start_context(self._model, index, context.ctypes.data))
        return pose, context

    def _read_context(self, context):
        names = [name for name in self._d.context_names.decode().split(',') if name]
        if isinstance(context, dict):
            if set(context) != set(names):
                raise ValueError(f'context names {sorted(context)}, must name {names}')
            context = [context[name] for name in names]
        return numbers('context', context, (len(names),))

    def renew(self) -> None:
        """Begins anew where the tool is, on the bed as the model now sees it."""
        self._done(self._c.lts_field_renew(self._soil))

    def _bed(self, bed):
        made = c_header.structures()['lts_field_bed']()
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

    def step(self, pose, dt: float | None = None, context=None) -> FieldFrame:
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
        return FieldFrame(np.array(r.force), np.array(r.torque), bound, r.status, np.array(r.point))

    def _step_with(self, context, pose, dt):
        """A step under another load, which a refused one puts back."""
        before = np.empty(context.shape)
        self._done(self._c.lts_field_context(self._soil, before.ctypes.data))
        self._done(self._c.lts_field_set_context(self._soil, context.ctypes.data))
        try:
            return self.step(pose, dt)
        except ValueError:
            self._done(self._c.lts_field_set_context(self._soil, before.ctypes.data))
            raise

    def _take(self, pose):
        self._pose[:] = numbers('pose', pose, (7,))

    def moving(self) -> int:
        """How many particles may have moved; the others are left out, exactly."""
        return self._done(self._c.lts_field_moving(self._soil))

    @property
    def judgement(self) -> Judgement:
        """Of the newest frame."""
        found = c_header.structures()['lts_judgement']()
        status = self._done(self._c.lts_field_judge(self._soil, ctypes.addressof(found)))
        if not status:
            return Judgement(RolloutStatus.OK)
        if status & c_header.constants()['LTS_NON_FINITE']:
            return Judgement(RolloutStatus.NON_FINITE, found.frame, -1, 'the load is not finite')
        return Judgement(
            RolloutStatus.EXTRAPOLATING,
            found.frame,
            -1,
            f'{self._names[found.axis]} {found.value:.4g} is outside '
            f'[{found.low:.4g}, {found.high:.4g}] of training',
        )

    def _state_size(self):
        return self._c.lts_field_state_size(self._soil)
