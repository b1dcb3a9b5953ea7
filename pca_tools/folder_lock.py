"""One writer per folder: a lock file that names its owner.

The file appears whole under its name (`os.link` of a finished file, so that there is never a lock
without an owner) and holds host, process id and the start time of that process, which tells a
living owner from a stranger that was given the same number later.
"""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import json
import os
import socket
from collections.abc import Iterator

from pca_tools import files

LOCK_NAME = '.lock.json'


@dataclasses.dataclass(frozen=True)
class Owner:
    """The process that writes into a folder.

    Attributes:
        host: name of its machine.
        pid: its process id there.
        started: start time of the process in clock ticks since the machine started, or None where
            the system does not tell.
    """

    host: str
    pid: int
    started: int | None

    def __str__(self) -> str:
        return f'process {self.pid} on {self.host}'

    @property
    def is_alive(self) -> bool | None:
        """Whether the process still runs; None for one of another machine."""
        if self.host != socket.gethostname():
            return None
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return False
        except PermissionError:
            pass  # it runs, under another user
        return _start_time(self.pid) == self.started


@contextlib.contextmanager
def locked(folder: str, take_over: bool = False) -> Iterator[None]:
    """Holds the lock of a folder for the length of a `with` block.

    Args:
        folder: made if it is absent.
        take_over: also take the lock of another machine, whose processes cannot be seen from here.

    Raises:
        ValueError: another process holds it; the message says which one.
        OSError: the folder cannot be written.
    """
    os.makedirs(folder, exist_ok=True)
    path = os.path.join(folder, LOCK_NAME)
    me = Owner(socket.gethostname(), os.getpid(), _start_time(os.getpid()))
    with _one_at_a_time(folder):
        if os.path.exists(path):
            _remove_if_dead(path, take_over)
        _create(path, me)
    try:
        yield
    finally:
        with contextlib.suppress(OSError, ValueError):  # somebody took it over: not ours to remove
            if _read(path) == me:
                os.remove(path)


def _remove_if_dead(path: str, take_over: bool) -> None:
    owner = _read(path)
    alive = owner.is_alive
    if alive:
        raise ValueError(
            f'{os.path.dirname(path)}: {owner} writes into this folder; wait for it or name '
            'another folder'
        )
    if alive is None and not take_over:
        raise ValueError(
            f'{os.path.dirname(path)}: {owner} wrote into this folder and has not released it; if '
            'it is known to be dead, give --take_over_lock'
        )
    print(f'{path}: took over the lock of {owner}')
    os.remove(path)


def _create(path: str, owner: Owner) -> None:
    temporary = f'{path}.{owner.pid}.tmp'
    try:
        with open(temporary, 'w', encoding='utf-8') as file:
            json.dump(dataclasses.asdict(owner), file)
        os.link(temporary, path)
    except FileExistsError:
        raise ValueError(
            f'{os.path.dirname(path)}: {_read(path)} was faster and writes into this folder'
        ) from None
    finally:
        if os.path.exists(temporary):
            os.remove(temporary)


def _read(path: str) -> Owner:
    values = files.read_json(path)
    try:
        owner = Owner(**values)
    except TypeError:
        owner = None
    if owner is None or not isinstance(owner.host, str) or not _is_pid(owner.pid):
        raise ValueError(f'{path}: is not a lock of this program; delete it if nothing runs there')
    return owner


def _is_pid(value) -> bool:
    # kill() gives 0 and negative numbers the meaning of groups of processes.
    return isinstance(value, int) and not isinstance(value, bool) and 0 < value < 2**31


def _start_time(pid: int) -> int | None:
    """Start of a process in ticks; None if it ended or the system does not tell."""
    try:
        with open(f'/proc/{pid}/stat', encoding='utf-8', errors='replace') as file:
            # The name in field 2 may hold blanks; from field 3 on: state, ..., field 22 the start.
            fields = file.read().rpartition(')')[2].split()
    except OSError:
        return None
    return None if fields[0] in 'ZX' else int(fields[19])


@contextlib.contextmanager
def _one_at_a_time(folder: str) -> Iterator[None]:
    """Keeps two processes from judging and replacing the same stale lock at once."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # a file system without it has only the link to rely on
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
