"""What the two kinds of models of the C library have in common, called by ctypes."""

import ctypes

import numpy as np

from learning_to_simulate.export_c import c_header, c_library
from learning_to_simulate.live.poses import numbers

KERNELS = ('scalar', 'vector4', 'avx2', 'avx512')


class KernelLacks(ValueError):
    """This machine lacks the instructions of a kernel."""


class CInstance:
    """One run of a model, in memory of its own.

    Args:
      library: `c_library.declared` of a shared library.
      model: address of its `lts_model` or `lts_field_model`.
      kernel: 'best', 'avx512', 'avx2', 'vector4' (SSE2, NEON) or 'scalar'.

    Raises:
      ValueError: a model of another ABI version, a kernel that this machine lacks.
    """

    PREFIX = 'lts_'  # of the functions and structures of its kind

    def __init__(self, library: ctypes.CDLL, model: int, kernel: str = 'best'):
        self._c, self._model = library, model
        self._d = c_header.structures()[f'{self.PREFIX}description']()
        self._done(self._function('describe')(model, ctypes.addressof(self._d)))
        if kernel not in ('best', *KERNELS):
            raise ValueError(f'kernel is {kernel!r}, must be best, {", ".join(KERNELS)}')
        self._memory = np.empty(self._function('size')(model), np.uint8)
        soil = ctypes.c_void_p()
        code = self._function('init')(
            model,
            self._memory.ctypes.data,
            self._memory.nbytes,
            c_header.constants()[f'LTS_{kernel.upper()}'],
            ctypes.byref(soil),
        )
        if code < 0:
            raise KernelLacks(f'this machine lacks kernel {kernel!r}')
        self._soil = soil.value
        self._result = c_header.structures()[f'{self.PREFIX}result']()
        # Every call uses the same structure: an address costs a microsecond.
        self._at_result = ctypes.addressof(self._result)

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
            library = c_library.declared(ctypes.CDLL(path))
            model = ctypes.addressof(ctypes.c_char.in_dll(library, symbol))
        except (OSError, ValueError, AttributeError) as error:
            raise ValueError(f'{path}: no library of the model {symbol} ({error})') from error
        return cls(library, model, **options)

    @property
    def description(self):
        """`lts_description` or `lts_field_description`: sizes, axes, digest."""
        return self._d

    @property
    def model(self) -> int:
        """Address of the model, for another run of it."""
        return self._model

    @property
    def address(self) -> int:
        """Of the instance, for calls of the headers that have no method here."""
        return self._soil

    @property
    def kernel(self) -> str:
        """Which arithmetic runs, one of `KERNELS`."""
        return KERNELS[self._function('kernel')(self._soil)]

    def particles(self) -> np.ndarray:
        """float32 [N, 3] of the soil in the newest frame, m.

        Raises:
          ValueError: before the start.
        """
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
        grid = c_header.structures()['lts_grid'](
            (ctypes.c_double * 2)(*numbers('origin', origin, (2,))),
            float(cell),
            (ctypes.c_int32 * 2)(*map(int, shape)),
        )
        if not (cell > 0 and min(grid.n) > 0):
            raise ValueError(f'a grid of {tuple(shape)} cells of {cell} m has no cells')
        heights = np.empty(tuple(grid.n), np.float32)
        self._done(
            self._function('height_map')(
                self._soil, ctypes.addressof(grid), heights.ctypes.data
            )
        )  # fmt: skip
        return heights

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
