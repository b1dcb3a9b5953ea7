"""Files that appear whole or not at all, in folders with one writer."""

import zipfile

import numpy as np

from pca_tools.storage import archives
from pca_tools.storage.folder_lock import locked as one_writer
from pca_tools.storage.text_files import write_json
from pca_tools.storage.whole_files import TEMPORARY, remove_temporary
from pca_tools.storage.whole_files import write_file as write_whole

__all__ = [
    'MAX_BYTES', 'TEMPORARY', 'one_writer', 'read_arrays', 'remove_temporary', 'write_arrays',
    'write_json', 'write_whole',
]  # fmt: skip

# A run of 5000 particles has 20 MB.
MAX_BYTES = 2**30


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
            archives.refuse_lost_members(path, archive)
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
