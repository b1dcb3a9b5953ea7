"""Files that appear whole or not at all, in folders with one writer."""

import contextlib
import fcntl
import os
import uuid
import zipfile
from collections.abc import Callable, Iterator

import numpy as np

# A run of 5000 particles has 20 MB.
MAX_BYTES = 2**30
TEMPORARY = '.tmp'


def write_whole(path: str, write: Callable[[str], None]) -> None:
    """Calls `write` with a temporary name beside `path`, then renames it to `path`.

    Raises:
        OSError: with the path, if the disk is full or does not let it be written; what was there
            before is kept.
    """
    folder, name = os.path.split(path)
    temporary = os.path.join(folder, f'.{name}.{uuid.uuid4().hex}{TEMPORARY}')
    try:
        write(temporary)
        with open(temporary, 'rb') as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise OSError(error.errno, f'cannot write {path}: {error.strerror or error}') from error
    finally:
        with contextlib.suppress(OSError):
            os.remove(temporary)


def remove_temporary(folder: str) -> None:
    """Removes what writers that were killed left in a folder; only its one writer may call it."""
    for name in os.listdir(folder):
        if name.startswith('.') and name.endswith(TEMPORARY):
            os.remove(os.path.join(folder, name))


def write_arrays(path: str, **arrays: np.ndarray) -> None:
    """Writes a compressed `.npz`, whole or not at all."""

    def write(temporary):
        # An open file, so that numpy does not append its own extension to the name.
        with open(temporary, 'wb') as file:
            np.savez_compressed(file, **arrays)

    write_whole(path, write)


def read_arrays(path: str) -> dict[str, np.ndarray]:
    """Reads a `.npz` of plain arrays.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: if the file is damaged, holds Python objects, or unpacks to over `MAX_BYTES`.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            total = sum(member.file_size for member in archive.infolist())
        if total > MAX_BYTES:
            raise ValueError(f'unpacks to {total} bytes, the limit is {MAX_BYTES}')
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        if not all(isinstance(array, np.ndarray) for array in arrays.values()):
            raise ValueError('not all of its members are arrays')
        return arrays
    except FileNotFoundError:
        raise
    except Exception as error:  # a damaged archive fails in many ways, none of which is ours
        raise ValueError(f'{path} is damaged or not an .npz of arrays: {error!r}') from error


@contextlib.contextmanager
def one_writer(folder: str) -> Iterator[None]:
    """Keeps other processes out of a folder; the system lets go of it when this process ends.

    Raises:
        ValueError: if another process writes into the folder.
    """
    with open(os.path.join(folder, '.lock'), 'a+', encoding='utf-8') as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            raise ValueError(
                f'{folder}: process {file.read().strip()} writes into this folder; wait for it or '
                'name another folder'
            ) from None
        file.truncate(0)
        file.write(f'{os.getpid()}\n')
        file.flush()
        yield
