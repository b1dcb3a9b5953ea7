"""`CSubspace`: one run of a model in a subspace by the C library, called by ctypes.

It is thin: what a user steps is a `live.stepper.Stepper` by an `engines.CStep`. Arguments of
methods are checked so far that C survives them; what has no method is reached by `CSubspace.call`.
"""

import ctypes
from typing import NamedTuple

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live.poses import numbers
from learning_to_simulate.native import c_values, library, model_data

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


class CSubspace:
    """One run of a model in a subspace, in memory of its own.

    Args:
      loaded: `library.declared` of a shared library.
      model: address of its `lts_model`.
      kernel: 'best', 'avx512', 'avx2', 'vector4' (SSE2, NEON) or 'scalar'.
      data: kept as long as the instance: what the model lies in.

    Attributes:
      description: `lts_description`: sizes, axes, digest.

    Raises:
      ValueError: a model of another ABI version, a kernel that this machine lacks.
    """

    def __init__(self, loaded: ctypes.CDLL, model: int, kernel: str = 'best', data=None):
        self._c, self._model, self._data = loaded, model, data
        self._soil = ctypes.c_void_p(model)  # what calls are about: until `init` the model
        self.description = self._structure('description')
        self.call('describe', ctypes.byref(self.description))
        if kernel not in ('best', *KERNELS):
            raise ValueError(f'kernel is {kernel!r}, must be best, {", ".join(KERNELS)}')
        self._memory = np.empty(self._function('size')(model), np.uint8)
        code, soil = library.constants()[f'LTS_{kernel.upper()}'], ctypes.c_void_p()
        try:
            self.call('init', self._memory, self._memory.nbytes, code, ctypes.byref(soil))
        except ValueError:
            raise ValueError(f'this machine lacks kernel {kernel!r}') from None
        self._soil = soil
        self._result = self._structure('result')
        self._n, self._n_modes = self.description.n_rigid, self.description.n_modes
        self._names = list(filter(None, self.description.context_names.decode().split(',')))

    @classmethod
    def of(cls, model, n_rigid: int, kernel: str = 'best', **options) -> 'CSubspace':
        """Of a `subspace_model.Model`, with its weights as they are now; raises as
        `model_data.values`, whose options are taken, and `library.load`."""
        data = c_values.Structure('lts_model', model_data.values(model, n_rigid, **options))
        return cls(library.load(), ctypes.addressof(data.value), kernel, data)

    @classmethod
    def open(cls, path: str, symbol: str, kernel: str = 'best') -> 'CSubspace':
        """A model `lts_...` of a shared library that an exported project built; ValueError where
        there is none."""
        try:
            loaded = library.declared(ctypes.CDLL(path))
            model = ctypes.addressof(ctypes.c_char.in_dll(loaded, symbol))
        except (OSError, ValueError, AttributeError) as error:
            raise ValueError(f'{path}: no library of the model {symbol} ({error})') from error
        return cls(loaded, model, kernel)

    def another(self):
        """Another run of the same model."""
        return type(self)(self._c, self._model, self.kernel, self._data)

    @property
    def kernel(self) -> str:
        """Which arithmetic runs, one of `KERNELS`."""
        return KERNELS[self.call('kernel')]

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

    def save(self) -> bytes:
        """The state, for `load_state`."""
        state = ctypes.create_string_buffer(self._c.lts_state_size(self._model))
        self.call('save', state, len(state))
        return state.raw

    def load_state(self, state: bytes) -> None:
        """Goes back to a saved state; what follows is the same bit by bit. ValueError for damaged
        bytes, or those of another model: the state stays as it was."""
        self.call('load', state, len(state))

    def copy_state(self, other) -> None:
        """Takes over the state of another run of the same model."""
        self.call('clone', other._soil)

    def call(self, name: str, *values) -> int:
        """Calls a function `lts_<name>` of the headers on this run with further numbers, arrays of
        the type that C has, or None for null; returns its code. ValueError: an error of lts.h, in
        its words."""
        kept = [np.ascontiguousarray(x) if isinstance(x, np.ndarray) else x for x in values]
        # Addresses, since numpy takes microseconds to make a ctypes pointer.
        given = [x.ctypes.data if isinstance(x, np.ndarray) else x for x in kept]
        code = self._function(name)(self._soil, *given)
        if code < 0:
            raise ValueError(self._c.lts_error_text(code).decode())
        return code

    def _structure(self, name):
        return library.structures()[f'lts_{name}']()

    def _function(self, name):
        return getattr(self._c, f'lts_{name}')
