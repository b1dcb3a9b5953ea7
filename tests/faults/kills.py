"""SIGKILL in training, conversion, export, results and solver runs: the same command again gives
the same files.

Named points are all moments before a file of the work folder is opened for writing, renamed,
removed or made, as Python's audit events name them; beside them lie random moments. After every
kill the task is given again, without one, and must end with the bytes of an undisturbed run. All
runs are forks of one process, which has imported what they need.
"""

import contextlib
import gc
import io
import os
import random
import re
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Iterator

import tqdm

from pca_tools import files

_EVENTS = ('open', 'os.rename', 'os.mkdir', 'os.remove', 'os.rmdir', 'shutil.rmtree', 'os.truncate')
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT


def _name_of_point(event, arguments, folder):
    """The point that an audit event is, or None where it changes nothing in the folder."""
    if event == 'ctypes.dlsym' and arguments[1] == 'renameat2':
        return 'exchange of two folders'
    if event not in _EVENTS:
        return None
    paths = [os.fsdecode(a) for a in arguments[:2] if isinstance(a, (str, bytes, os.PathLike))]
    if event == 'open' and not (isinstance(arguments[2], int) and arguments[2] & _WRITING):
        return None
    inside = [os.path.relpath(path, folder) for path in paths if path.startswith(folder)]
    if not inside:
        return None
    plain = [re.sub(r'[0-9a-f]{32}|events\.\S+|(?<=tmp)\w{8}', '*', path) for path in inside]
    return f'{event} {" -> ".join(plain)}'


def _child(action, folder, kill_at=None, points_file=None) -> None:
    """Calls `action` with the folder in this (forked) process, and ends it."""
    count = 0
    points = []

    def hook(event, arguments):
        nonlocal count
        if (name := _name_of_point(event, arguments, folder)) is None:
            return
        if count == kill_at:
            os.kill(os.getpid(), signal.SIGKILL)
        count += 1
        points.append(name)

    # The lock of progress bars is one for all forks: a process killed while it holds it would stop
    # all others, this program too.
    tqdm.tqdm.set_lock(threading.RLock())
    code = 1
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            sys.addaudithook(hook)
            action(folder)
        if points_file:
            files.write_json(points_file, points)
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


def _run(action, folder, kill_at=None, points_file=None, kill_after=None) -> int:
    """Calls `action` with the folder in a fork; returns its exit code, negative for a signal."""
    pid = os.fork()
    if not pid:
        _child(action, folder, kill_at, points_file)
    if kill_after is not None:
        end = time.monotonic() + kill_after
        while time.monotonic() < end:
            done, status = os.waitpid(pid, os.WNOHANG)
            if done:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.002)
        os.kill(pid, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


class Plan:
    """One task with its undisturbed run: named points, duration and result."""

    def __init__(self, name: str, task, base: str, work: str):
        self._task, self._base, self._work = task, base, work
        folder, points_file = self._fresh(), os.path.join(work, 'points.json')
        start = time.monotonic()
        if _run(task.run, folder, points_file=points_file):
            raise OSError(f'{name} fails without a kill')
        self._seconds = time.monotonic() - start
        self.points = files.read_json(points_file)
        self._whole = self._fingerprint(folder)

    def _fingerprint(self, folder):
        return self._task.fingerprint(os.path.join(folder, self._task.result))

    def _fresh(self):
        folder = os.path.join(self._work, 'folder')
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(self._base, folder)
        return folder

    def kill_at(self, point: int) -> str:
        """Kills at a named point; returns what was lost, '' for nothing."""
        folder = self._fresh()
        if _run(self._task.run, folder, point) != -signal.SIGKILL:
            return 'the point was not reached'
        return self._lost(folder)

    def kill_at_random(self, rng: random.Random) -> str:
        """Kills at a random moment; one after the end is drawn again. Returns as `kill_at`."""
        while True:
            folder, after = self._fresh(), rng.uniform(0.0, self._seconds)
            start = time.monotonic()
            if _run(self._task.run, folder, kill_after=after) == -signal.SIGKILL:
                return self._lost(folder)
            self._seconds = time.monotonic() - start  # the first run may have compiled something

    def _lost(self, folder):
        if code := _run(self._task.run, folder):
            return f'the same command fails afterwards ({code})'
        found = self._fingerprint(folder)
        differing = sorted(n for n in {*found, *self._whole} if found.get(n) != self._whole.get(n))
        return f'other files: {", ".join(differing)}' if differing else ''


def run(
    moments: dict[str, int], seed: int, points: int | None = None
) -> Iterator[tuple[str, int, str, str]]:
    """Kills tasks in turn, at their named points and at random moments.

    Args:
        moments: name of `kill_tasks.TASKS` -> kills at random moments.
        seed: of points and moments.
        points: named points of each task; None for every one.

    Yields:
        after each kill: task, how many named points it has, the one or '' for a random moment, what
        was lost or ''.

    Raises:
        OSError: a task fails without a kill.
    """
    from tests.faults import kill_tasks  # here: all forks find it imported

    with tempfile.TemporaryDirectory() as folder:
        folder = os.path.realpath(folder)
        base = os.path.join(folder, 'base')
        os.mkdir(base)
        if _run(kill_tasks.prepare, base):
            raise OSError('the data of the tasks could not be made')
        if 'solver runs' in moments:
            kill_tasks.warm(os.path.join(folder, 'warm'))
        # What is there now is touched by no collection in a fork: no page of it is copied for one.
        gc.collect()
        gc.freeze()
        for i, (name, count) in enumerate(moments.items()):
            work, rng = os.path.join(folder, str(i)), random.Random(f'{name}:{seed}')
            os.mkdir(work)
            plan = Plan(name, kill_tasks.TASKS[name], base, work)
            n = len(plan.points)
            for point in rng.sample(range(n), n if points is None else min(points, n)):
                yield name, n, plan.points[point], plan.kill_at(point)
            for _ in range(count):
                yield name, n, '', plan.kill_at_random(rng)
