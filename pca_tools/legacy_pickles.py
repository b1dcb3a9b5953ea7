"""The authors' PCA side files: numpy arrays in pickles, read through an unpickler that admits
nothing else.

This is the only place of the project that reads pickles. A pickle is a program: the stock loader
would run whatever it names. Here a name outside numpy's four array-building ones ends the reading.
"""

from __future__ import annotations

import io
import os
import pickle

import numpy as np

from pca_tools import files

EIGENVALUES_NAME = 'pca_eigen_values.pkl'
EIGENVECTORS_NAME = 'pca_eigen_vectors.pkl'
MEAN_NAME = 'pca_mean_scalar.pkl'
_MAX_BYTES = 2**30
_MULTIARRAY_MODULES = ('numpy.core.multiarray', 'numpy._core.multiarray')
_ADMITTED = {('numpy', 'ndarray'): np.ndarray, ('numpy', 'dtype'): np.dtype} | {
    (module, name): getattr(np._core.multiarray, name)
    for module in _MULTIARRAY_MODULES
    for name in ('_reconstruct', 'scalar')
}


class _ArrayUnpickler(pickle.Unpickler):
    """Admits the functions that rebuild numpy arrays, scalars and dtypes, and nothing else."""

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
        array = _ArrayUnpickler(io.BytesIO(data)).load()
    except Exception as error:  # a damaged pickle fails in many ways, none of which is ours
        raise ValueError(f'{path}: is not a pickled numpy array: {error}') from error
    if not isinstance(array, (np.ndarray, np.generic)) or array.dtype.kind not in 'fciu':
        raise ValueError(f'{path}: holds {type(array).__name__}, an array of numbers was expected')
    return np.asarray(array)
