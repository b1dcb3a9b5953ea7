"""Models in C, called by ctypes: `Loaded`, a model in a library; `Instance`, a run of it; and
`CSubspace`, that of a model in a subspace, by which a `live.stepper.Stepper` steps.

Arguments of methods are checked so far that C survives them; what has no method is reached by
`Instance.call`.
"""

import ctypes
from typing import NamedTuple

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live.poses import numbers
from learning_to_simulate.native import c_values, library, model_data, project

KERNELS = ('scalar', 'vector4', 'avx2', 'avx512')


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


class Loaded:
    """A model in a shared library, and the kernel of its instances.

    Args:
      c: `library.declared` of a shared library.
      model: address of its `lts_model` or `lts_soil_model`.
      kernel: 'best', 'avx512', 'avx2', 'vector4' (SSE2, NEON) or 'scalar'; else ValueError.
      data: kept as long as the instance: what the model lies in.
    """

    def __init__(self, c: ctypes.CDLL, model: int, kernel: str = 'best', data=None):
        if kernel not in ('best', *KERNELS):
            raise ValueError(f'kernel is {kernel!r}, must be best, {", ".join(KERNELS)}')
        self.c, self.model, self.kernel, self._data = c, model, kernel, data

    @classmethod
    def of(cls, values: dict, kernel: str = 'best') -> 'Loaded':
        """Of `model_data.values` or `soil_data.values`, by the library of this machine; raises as
        `library.load`."""
        kind = 'lts_soil_model' if project.is_soil(values) else 'lts_model'
        data = c_values.Structure(kind, values)
        return cls(library.load(), ctypes.addressof(data.value), kernel, data)

    @classmethod
    def open(cls, path: str, symbol: str, kernel: str = 'best') -> 'Loaded':
        """A model `lts_...` of a shared library that an exported project built; ValueError where
        there is none."""
        try:
            c = library.declared(ctypes.CDLL(path))
            model = ctypes.addressof(ctypes.c_char.in_dll(c, symbol))
        except (OSError, ValueError, AttributeError) as error:
            raise ValueError(f'{path}: no library of the model {symbol} ({error})') from error
        return cls(c, model, kernel)


class Instance:
    """One run of a model in memory of its own.

    Args:
      loaded: `Loaded`.
      of: what `lts_init` of the headers takes beside the model.

    Raises:
      ValueError: what C refuses, in its words, or a kernel that this machine lacks.
    """

    _prefix = 'lts'  # of the names of functions

    def __init__(self, loaded: Loaded, *of):
        self.loaded, given, c = loaded, (loaded.model, *of), library.constants()
        size, soil = self.function('size')(*given), ctypes.c_void_p()
        self._memory = np.empty(max(size, 1), np.uint8)
        room = self._memory.ctypes.data, size, c[f'LTS_{loaded.kernel.upper()}']
        code = self.function('init')(*given, *room, ctypes.byref(soil))
        if size and code == c['LTS_ERROR_VALUE']:  # all else has been found good
            raise ValueError(f'this machine lacks kernel {loaded.kernel!r}')
        self.check(code)
        self.soil = soil.value

    def function(self, name: str):
        """A function of the headers, by its name without the prefix."""
        return getattr(self.loaded.c, f'{self._prefix}_{name}')

    def check(self, code: int) -> int:
        """Raises ValueError for a code that is an error of lts.h, in its words."""
        if code < 0:
            raise ValueError(self.loaded.c.lts_error_text(code).decode())
        return code

    def call(self, name: str, *values) -> int:
        """Calls a function on this run with further numbers, arrays of the type that C has, or None
        for null; returns its code, and raises as `check`."""
        kept = [np.ascontiguousarray(x) if isinstance(x, np.ndarray) else x for x in values]
        # Addresses, since numpy takes microseconds to make a ctypes pointer.
        given = [x.ctypes.data if isinstance(x, np.ndarray) else x for x in kept]
        return self.check(self.function(name)(self.soil, *given))

    @property
    def kernel(self) -> str:
        """Which arithmetic runs, one of `KERNELS`."""
        return KERNELS[self.call('kernel')]


class CSubspace(Instance):
    """A run of a model in a subspace, by a `Loaded` one: a step of `live.stepper.Stepper`, with the
    frames of `live.stepper.TfStep`.

    Attributes:
      description: `lts_description`: sizes, axes, digest.

    Raises:
      ValueError: a model of another ABI version, a kernel that this machine lacks.
    """

    _before: 'CSubspace | None' = None  # the state that a proposal left behind
    _is_proposed = False

    def __init__(self, loaded: Loaded):
        super().__init__(loaded)
        self.description, self._result = (
            library.structures()[f'lts_{name}']() for name in ('description', 'result')
        )
        self.check(self.function('describe')(loaded.model, ctypes.byref(self.description)))
        self._n, self._n_modes = self.description.n_rigid, self.description.n_modes
        self._names = list(filter(None, self.description.context_names.decode().split(',')))

    @classmethod
    def of(cls, model, n_rigid: int, kernel: str = 'best', **options) -> 'CSubspace':
        """Of a `subspace_model.Model`, with its weights as they are now; raises as
        `model_data.values`, whose options are taken, and `library.load`."""
        return cls(Loaded.of(model_data.values(model, n_rigid, **options), kernel))

    def particles(self) -> np.ndarray:
        """float32 [N, 3] of the soil in the newest frame, m; ValueError before the start, or
        without a subspace."""
        if not self.description.n_soil:
            raise ValueError('particles need a subspace: the model has none')
        points = np.empty((self.description.n_soil, 3), np.float32)
        self.call('particles', points, len(points))
        return points

    def reset(self, history, context=None) -> None:
        """Starts from the last H frames [H, R + r, 3], m, with a context [C] where there is one."""
        history = numbers('history', history, (H, self._n + self._n_modes, 3))
        self.call('reset', history, self._context(context))
        self._is_proposed = False

    def _context(self, context):
        if (context is None) == bool(self._names):
            raise ValueError(f'the scene takes context {self._names}, got {context}')
        return None if context is None else numbers('context', context, (len(self._names),))

    def step(self, rigid_pose=None, context=None) -> SubspaceResult:
        """The next frame, with the body at particles [R, 3], m, where its motion is given."""
        if context is not None:
            self.call('set_context', self._context(context))
        if rigid_pose is not None:
            rigid_pose = numbers('rigid_pose', rigid_pose, (self._n, 3))
        return self._newest(self.call('frame', rigid_pose, ctypes.byref(self._result)))

    def _newest(self, status):
        modes, points = np.empty((self._n_modes, 3)), np.empty((self._n, 3))
        self.call('modes', modes)
        self.call('points', points)
        has_force = self.description.has_force
        force = np.array(self._result.force, np.float32) if has_force else None
        return SubspaceResult(modes, force, points, status)

    def propose(self, body, displacement, context=None):
        """As of `TfStep`; the displacement is not needed: the library keeps the body of the last
        frame."""
        del displacement
        if self._before is None:
            self._before = type(self)(self.loaded)
        if self._is_proposed:
            self.call('clone', self._before.soil)
        else:
            self._before.call('clone', self.soil)
        self._is_proposed = True
        frame = self.step(body, context)
        return np.concatenate([frame.rigid_pose, frame.modes]), frame.force

    def accept(self) -> None:
        """As of `TfStep`."""
        self._is_proposed = False

    def clone(self) -> 'CSubspace':
        """As of `TfStep`."""
        other = type(self)(self.loaded)
        other.call('clone', (self._before if self._is_proposed and self._before else self).soil)
        return other
