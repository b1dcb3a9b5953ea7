"""Numpy arrays in pickles, read through an unpickler that admits nothing else.

They are the authors' PCA side files, and the object arrays of geoelements' `.npz`.

This is the only place of the project that reads pickles. A pickle is a program: the stock loader
would run whatever it names. Here the opcodes are gone through first: only those that numpy's arrays
need, and no place in the unpickler's memory beyond what the file can fill. Names lead to stand-ins
of this file that only take notes and cannot be changed; every other name ends the reading. Not even
numpy's own functions are called: `dtype.__setstate__` takes flags with which an array of numbers is
handled as an array of pointers.
"""

import io
import os
import pickle
import pickletools
import re
from typing import Any

import numpy as np

from pca_tools import files

EIGENVALUES_NAME = 'pca_eigen_values.pkl'
EIGENVECTORS_NAME = 'pca_eigen_vectors.pkl'

_NUMBER_TYPE = re.compile('[fiuc](1|2|4|8|16)')
# What numpy's pickles of arrays, scalars and tuples or lists of them are made of.
_OPCODES = frozenset((
    'PROTO', 'FRAME', 'STOP', 'MARK', 'POP', 'POP_MARK', 'GLOBAL', 'STACK_GLOBAL', 'REDUCE',
    'BUILD', 'EMPTY_TUPLE', 'TUPLE', 'TUPLE1', 'TUPLE2', 'TUPLE3', 'EMPTY_LIST', 'APPEND',
    'APPENDS', 'LIST', 'NONE', 'NEWTRUE', 'NEWFALSE', 'INT', 'BININT', 'BININT1', 'BININT2',
    'LONG', 'LONG1', 'BINFLOAT', 'FLOAT', 'UNICODE', 'BINUNICODE', 'SHORT_BINUNICODE', 'STRING',
    'BINSTRING', 'SHORT_BINSTRING', 'BINBYTES', 'SHORT_BINBYTES', 'BINBYTES8', 'PUT', 'BINPUT',
    'LONG_BINPUT', 'MEMOIZE', 'GET', 'BINGET', 'LONG_BINGET',
))  # fmt: skip
_PUTS = ('PUT', 'BINPUT', 'LONG_BINPUT')
# Of arrays in object arrays in object arrays.
_MAX_DEPTH = 4


class _Fixed(type):
    """A class whose attributes a pickle cannot set (`BUILD` on the class itself)."""

    def __setattr__(cls, name, value):
        raise ValueError(f'sets {name} of a class')


class _Type(metaclass=_Fixed):
    """Stands in for numpy.dtype: notes its name and its byte order."""

    __slots__ = ('name', 'order')

    def __init__(self, name, *_):
        self.name, self.order = name, '='

    def __setstate__(self, state):
        self.order = state[1]

    def dtype(self) -> np.dtype:
        if not isinstance(self.name, str) or not _NUMBER_TYPE.fullmatch(self.name):
            raise ValueError(f'holds {self.name!r}, numbers were expected')
        if self.order not in ('<', '>', '=', '|'):
            raise ValueError(f'has byte order {self.order!r}')
        return np.dtype(self.order + self.name)


class _Array(metaclass=_Fixed):
    """Stands in for numpy's `_reconstruct`, `scalar` and what these make: notes what it is given.

    A scalar is called with its type and its bytes; an array gets a state: version, shape, type,
    whether its order is Fortran's, bytes (or a list of objects).
    """

    __slots__ = ('arguments', 'state')

    def __init__(self, *arguments):
        self.arguments, self.state = arguments, None

    def __setstate__(self, state):
        self.state = state

    def array(self) -> np.ndarray:
        if self.state is None:
            (kind, data), shape, fortran = self.arguments, (), False
        else:
            _, shape, kind, fortran, data = self.state
        if not isinstance(kind, _Type) or not isinstance(data, bytes):
            raise ValueError('is not an array of numbers')
        # Raises where the bytes do not fit the shape.
        return np.ndarray(shape, kind.dtype(), bytearray(data), order='F' if fortran else 'C')


