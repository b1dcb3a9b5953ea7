"""`CSoil`: a model of the C library, called by ctypes."""

import ctypes
from typing import NamedTuple

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.export_c import c_header
from learning_to_simulate.export_c.c_instance import CInstance
from learning_to_simulate.live.poses import numbers
from learning_to_simulate.rollout_status import Judgement, RolloutStatus
from learning_to_simulate.scene import RigidMotion

_MOTIONS = (RigidMotion.NONE, RigidMotion.PRESCRIBED, RigidMotion.DRIVEN, RigidMotion.PREDICTED)
_CHECKS = {
    'LTS_OUTSIDE_START': 'coordinate',
    'LTS_OUTSIDE_POSE': 'coordinate',
    'LTS_OUTSIDE_SPEED': 'displacement',
    'LTS_LEFT_BOUNDS': 'coordinate',
}


class Frame(NamedTuple):
    """One predicted frame.

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


def _checked(name, values, shape):
    """As `poses.numbers`, in the order of C."""
    return np.ascontiguousarray(numbers(name, values, shape))


class CSoil(CInstance):
    """One run of a model of the C library.

    Args:
      library: `c_library.declared` of a shared library.
      model: address of its `lts_model`.
      kernel: 'best', 'avx512', 'avx2', 'vector4' (SSE2, NEON) or 'scalar'.

    Raises:
      ValueError: a model of another ABI version, a kernel that this machine lacks.
    """

    def __init__(self, library: ctypes.CDLL, model: int, kernel: str = 'best'):
        super().__init__(library, model, kernel)
        d = self._d
        self._n, self._n_modes, self._has_force = d.n_rigid, d.n_modes, d.has_force
        self._motion = _MOTIONS[d.motion]
        names = d.context_names.decode()
        self._context_names = tuple(names.split(',')) if names else ()
        # Every call reads from the same array: an address costs a microsecond.
        self._pose = np.empty((self._n, 3))
        self._at_pose = self._pose.ctypes.data
        self._started = False

    @property
    def n_soil(self) -> int:
        """N; 0 without a subspace."""
        return self._d.n_soil

    @property
    def digest(self) -> str:
        """sha256 of all numbers of the model."""
        return self._d.digest.decode()

    def reset(self, history, context=None) -> None:
        """Starts from the last H frames; as `stepping.Stepper.reset`."""
        history = _checked('history', history, (H, self._n + self._n_modes, 3))
        context = self._checked_context(context)
        self._done(
            self._c.lts_reset(
                self._soil, history.ctypes.data, None if context is None else context.ctypes.data
            )
        )
        self._started = True

    def _checked_context(self, context):
        names = self._context_names
        if (context is None) == bool(names):
            raise ValueError(f'the scene takes context {list(names)}, got {context}')
        return _checked('context', context, (len(names),)) if names else None

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
            None if value is None else _checked(name, value, shape)
            for name, value, shape in (
                ('pose', pose, (7,)),
                ('twist', twist, (6,)),
                ('context', context, (len(self._context_names),)),
            )
        )
        at = [None if v is None else v.ctypes.data for v in (pose, twist, context)]
        self._done(self._c.lts_start(self._soil, start, *at))
        self._started = True

    def prepare(self) -> None:
        """Computes all of the coming frame that needs no pose, so that `step` answers sooner."""
        self._require_start('prepare')
        self._done(self._c.lts_prepare(self._soil))

    def set_context(self, context) -> None:
        """Gives the context [C] of the coming frame and those after it."""
        self._require_start('set_context')
        context = self._checked_context(context)
        if context is None:
            raise ValueError('the scene takes no context')
        self._done(self._c.lts_set_context(self._soil, context.ctypes.data))

    def step(self, rigid_pose=None, context=None) -> Frame:
        """Predicts the next frame; as `stepping.Stepper.step`."""
        self._require_start('step')
        if self._motion.is_known != (rigid_pose is not None):
            takes = 'takes' if rigid_pose is None else 'does not take'
            raise ValueError(f'the body is {self._motion}: step() {takes} a pose')
        at = None
        if rigid_pose is not None:
            self._pose[:] = _checked('rigid_pose', rigid_pose, self._pose.shape)
            at = self._at_pose
        if context is not None:
            self.set_context(context)
        self._done(self._c.lts_frame(self._soil, at, self._at_result))
        return self._newest()

    def step_at(self, pose) -> Frame:
        """The next frame of a body that was started by `start`, at a pose [7] as there."""
        self._require_start('step_at')
        pose = _checked('pose', pose, (7,))
        self._done(self._c.lts_frame_at(self._soil, pose.ctypes.data, self._at_result))
        return self._newest()

    def _require_start(self, name):
        if not self._started:
            raise ValueError(f'call reset() with the first frames before {name}()')

    def _newest(self):
        modes, points = np.empty((self._n_modes, 3)), np.empty((self._n, 3))
        self._c.lts_modes(self._soil, modes.ctypes.data)
        self._c.lts_points(self._soil, points.ctypes.data)
        force = np.array(self._result.force, np.float32) if self._has_force else None
        return Frame(modes, force, points, self._result.status)

    def particles(self) -> np.ndarray:
        """As `CInstance.particles`; raises ValueError without a subspace, too."""
        self._require_soil('particles')
        return super().particles()

    def height_map(self, origin, cell: float, shape) -> np.ndarray:
        """As `CInstance.height_map`; raises as `particles`."""
        self._require_soil('height_map')
        return super().height_map(origin, cell, shape)

    def _require_soil(self, name):
        if not self.n_soil or not self._started:
            missing = 'reset()' if self.n_soil else 'a subspace'
            raise ValueError(f'{name}() needs {missing} first')

    @property
    def judgement(self) -> Judgement:
        """The worst that has held since the start, as `rollout_status.judge` of the same frames."""
        self._require_start('judgement')
        found = c_header.structures()['lts_judgement']()
        self._c.lts_judge(self._soil, ctypes.addressof(found))
        constants = c_header.constants()
        if not found.status:
            return Judgement(RolloutStatus.OK)
        if found.status == constants['LTS_NON_FINITE']:
            what = 'force' if found.node < 0 else 'position'
            return Judgement(
                RolloutStatus.NON_FINITE, found.frame, found.node, f'{what} is not finite'
            )
        status = RolloutStatus.EXTRAPOLATING
        if found.status == constants['LTS_LEFT_BOUNDS']:
            status = RolloutStatus.LEFT_BOUNDS
        limits = f'{found.value:.4g}{{0}} is outside [{found.low:.4g}, {found.high:.4g}]'
        if found.status == constants['LTS_OUTSIDE_CONTEXT']:
            name = self._context_names[found.axis]
            return Judgement(status, found.frame, -1, f'{name} {limits.format("")} of training')
        what = next(text for name, text in _CHECKS.items() if constants[name] == found.status)
        if found.node < 0:
            extent = found.status == constants['LTS_OUTSIDE_POSE']
            what = 'extent of the body' if extent else 'displacement of the body'
        axis = 'xyz'[found.axis] if found.axis >= 0 else ''
        return Judgement(
            status,
            found.frame,
            found.node,
            f'{what} {axis} '.replace('  ', ' ') + limits.format(' m') + ' m',
        )

    def copy_state(self, other: 'CSoil') -> None:
        """As `CInstance.copy_state`, and whether it was started."""
        super().copy_state(other)
        self._started = other._started

    def load_state(self, state: bytes) -> None:
        """As `CInstance.load_state`; a state is of a run that was started."""
        super().load_state(state)
        self._started = True
