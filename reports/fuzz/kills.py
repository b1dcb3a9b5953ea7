"""SIGKILL in training, conversion, export, results and solver runs: the same command again gives
the same files.

Named points are all moments before a file of the work folder is opened for writing, renamed,
removed or made, as Python's audit events name them; beside them lie random moments. After every
kill the task is given again, without one, and must end with the bytes of an undisturbed run. All
runs are forks of one process, which has imported what they need. The same command goes on with the
tasks that it has not finished.

Examples:
    python -m reports kills --count=200 --output_path=docs

    python -m reports kills --count=40 --points=0 --tasks=training --seed=1
"""

import contextlib
import io
import os
import random
import re
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator

import tqdm
from absl import flags

from pca_tools import files
from reports import command, markdown, record
from reports.fuzz import kill_tasks

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


def _child(task, folder, kill_at=None, points_file=None) -> None:
    """Runs a task in this (forked) process, and ends it."""
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

    code = 1
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            sys.addaudithook(hook)
            task.run(folder) if task else kill_tasks.prepare(folder)
        if points_file:
            files.write_json(points_file, points)
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


def _run(task, folder, kill_at=None, points_file=None, kill_after=None) -> int:
    """Runs a task in a fork; returns its exit code, negative for a signal."""
    pid = os.fork()
    if not pid:
        _child(task, folder, kill_at, points_file)
    if kill_after is not None:
        time.sleep(kill_after)
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


class Plan:
    """One task with what it does undisturbed: named points, duration and result.

    It is done twice: the first time may compile, and both must end with the same files.
    """

    def __init__(self, name: str, base: str, work: str):
        self.name, self._task = name, kill_tasks.TASKS[name]
        self._base, self._work = base, work
        points_file = os.path.join(work, 'points.json')
        ends = []
        for _ in range(2):
            folder = self._fresh()
            start = time.monotonic()
            if _run(self._task, folder, points_file=points_file):
                raise OSError(f'{name} fails without a kill')
            self.seconds = time.monotonic() - start
            ends.append(self._fingerprint(folder))
        if ends[0] != ends[1]:
            raise OSError(f'{name} ends with other files each time, without a kill')
        self.points, self._whole = files.read_json(points_file), ends[0]

    def _fingerprint(self, folder):
        return self._task.fingerprint(os.path.join(folder, self._task.result))

    def _fresh(self):
        folder = os.path.join(self._work, 'folder')
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(self._base, folder)
        return folder

    def kill(self, point: int | None, rng: random.Random) -> tuple[bool, str]:
        """Kills at a named point, or at a random moment; returns whether it was killed, and what
        was lost ('' for nothing)."""
        folder = self._fresh()
        after = None if point is not None else rng.uniform(0.0, self.seconds)
        killed = _run(self._task, folder, point, kill_after=after) == -signal.SIGKILL
        if code := _run(self._task, folder):
            return killed, f'the same command fails afterwards ({code})'
        found = self._fingerprint(folder)
        differing = sorted(n for n in {*found, *self._whole} if found.get(n) != self._whole.get(n))
        return killed, f'other files: {", ".join(differing)}' if differing else ''


def run(
    moments: dict[str, int], seed: int, points: int | None = None
) -> Iterator[tuple[str, dict, list]]:
    """Kills tasks, at their named points and at random moments.

    Args:
        moments: name of `kill_tasks.TASKS` -> kills at random moments; one after the end is drawn
            again.
        seed: of points and moments.
        points: named points of each task; None for every one.

    Yields:
        of each task its name, its row (points, named, random, lost) and what was lost.
    """
    with tempfile.TemporaryDirectory() as folder:
        folder = os.path.realpath(folder)
        base = os.path.join(folder, 'base')
        os.mkdir(base)
        if _run(None, base):
            raise OSError('the data of the tasks could not be made')
        for i, (name, count) in enumerate(moments.items()):
            work = os.path.join(folder, str(i))
            os.mkdir(work)
            yield name, *_kills(Plan(name, base, work), count, seed, points)


def _kills(plan, count, seed, points):
    """Row and losses of one task."""
    rng = random.Random(f'{plan.name}:{seed}')
    here = list(range(len(plan.points)))
    if points is not None:
        here = rng.sample(here, min(points, len(here)))
    row: dict = {'points': len(plan.points), 'named': 0, 'random': 0, 'lost': 0}
    losses = []
    for at in tqdm.tqdm([*here, *[None] * count], desc=plan.name, unit='kill', disable=None):
        killed, lost = False, ''
        while not killed and not lost:
            killed, lost = plan.kill(at, rng)
            if at is not None and not killed:
                lost = 'the point was not reached'
        row['random' if at is None else 'named'] += killed
        if lost:
            row['lost'] += 1
            where = 'a random moment' if at is None else plan.points[at]
            losses.append({'task': plan.name, 'at': where, 'lost': lost})
    return row, losses


def table(path: str) -> str:
    """The kills by task in a `kills.json`, as Markdown."""
    return _table(files.read_json(path)['tasks'])


def _table(rows):
    head = ('task', 'named points', 'kills there', 'kills at random moments', 'something lost')
    sums = [sum(row[key] for row in rows.values()) for key in ('points', 'named', 'random', 'lost')]
    return markdown.table(
        head, [*([name, *row.values()] for name, row in rows.items()), ['**all**', *sums]]
    )


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_integer('count', 200, 'Kills at random moments in all, dealt to the tasks.', 0)
    flags.DEFINE_integer('points', None, 'Named points of each task; default: every one.', 0)
    flags.DEFINE_integer('seed', 0, 'Seed of points and moments.')
    flags.DEFINE_list('tasks', None, 'Names as in the table; default: all.')
    flags.DEFINE_string('output_path', None, 'Folder for kills.json.')


def main(values, _) -> int:
    """Runs the command; exit code 1 if anything was lost."""
    names = values.tasks or list(kill_tasks.TASKS)
    if unknown := set(names) - set(kill_tasks.TASKS):
        raise ValueError(f'no tasks named {sorted(unknown)}; there are {list(kill_tasks.TASKS)}')
    document: dict = {'tasks': {}, 'losses': []}
    path = values.output_path and os.path.join(values.output_path, 'kills.json')
    if path:
        os.makedirs(values.output_path, exist_ok=True)
        identity = {'count': values.count, 'points': values.points, 'seed': values.seed}
        document = record.resume(path, identity, document)
    share, more = divmod(values.count, len(names))
    moments = {name: share + (i < more) for i, name in enumerate(names)}
    todo = {name: n for name, n in moments.items() if name not in document['tasks']}
    for name, row, losses in run(todo, values.seed, values.points):
        document['tasks'][name] = row
        document['losses'] += losses
        if path:
            files.write_json(path, document | record.provenance())
    print(_table(document['tasks']))
    for loss in document['losses'][:20]:
        print(f'{loss["task"]}, killed at {loss["at"]}: {loss["lost"]}')
    return int(bool(document['losses']))


if __name__ == '__main__':
    command.start(define_flags, main)
