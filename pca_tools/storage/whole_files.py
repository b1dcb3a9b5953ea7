"""Files and folders under temporary names, moved into place when they are complete.

A temporary name cannot be guessed and is made with O_EXCL, so no other writer (thread, process,
container with the same process ids) has it and no link lies in wait there; what is removed after a
failure is only what this call has made.
"""

import contextlib
import ctypes
import errno
import json
import os
import re
import shutil
import uuid
from collections.abc import Callable, Iterator
from typing import Any

TEMPORARY = '.tmp'
_OLD = '.old'
# Longest name of most file systems; a temporary name keeps so much of the final one.
_MAX_NAME = 255
_KEPT_OF_NAME = 120
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2


def temporary_beside(path: str, ending: str = TEMPORARY) -> str:
    """Returns a name in the folder of `path` that nobody else has."""
    folder, name = os.path.split(path)
    return os.path.join(folder, f'{_stem(name)}{uuid.uuid4().hex}{ending}')


def _stem(name: str) -> str:
    return f'.{name[:_KEPT_OF_NAME]}.'


def write_atomically(path: str, write: Callable[[str], None]) -> None:
    """Writes a file under a temporary name and moves it into place only when it is complete.
    `write` is called with the temporary name, an empty file in the same folder, which must exist.
    OSError, with the path: the folder is missing or full; an older file stays."""
    path = os.path.abspath(path)
    _check_name(path)
    temporary = temporary_beside(path)
    try:
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_WRONLY, 0o666))
        write(temporary)
        with open(temporary, 'rb+') as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        if error.errno is None:
            raise
        # A full disk does not say which file did not fit, and a temporary name helps nobody.
        other = f' ({error.filename})' if error.filename not in (None, temporary, path) else ''
        raise OSError(
            error.errno, f'cannot write {path}: {error.strerror or error}{other}'
        ) from error
    finally:
        with contextlib.suppress(OSError):
            os.remove(temporary)
    sync_folder(os.path.dirname(path))


def write_text(path: str, text: str) -> None:
    """Writes UTF-8 text, whole or not at all."""

    def write(temporary: str) -> None:
        with open(temporary, 'w', encoding='utf-8', newline='') as file:
            file.write(text)

    write_atomically(path, write)


def write_json(path: str, content: Any, indent: int = 2) -> None:
    """Writes indented JSON, whole or not at all; ValueError for NaN and infinity."""
    try:
        text = json.dumps(content, indent=indent, allow_nan=False)
    except ValueError as error:
        raise ValueError(f'{path}: cannot be written as JSON: {error}') from error
    write_text(path, text + '\n')


def write_folder_atomically(path: str, fill: Callable[[str], None], replace: bool = True) -> None:
    """Lets `fill` fill a folder of a temporary name and moves it into place only when it is
    complete. A folder of that name is replaced with `replace`; else it must be empty or absent,
    also by the time that the new one is complete.

    That the name can be taken is tried before the work. A link is followed to the folder that it
    means. An older folder changes places with the new one in one call where the system can; where
    it cannot, a kill between two renames is mended by the next call (`recover_folder`). A mount
    point, which cannot be renamed, is filled file by file, each moved in when all are complete.

    OSError: the name cannot be taken, a file could not be written, or another writer was faster; an
    older folder stays. ValueError: it is not empty and not to be replaced."""
    path = os.path.realpath(path)
    _check_name(path)
    os.makedirs(os.path.dirname(path), exist_ok=True)
    recover_folder(path)
    if os.path.ismount(path):
        _fill_mount(path, fill)
        return
    with _temporary_folder(path) as temporary:
        if not os.path.lexists(path):  # try the name now: after the work is too late
            os.rename(temporary, path)
            os.rename(path, temporary)
        elif not os.path.isdir(path):
            raise NotADirectoryError(errno.ENOTDIR, 'is a file, a folder was expected', path)
        elif not replace and os.listdir(path):
            raise ValueError(f'{path}: is not empty; name another folder')
        fill(temporary)
        if replace and os.path.isdir(path) and os.listdir(path):
            _exchange(temporary, path)
        else:
            os.rename(temporary, path)  # refuses to replace a folder that is not empty