_ADMITTED = {('numpy', 'ndarray'): _Array, ('numpy', 'dtype'): _Type} | {
    (module, name): _Array
    for module in ('numpy.core.multiarray', 'numpy._core.multiarray')
    for name in ('_reconstruct', 'scalar')
}


class _ArrayUnpickler(pickle.Unpickler):
    """Admits the names of numpy's array pickles, as stand-ins, and nothing else."""

    def find_class(self, module: str, name: str):
        try:
            return _ADMITTED[module, name]
        except KeyError:
            raise ValueError(f'names {module}.{name}, which is not a numpy array') from None


def soil_particles(folder: str) -> int | None:
    """N of a folder of the authors, whose file holds one eigenvalue a particle; None without it."""
    path = os.path.join(folder, EIGENVALUES_NAME)
    return int(np.size(read_array(path))) if os.path.exists(path) else None


def read_array(path: str) -> np.ndarray:
    """Reads a pickled numpy array or scalar of numbers. FileNotFoundError: there is no such file.
    ValueError: git-lfs pointer, empty or damaged file, or a pickle of anything else."""
    files.refuse_git_lfs_pointer(path)
    size = os.path.getsize(path)
    if size > files.MAX_BYTES:
        raise ValueError(f'{path}: has {size} bytes, the limit is {files.MAX_BYTES}')
    with open(path, 'rb') as file:
        data = file.read()
    try:
        noted = _load(data)
        if not isinstance(noted, _Array):
            raise ValueError(f'holds {type(noted).__name__}')
        return noted.array()
    except Exception as error:  # a damaged pickle fails in many ways, none of which is ours
        raise ValueError(f'{path}: is not a pickled numpy array of numbers: {error}') from error


def parse_objects(data: bytes, where: str) -> Any:
    """Parses the pickle behind the header of a `.npy` member of type object: nested lists and
    tuples of numpy arrays of numbers, and plain numbers; an object array becomes a list, one of two
    axes a list of lists. Anything else in it is a ValueError with `where`, which names file and
    member."""
    try:
        return _plain(_load(data), 0)
    except Exception as error:  # as in read_array
        raise ValueError(f'{where}: is not an array of numpy arrays: {error}') from error


def _load(data: bytes) -> Any:
    _scan(data)
    return _ArrayUnpickler(io.BytesIO(data)).load()


def _scan(data: bytes) -> None:
    """Raises unless the pickle uses admitted opcodes and fills its memory place by place."""
    filled = 0
    for opcode, argument, _ in pickletools.genops(data):
        if opcode.name not in _OPCODES:
            raise ValueError(f'uses {opcode.name}, which no numpy array needs')
        if opcode.name in _PUTS:
            # The unpickler makes room for every place up to the one that is named.
            if int(argument) > filled:
                raise ValueError(f'fills place {argument} of its memory after {filled} others')
            filled += 1
        elif opcode.name == 'MEMOIZE':
            filled += 1


def _plain(noted: Any, depth: int) -> Any:
    if depth > _MAX_DEPTH:
        raise ValueError('is nested too deeply')
    if isinstance(noted, _Array) and noted.state is not None and len(noted.state) == 5:
        _, shape, kind, _, items = noted.state
        if isinstance(items, list):
            if not isinstance(kind, _Type) or not str(kind.name).startswith('O'):
                raise ValueError('is not an array of objects')
            return _shaped([_plain(item, depth + 1) for item in items], shape)
    if isinstance(noted, _Array):
        return noted.array()
    if isinstance(noted, (list, tuple)):
        return type(noted)(_plain(item, depth + 1) for item in noted)
    if isinstance(noted, (int, float)):
        return noted
    raise ValueError(f'holds {type(noted).__name__}')


def _shaped(items: list, shape: Any) -> Any:
    """Gives a flat list the axes of its array, two at most."""
    if len(shape) > 2 or np.prod(shape, dtype=object) != len(items):
        raise ValueError(f'has {len(items)} objects in an array of shape {shape}')
    if not shape:
        return items[0]
    if len(shape) == 1:
        return items
    return [items[i : i + shape[1]] for i in range(0, len(items), max(shape[1], 1))]
