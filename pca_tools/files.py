"""Files that are written whole or not at all, and read only when they are what they claim to be.

Every writer goes through those of `pca_tools.storage.whole_files`. A folder is finished when its
`manifest.json`, written last, lists each file with its bytes and sha256.
"""

import contextlib
import hashlib
import json
import math
import os
import struct
import sys
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from pca_tools.storage.whole_files import replace_files as replace_files
from pca_tools.storage.whole_files import write_atomically as write_atomically
from pca_tools.storage.whole_files import write_folder_atomically as write_folder_atomically
from pca_tools.storage.whole_files import write_json as write_json
from pca_tools.storage.whole_files import write_text as write_text

MANIFEST_NAME = 'manifest.json'
# A raw run of 321 frames x 5000 particles is 19 MB; a file we read is never near this.
MAX_BYTES = 2**30
# The metadata of 10,000 runs; 60 MB of `[]` would take minutes and gigabytes to parse.
MAX_JSON_BYTES = 2**25
_LFS_PREFIX = b'version https://git-lfs'
_ZIP_END = b'PK\x05\x06'  # of the record that ends an archive; 22 bytes and a comment
_ZIP_END_BYTES, _MAX_COMMENT, _IN_ZIP64 = 22, 2**16, 2**16 - 1


def read_json(path: str) -> Any:
    """Reads a JSON file. FileNotFoundError: there is none. ValueError: it is a git-lfs pointer,
    empty, too large, or not JSON (with line and column)."""
    refuse_git_lfs_pointer(path)
    if os.path.getsize(path) > MAX_JSON_BYTES:
        size = os.path.getsize(path)
        raise ValueError(f'{path}: has {size} bytes, the limit of JSON files is {MAX_JSON_BYTES}')
    try:
        with open(path, encoding='utf-8') as file:
            return json.load(file)
    except (ValueError, RecursionError) as error:
        raise ValueError(f'{path}: is not a JSON file: {error}') from error


def write_npz(path: str, **arrays: Any) -> None:
    """Writes arrays as a compressed `.npz`, whole or not at all; ValueError for Python objects."""
    plain = {name: np.asarray(array) for name, array in arrays.items()}
    if objects := [name for name, array in plain.items() if array.dtype.hasobject]:
        raise ValueError(f'{path}: array {objects[0]!r} holds Python objects, not plain numbers')

    def write(temporary: str) -> None:
        with open(temporary, 'wb') as file:  # by handle: numpy appends .npz to a name
            np.savez_compressed(file, **plain)

    write_atomically(path, write)


def read_npz(path: str, only: Sequence[str] | None = None) -> dict[str, np.ndarray]:
    """Reads the arrays of a `.npz` file (of them those in `only`, None: all), without pickles and
    never more than the headers promise. FileNotFoundError: there is no such file. ValueError:
    git-lfs pointer, not a zip file, truncated, damaged, an object array, arrays of more than
    `MAX_BYTES` together, or a member whose header disagrees with its size."""
    with opened_npz(path) as members:
        return {
            name: _read_array(file, size)
            for name, file, size in members
            if only is None or name in only
        }


@contextlib.contextmanager
def opened_npz(path: str) -> Iterator[Iterator[tuple[str, Any, int]]]:
    """Opens a `.npz` file: (name, open file, size in bytes) of every array.

    Whatever is raised meanwhile, and all that is wrong with the archive, becomes a ValueError with
    the path.
    """
    refuse_git_lfs_pointer(path)

    def members(archive: zipfile.ZipFile) -> Iterator[tuple[str, Any, int]]:
        seen = set()
        for member in archive.infolist():
            name, ending = os.path.splitext(member.filename)
            if ending != '.npy' or name in seen:
                raise ValueError(f'member {member.filename!r} is not a numpy array or comes twice')
            # What numpy writes; others may ask for more memory than the file has bytes.
            if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise ValueError(f'member {member.filename!r} is packed in an unknown way')
            seen.add(name)
            with archive.open(member) as file:
                yield name, file, member.file_size

    try:
        with zipfile.ZipFile(path) as archive:
            _refuse_lost_members(path, archive)
            total = sum(member.file_size for member in archive.infolist())
            if total > MAX_BYTES:
                raise ValueError(f'unpacks to {total} bytes, more than the limit of {MAX_BYTES}')
            yield members(archive)
    except Exception as error:  # a damaged archive fails in many ways, none of which is ours
        reason = f'is not a complete .npz file of arrays ({_reason(error)})'
        raise ValueError(f'{path}: {reason}; copy or make it again') from error


def _refuse_lost_members(path: str, archive: zipfile.ZipFile) -> None:
    """One flipped bit in the length of a directory entry swallows the entries after it, and every
    member that is left has a right checksum; `zipfile` reads it without a word."""
    with open(path, 'rb') as file:
        file.seek(0, 2)
        file.seek(max(0, file.tell() - _ZIP_END_BYTES - _MAX_COMMENT))
        tail = file.read()
    at = tail.rfind(_ZIP_END)
    (stated,) = struct.unpack_from('<H', tail, at + 10) if at >= 0 else (0,)
    found = len(archive.infolist())
    if stated != _IN_ZIP64 and stated != found:
        raise ValueError(f'its directory lists {found} members, its end says {stated}')


