"""Files that appear whole or not at all."""

import os
from collections.abc import Callable

import numpy as np


def write_whole(path: str, write: Callable[[str], None]) -> None:
    """Calls `write` with a temporary name beside `path`, then renames it to `path`."""
    folder, name = os.path.split(path)
    temporary = os.path.join(folder, f'.{name}.{os.getpid()}.tmp')
    try:
        write(temporary)
        with open(temporary, 'rb') as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        if os.path.exists(temporary):
            os.remove(temporary)


def write_arrays(path: str, **arrays: np.ndarray) -> None:
    """Writes a compressed `.npz`, whole or not at all."""

    def write(temporary):
        # An open file, so that numpy does not append its own extension to the name.
        with open(temporary, 'wb') as file:
            np.savez_compressed(file, **arrays)

    write_whole(path, write)
