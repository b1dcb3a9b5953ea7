"""SIGKILL in training, conversion, export and results: the same command again gives the same files.

Named points are all moments before a file of the work folder is opened for writing, renamed,
removed or made, as Python's audit events name them; beside them lie random moments. After every
kill the task is given again, without one, and must end with the bytes of an undisturbed run.

Examples:
    python -m reports kills --count=200 --output_path=docs

    python -m reports kills --count=40 --tasks=training --seed=1
"""

import collections
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
    """One task with its undisturbed run: named points, duration and result."""

    def __init__(self, name: str, base: str, work: str):
        self.name, self._task = name, kill_tasks.TASKS[name]
        self._base, self._work = base, work
        folder = self._fresh()
        start = time.monotonic()
        points_file = os.path.join(work, 'points.json')
        if _run(self._task, folder, points_file=points_file):
            raise OSError(f'{name} fails without a kill')
        self.seconds = time.monotonic() - start
        self.points = files.read_json(points_file)
        self._whole = kill_tasks.fingerprint(os.path.join(folder, self._task.result))

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
        found = kill_tasks.fingerprint(os.path.join(folder, self._task.result))
        differing = sorted(n for n in {*found, *self._whole} if found.get(n) != self._whole.get(n))
        return killed, f'other files: {", ".join(differing)}' if differing else ''


def run(names: list[str], count: int, seed: int) -> dict:
    """Kills tasks in turn: at each of their named points in an order of the seed, every third time
    at a random moment.

    Args:
        names: of `kill_tasks.TASKS`.
        count: kills in all.
        seed: of points and moments.

    Returns:
        `tasks`: name -> points, points_hit, named, random, lost; `losses`: list of dicts.
    """
    with tempfile.TemporaryDirectory() as folder:
        folder = os.path.realpath(folder)
        base = os.path.join(folder, 'base')
        os.mkdir(base)
        if _run(None, base):
            raise OSError('the data of the tasks could not be made')
        plans = []
        for i, name in enumerate(names):
            work = os.path.join(folder, str(i))
            os.mkdir(work)
            plans.append(Plan(name, base, work))
        rows = {
            p.name: {'points': len(p.points), 'points_hit': 0, 'named': 0, 'random': 0, 'lost': 0}
            for p in plans
        }
        losses: list = []
        turns: collections.Counter[str] = collections.Counter()
        for number in tqdm.trange(count, unit='kill', disable=None):
            plan = plans[number % len(plans)]
            turn = turns[plan.name]
            turns[plan.name] += 1
            rng = random.Random(f'{plan.name}:{seed}:{turn}')
            order = list(range(len(plan.points)))
            random.Random(f'{plan.name}:{seed}').shuffle(order)
            at = None if turn % 3 == 2 else order[(turn - turn // 3) % len(order)]
            killed, lost = plan.kill(at, rng)
            row = rows[plan.name]
            row['named' if at is not None else 'random'] += killed
            row['points_hit'] = min(row['named'], len(order))
            if lost:
                row['lost'] += 1
                where = 'a random moment' if at is None else plan.points[at]
                losses.append({'task': plan.name, 'at': where, 'lost': lost})
    return {'tasks': rows, 'losses': losses}


def table(rows: dict) -> str:
    """The kills by task, as Markdown."""
    head = ('task', 'named points', 'of them hit', 'kills there', 'kills at random', 'lost')
    return markdown.table(head, [[name, *row.values()] for name, row in rows.items()])


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_integer('count', 200, 'Kills in all, dealt to the tasks in turn.', 1)
    flags.DEFINE_integer('seed', 0, 'Seed of points and moments.')
    flags.DEFINE_list('tasks', None, 'Names as in the table; default: all.')
    flags.DEFINE_string('output_path', None, 'Folder for kills.json and kills.md.')


def main(values, _) -> int:
    """Runs the command; exit code 1 if anything was lost."""
    names = values.tasks or list(kill_tasks.TASKS)
    if unknown := set(names) - set(kill_tasks.TASKS):
        raise ValueError(f'no tasks named {sorted(unknown)}; there are {list(kill_tasks.TASKS)}')
    result = run(names, values.count, values.seed)
    text = table(result['tasks'])
    if values.output_path:
        os.makedirs(values.output_path, exist_ok=True)
        head = record.provenance()
        files.write_json(os.path.join(values.output_path, 'kills.json'), head | result)
        page = f'# Kills\n`{head["command"]}`\n\n{text}\n'
        files.write_text(os.path.join(values.output_path, 'kills.md'), page)
    print(text)
    for loss in result['losses'][:20]:
        print(f'{loss["task"]}, killed at {loss["at"]}: {loss["lost"]}')
    return int(bool(result['losses']))


if __name__ == '__main__':
    command.start(define_flags, main)