@contextlib.contextmanager
def _temporary_folder(beside: str) -> Iterator[str]:
    temporary = temporary_beside(beside)
    os.mkdir(temporary)
    try:
        yield temporary
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        sync_folder(os.path.dirname(beside))


def replace_files(
    folder: str, fill: Callable[[str], None], is_old: Callable[[str], bool], last: str
) -> None:
    """Replaces the files of a folder whose names are `is_old`, and keeps its other ones; the
    folder's one writer calls. `fill` is called with a temporary folder, which it fills with files.

    Nothing changes before all new files are complete. From then on `last`, one of the set, is
    absent until the set is whole again, so a set with it is never mixed. OSError: one could not be
    written, the old set stays."""
    for name in os.listdir(folder):  # of writers that were killed
        if name.startswith(_stem(last)) and name.endswith(TEMPORARY):
            shutil.rmtree(os.path.join(folder, name), ignore_errors=True)
    with _temporary_folder(os.path.join(folder, last)) as temporary:
        fill(temporary)
        names = sorted(os.listdir(temporary), key=lambda name: (name == last, name))
        with contextlib.suppress(FileNotFoundError):
            os.remove(os.path.join(folder, last))
        for name in os.listdir(folder):
            if is_old(name) and name not in names:
                os.remove(os.path.join(folder, name))
        for name in names:
            os.replace(os.path.join(temporary, name), os.path.join(folder, name))


def recover_folder(path: str) -> None:
    """Gives a folder its name back where a writer was killed while it replaced it: if there is
    nothing under the name, and one folder that a writer had put aside."""
    parent, name = os.path.split(os.path.abspath(path))
    if os.path.lexists(path) or not os.path.isdir(parent):
        return
    put_aside = re.compile(re.escape(_stem(name)) + '.{32}' + re.escape(_OLD))
    aside = list(filter(put_aside.fullmatch, os.listdir(parent)))
    if len(aside) == 1:
        os.rename(os.path.join(parent, aside[0]), path)
        print(f'{path}: was put aside by a writer that did not finish; it has its name again')


def _exchange(temporary: str, path: str) -> None:
    """Puts the folder `temporary` in the place of `path`; the old one ends up as `temporary`."""
    if _swap(temporary, path):
        return
    old = temporary_beside(path, _OLD)
    os.rename(path, old)
    try:
        os.rename(temporary, path)
    except BaseException:
        os.rename(old, path)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _swap(first: str, second: str) -> bool:
    """Exchanges two names in one call; False where system or file system cannot."""
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):
        return False
    names = os.fsencode(first), os.fsencode(second)
    return renameat2(_AT_FDCWD, names[0], _AT_FDCWD, names[1], _RENAME_EXCHANGE) == 0


def _fill_mount(path: str, fill: Callable[[str], None]) -> None:
    """Fills an empty mount point: inside it, then everything one level up, last written last."""
    if any(name != 'lost+found' for name in os.listdir(path)):
        raise OSError(
            errno.ENOTEMPTY, 'is a mount point, which cannot be replaced, and not empty', path
        )
    with _temporary_folder(os.path.join(path, 'filled')) as temporary:
        fill(temporary)
        # The manifest is written last, and says that all others are there.
        with os.scandir(temporary) as entries:
            found = sorted(entries, key=lambda entry: entry.stat().st_mtime_ns)
        for entry in found:
            os.rename(entry.path, os.path.join(path, entry.name))


def remove_temporary(folder: str) -> None:
    """Removes what writers that were killed left in a folder; only its one writer may call it."""
    for name in os.listdir(folder):
        if name.startswith('.') and name.endswith(TEMPORARY):
            with contextlib.suppress(OSError):
                os.remove(os.path.join(folder, name))


def sync_folder(folder: str) -> None:
    """Makes a rename itself durable, where the file system can."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _check_name(path: str) -> None:
    name = os.path.basename(path)
    if not name or len(os.fsencode(name)) > _MAX_NAME:
        raise OSError(errno.ENAMETOOLONG, f'a name of 1 to {_MAX_NAME} bytes was expected', path)