def read_npy(path: str) -> np.ndarray:
    """Reads a `.npy` file of at most `MAX_BYTES`; raises as `read_npz`."""
    refuse_git_lfs_pointer(path)
    size = os.path.getsize(path)
    try:
        if size > MAX_BYTES:
            raise ValueError(f'has {size} bytes, more than the limit of {MAX_BYTES}')
        with open(path, 'rb') as file:
            return _read_array(file, size)
    except Exception as error:  # as in read_npz
        raise ValueError(f'{path}: is not a plain .npy array ({_reason(error)})') from error


def _reason(error: Exception) -> str:
    text = str(error)
    return text if text and isinstance(error, ValueError) else f'{type(error).__name__}: {text}'


def read_npy_header(file: Any) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Returns shape, whether the order is Fortran's, and type of the `.npy` array that begins here;
    ValueError if it is none, or of a format that is not read."""
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0(file)
    if version == (2, 0):
        return np.lib.format.read_array_header_2_0(file)
    raise ValueError(f'.npy format {version} is not read')


def _read_array(file: Any, size: int) -> np.ndarray:
    """Reads one array after holding its header (shape x item size) against its `size` in bytes."""
    shape, fortran_order, dtype = read_npy_header(file)
    if dtype.hasobject:
        raise ValueError('it holds Python objects, which are not read')
    promised, held = math.prod(shape) * dtype.itemsize, size - file.tell()
    if min(shape, default=1) < 0 or not dtype.itemsize or promised != held:
        raise ValueError(
            f'its header says {shape} x {dtype} = {promised} bytes but it holds {held}'
        )
    data = file.read(held + 1)  # one more, for the end: an archive checks its checksum there
    if len(data) != held:
        raise ValueError(f'it holds {len(data)} bytes, {held} were expected')
    if dtype.kind == 'U':  # of other characters Python can make no text
        points = np.frombuffer(data, np.dtype('u4').newbyteorder(dtype.byteorder))
        if (points > sys.maxunicode).any():
            raise ValueError('it holds texts of characters that there are not')
    return np.ndarray(shape, dtype, bytearray(data), order='F' if fortran_order else 'C')


def refuse_git_lfs_pointer(path: str) -> None:
    """Raises FileNotFoundError, or ValueError for a folder, an empty file, or the small text that
    git-lfs leaves for a large file: how large that is and how to get it."""
    if os.path.isdir(path):
        raise ValueError(f'{path}: is a folder, a file was expected')
    if not os.path.exists(path):
        raise FileNotFoundError(f'{path}: no such file')
    with open(path, 'rb') as file:
        head = file.read(512)
    if not head:
        raise ValueError(f'{path}: is empty (0 bytes); copy or make it again')
    if head.startswith(_LFS_PREFIX):
        fields = dict(line.split(b' ', 1) for line in head.splitlines() if b' ' in line)
        size = fields.get(b'size', b'unknown').decode('ascii', 'replace')
        raise ValueError(
            f'{path}: is a git-lfs pointer, not the file itself (the object has {size} bytes); '
            'run `git lfs pull` where it came from, or make the file again'
        )


def sha256_of_file(path: str) -> str:
    """Returns the hexadecimal sha256 of a file's bytes."""
    with open(path, 'rb') as file:
        return hashlib.file_digest(file, 'sha256').hexdigest()


def fingerprint(path: str) -> dict[str, Any]:
    """Returns what a manifest says of a file: `bytes` and `sha256`."""
    return {'bytes': os.path.getsize(path), 'sha256': sha256_of_file(path)}


def write_manifest(folder: str, files: dict[str, dict[str, Any]]) -> None:
    """Writes `manifest.json`, the last file of a finished folder, of `files`: name -> facts to
    record beside bytes and sha256, such as `{'records': 32}`."""
    entries = {
        file: {**fingerprint(os.path.join(folder, file)), **facts} for file, facts in files.items()
    }
    write_json(os.path.join(folder, MANIFEST_NAME), {'schema_version': 1, 'files': entries})


def check_manifest(
    folder: str, names: Iterable[str] | None = None
) -> dict[str, dict[str, Any]] | None:
    """Holds the files of a folder (those of `names`, None: all that are listed) against its
    manifest; returns file name -> entry, None without a manifest (as in Subspace-Graph-Physics).
    ValueError: a file is missing, unlisted, or differs in bytes or sha256."""
    path = os.path.join(folder, MANIFEST_NAME)
    if not os.path.exists(path):
        return None
    manifest = read_json(path)
    entries = manifest.get('files') if isinstance(manifest, dict) else None
    if not isinstance(entries, dict) or not all(
        isinstance(entry, dict)
        and isinstance(entry.get('bytes'), int)
        and isinstance(entry.get('sha256'), str)
        for entry in entries.values()
    ):
        raise ValueError(f'{path}: is not a manifest: "files" with bytes and sha256 is missing')
    for name in entries if names is None else names:
        if name not in entries:
            raise ValueError(f'{path}: does not list {name}; listed are {sorted(entries)}')
        if os.path.basename(name) != name:
            raise ValueError(f'{path}: {name!r} points out of the folder')
        _check_entry(os.path.join(folder, name), entries[name])
    return entries


def _check_entry(path: str, entry: dict[str, Any]) -> None:
    if not os.path.exists(path):
        raise ValueError(f'{path}: the manifest lists it but it is missing; copy the folder again')
    if (size := os.path.getsize(path)) != entry['bytes']:
        refuse_git_lfs_pointer(path)
        fault = f'has {size} bytes, the manifest says {entry["bytes"]}'
    elif sha256_of_file(path) != entry['sha256']:
        fault = f'its content differs from the manifest (sha256 {entry["sha256"][:12]}... expected)'
    else:
        return
    raise ValueError(f'{path}: {fault}; copy or make it again')
