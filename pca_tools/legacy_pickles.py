"""The authors' PCA side files: numpy arrays in pickles, read through an unpickler that admits
nothing else.

This is the only place of the project that reads pickles. A pickle is a program: the stock loader
would run whatever it names. Here the names that numpy's pickles use lead to stand-ins of this file
that only take notes, and every other name ends the reading. Not even numpy's own functions are
called: `dtype.__setstate__` takes flags with which an array of numbers is handled as an array of
pointers.
"""

from __future__ import annotations

import io
import os
import pickle
import re

import numpy as np

from pca_tools import files

EIGENVALUES_NAME = 'pca_eigen_values.pkl'
EIGENVECTORS_NAME = 'pca_eigen_vectors.pkl'
MEAN_NAME = 'pca_mean_scalar.pkl'
_MAX_BYTES = 2**30
_MULTIARRAY_MODULES = ('numpy.core.multiarray', 'numpy._core.multiarray')
_NUMBER_TYPE = re.compile('[fiuc](1|2|4|8|16)')


class _Type:
    """Stands in for numpy.dtype: notes its name and its byte order."""

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


class _Array:
    """Stands in for numpy's `_reconstruct` and the array it makes: notes the array's state."""

    def __init__(self, *_):
        self.state = None

    def __setstate__(self, state):
        self.state = state

    def array(self) -> np.ndarray:
        _, shape, kind, fortran, data = self.state
        if not isinstance(kind, _Type) or not isinstance(data, bytes):
            raise ValueError('is not an array of numbers')
        # Raises where the bytes do not fit the shape.
        return np.ndarray(shape, kind.dtype(), bytearray(data), order='F' if fortran else 'C')


class _Scalar:
    """Stands in for numpy's `scalar`."""

    def __init__(self, kind, data):
        self.kind, self.data = kind, data

    def array(self) -> np.ndarray:
        if not isinstance(self.kind, _Type) or not isinstance(self.data, bytes):
            raise ValueError('is not a number')
        return np.ndarray((), self.kind.dtype(), bytearray(self.data))


_ADMITTED = {('numpy', 'ndarray'): _Array, ('numpy', 'dtype'): _Type} | {
    (module, name): stand_in
    for module in _MULTIARRAY_MODULES
    for name, stand_in in (('_reconstruct', _Array), ('scalar', _Scalar))
}


class _ArrayUnpickler(pickle.Unpickler):
    """Admits the names of numpy's array pickles, as stand-ins, and nothing else."""

    def find_class(self, module: str, name: str):
        try:
            return _ADMITTED[module, name]
        except KeyError:
            raise ValueError(f'names {module}.{name}, which is not a numpy array') from None


def read_array(path: str) -> np.ndarray:
    """Reads a pickled numpy array or scalar of numbers.

    Args:
        path: pickle file.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: git-lfs pointer, empty or damaged file, or a pickle of anything but numbers in a
            numpy array.
    """
    files.refuse_git_lfs_pointer(path)
    size = os.path.getsize(path)
    if size > _MAX_BYTES:
        raise ValueError(f'{path}: has {size} bytes, the limit is {_MAX_BYTES}')
    with open(path, 'rb') as file:
        data = file.read()
    try:
        noted = _ArrayUnpickler(io.BytesIO(data)).load()
        if not isinstance(noted, (_Array, _Scalar)):
            raise ValueError(f'holds {type(noted).__name__}')
        return noted.array()
    except Exception as error:  # a damaged pickle fails in many ways, none of which is ours
        raise ValueError(f'{path}: is not a pickled numpy array of numbers: {error}') from error
