"""One writer per folder: a file that is locked as long as the writer lives, and names it.

The lock is `flock`: the system keeps it, over the containers of a machine and over machines that
share a file system which passes locks on, and lets go of it when the process ends, however it ends.
The content of the file is for the message alone.
"""

import contextlib
import errno
import fcntl
import json
import os
import socket
from collections.abc import Iterator

LOCK_NAME = '.lock.json'
_MAX_BYTES = 4096


@contextlib.contextmanager
def locked(folder: str) -> Iterator[None]:
    """Holds the lock of a folder, made if absent, for the length of a `with` block. ValueError:
    another process holds it (the message says which one), or the lock is a link. OSError: the
    folder cannot be written, or its file system has no locks."""
    os.makedirs(folder, exist_ok=True)
    path = os.path.join(folder, LOCK_NAME)
    handle = _open_locked(path)
    try:
        if before := _owner(handle):
            print(f'{path}: took over the lock of {before}')
        me = {'host': socket.gethostname(), 'pid': os.getpid()}
        os.ftruncate(handle, 0)
        os.pwrite(handle, json.dumps(me).encode(), 0)
        yield
    finally:
        if _is_open_file(path, handle):
            os.remove(path)
        os.close(handle)


def _open_locked(path: str) -> int:
    """Opens the lock file, made if absent, and locks it; raises as `locked`."""
    while True:
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
        except OSError as error:
            if error.errno == errno.ELOOP:
                raise ValueError(f'{path}: is a symbolic link, no lock: remove it') from None
            raise
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            owner = _owner(handle) or 'another process'
            os.close(handle)
            folder = os.path.dirname(path)
            if not isinstance(error, BlockingIOError):
                text = f'cannot be locked ({error.strerror}); name a folder on another disk'
                raise OSError(error.errno, f'{folder}: {text}') from error
            raise ValueError(
                f'{folder}: {owner} writes into this folder; wait for it or name another folder'
            ) from None
        if _is_open_file(path, handle):
            return handle
        os.close(handle)  # its owner removed it between our two calls: take the new one


def _owner(handle: int) -> str:
    """Who wrote the file, in words; empty where it does not say."""
    try:
        held = json.loads(os.pread(handle, _MAX_BYTES, 0))
        return f'process {held["pid"]} on {held["host"]}'
    except (ValueError, TypeError, KeyError, RecursionError):
        return ''


def _is_open_file(path: str, handle: int) -> bool:
    try:
        there, here = os.stat(path, follow_symlinks=False), os.fstat(handle)
    except OSError:
        return False
    return (there.st_dev, there.st_ino) == (here.st_dev, here.st_ino)
