"""One writer per folder: a lock file that is locked as long as the writer lives, and names it.

The lock itself is `flock`: the system keeps it, over containers that share the machine too, and
lets go of it when the process ends, however it ends. The content of the file says who holds it, and
is what is left to judge by where a machine cannot see the locks of another one.
"""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import fcntl
import json
import os
import socket
from collections.abc import Iterator

LOCK_NAME = '.lock.json'
_MAX_BYTES = 4096
_UNSUPPORTED = (errno.ENOTSUP, errno.ENOLCK, errno.ENOSYS, errno.EINVAL)


@dataclasses.dataclass(frozen=True)
class Owner:
    """The process that writes into a folder.

    Attributes:
        host: name of its machine.
        pid: its process id there.
        started: start time of the process in clock ticks since the machine started, or None where
            the system does not tell.
        boot: id of the machine's start; tells machines (and containers of different machines) with
            one host name apart. None where unknown.
        namespace: of its process ids, as containers have their own. None where unknown.
    """

    host: str
    pid: int
    started: int | None
    boot: str | None = None
    namespace: int | None = None

    def __str__(self) -> str:
        return f'process {self.pid} on {self.host}'

    @property
    def is_of_this_machine(self) -> bool:
        """Whether it ran on this machine since this start, as far as the file tells."""
        if self.boot is not None and _boot_id() is not None:
            return self.boot == _boot_id()
        return self.host == socket.gethostname()

    @property
    def is_alive(self) -> bool | None:
        """Whether the process still runs; None where it cannot be seen from here."""
        if not self.is_of_this_machine or self.namespace not in (None, _namespace()):
            return None
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return False
        except PermissionError:
            pass  # it runs, under another user
        return _start_time(self.pid) == self.started


def this_process() -> Owner:
    """Returns the owner that this process would be."""
    pid = os.getpid()
    return Owner(socket.gethostname(), pid, _start_time(pid), _boot_id(), _namespace())


@contextlib.contextmanager
def locked(folder: str, take_over: bool = False) -> Iterator[None]:
    """Holds the lock of a folder for the length of a `with` block.

    Args:
        folder: made if it is absent.
        take_over: also take the lock of another machine, whose processes cannot be seen from here.

    Raises:
        ValueError: another process holds it (the message says which one), or the lock file is a
            link or not of this program.
        OSError: the folder cannot be written.
    """
    os.makedirs(folder, exist_ok=True)
    path = os.path.join(folder, LOCK_NAME)
    handle, is_locked = _open_locked(path)
    try:
        _refuse_other_owner(path, handle, is_locked, take_over)
        me = this_process()
        _write(handle, me)
    except BaseException:
        os.close(handle)
        raise
    try:
        yield
    finally:
        # Somebody may have taken it over: then it is not ours to remove.
        with contextlib.suppress(OSError, ValueError):
            if _read(path, handle) == me and _is_open_file(path, handle):
                os.remove(path)
        os.close(handle)


def _open_locked(path: str) -> tuple[int, bool]:
    """Opens the lock file, made if absent, and locks it; returns its handle and whether it could.

    Raises:
        ValueError: another process has it locked, or it is a link.
    """
    while True:
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
        except OSError as error:
            if error.errno == errno.ELOOP:
                raise ValueError(
                    f'{path}: is a symbolic link; a lock of this program is not: remove it'
                ) from None
            raise
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            try:
                owner = _read(path, handle)
            except ValueError:
                owner = None
            os.close(handle)
            raise _refusal(path, owner) from None
        except OSError as error:
            if error.errno not in _UNSUPPORTED:
                os.close(handle)
                raise
            return handle, False
        if _is_open_file(path, handle):
            return handle, True
        os.close(handle)  # its owner removed it between our two calls: take the new one


def _refuse_other_owner(path: str, handle: int, is_locked: bool, take_over: bool) -> None:
    """Raises if the file names a writer that may still be there; says so if it is taken over."""
    owner = _read(path, handle)
    if owner is None:  # new, or its writer was killed before it wrote its name
        return
    # On this machine a lock that could be had has no living owner.
    alive = False if is_locked and owner.boot and owner.is_of_this_machine else owner.is_alive
    if alive:
        raise _refusal(path, owner)
    if alive is None and not take_over:
        raise ValueError(
            f'{os.path.dirname(path)}: {owner} wrote into this folder and has not released it; if '
            'it is known to be dead, give --take_over_lock'
        )
    print(f'{path}: took over the lock of {owner}')


def _refusal(path: str, owner: Owner | None) -> ValueError:
    return ValueError(
        f'{os.path.dirname(path)}: {owner or "another process"} writes into this folder; wait for '
        'it or name another folder'
    )


def _write(handle: int, owner: Owner) -> None:
    text = json.dumps(dataclasses.asdict(owner)).encode()
    os.ftruncate(handle, 0)
    os.pwrite(handle, text, 0)


def _read(path: str, handle: int) -> Owner | None:
    """Returns the owner that the open file names, None where it is empty.

    Raises:
        ValueError: it names none.
    """
    text = os.pread(handle, _MAX_BYTES, 0)
    if not text:
        return None
    try:
        owner = Owner(**json.loads(text))
    except (ValueError, TypeError, RecursionError):
        owner = None
    if (
        owner is None
        or not isinstance(owner.host, str)
        or not _is_pid(owner.pid)
        or not isinstance(owner.boot, str | None)
    ):
        raise ValueError(
            f'{path}: is not a lock of this program; if nothing writes here, move it away'
        )
    return owner


def _is_open_file(path: str, handle: int) -> bool:
    """Whether a path still leads to the open file."""
    try:
        there, here = os.stat(path, follow_symlinks=False), os.fstat(handle)
    except OSError:
        return False
    return (there.st_dev, there.st_ino) == (here.st_dev, here.st_ino)


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


def _boot_id() -> str | None:
    try:
        with open('/proc/sys/kernel/random/boot_id', encoding='ascii') as file:
            return file.read().strip()
    except OSError:
        return None


def _namespace() -> int | None:
    try:
        return os.stat('/proc/self/ns/pid').st_ino
    except OSError:
        return None
