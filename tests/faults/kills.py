"""SIGKILL in training, conversion, export, results and solver runs: the same command again gives
the same files.

Named points are all moments before a file of the work folder is opened for writing, renamed,
removed or made, as Python's audit events name them; beside them lie random moments. After every
kill the task is given again, without one, and must end with the bytes of an undisturbed run. All
runs are forks of this process, which has imported what they need; nothing here may run a TensorFlow
operation at import.

What is killed is small and as users call it, each in a folder of its own that `prepare` has made.
What costs seconds and writes nothing is left out: gradients of the training, the comparison of an
export with TensorFlow, the optimisation by the C compiler. Solver runs are short ones on coarse
cells.
"""

import contextlib
import functools
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
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from unittest import mock

import numpy as np
import tqdm

from learning_to_simulate import evaluation, registry
from learning_to_simulate.export import exporting
from learning_to_simulate.native import exporting as exporting_c
from learning_to_simulate.native import library
from learning_to_simulate.rollout_status import Judgement, RolloutStatus
from learning_to_simulate.training import loop
from mpm import raw_run, scenes
from pca_tools import convert, files
from tests.faults import small

SOLVER_FRAMES, SOLVER_CASES = 12, (22, 100, 186)


def fingerprint(path: str) -> dict[str, str]:
    """Name -> sha256 of the files that a result is made of; arrays by value, logs not."""
    found = {}
    for name in sorted(os.listdir(path)):
        if not name.startswith(('.', 'events.')) and not name.endswith('.damaged'):
            found[name] = files.sha256_of_file(os.path.join(path, name))
    return found


@dataclass(frozen=True)
class Task:
    """Something that writes, and may be killed in the middle.

    Attributes:
        run: does it in the folder; called again after a kill it goes on, or says that it is done.
        result: name below the folder of what it writes.
        fingerprint: path of the result -> name -> digest of what must be the same.
    """

    run: Callable[[str], None]
    result: str
    fingerprint: Callable[[str], dict[str, str]] = fingerprint


def prepare(folder: str) -> None:
    """The small world, whose dataset the tasks make anew."""
    small.write(folder)
    os.rename(f'{folder}/data', f'{folder}/trained_on')


def _convert(folder):
    if not os.path.exists(f'{folder}/data/manifest.json'):
        convert.convert(f'{folder}/raw', f'{folder}/data', modes=small.MODES)


def _convert_again(folder):
    """Over an older dataset."""
    if not os.path.exists(f'{folder}/again'):
        os.rename(f'{folder}/trained_on', f'{folder}/again')
    convert.convert(f'{folder}/raw', f'{folder}/again', modes=small.MODES - 1, overwrite=True)


def _train(folder):
    training = small.training(f'{folder}/trained_on')
    loop.run(training, f'{folder}/training', registry.TrainOptions(save_every=2))


def _export(folder):
    if not os.path.exists(f'{folder}/exported/export.json'):  # an empty folder may be filled
        flags = [flag.replace('-O3', '-O0') for flag in library.FLAGS]
        quick = functools.partial(library.compile_sources, flags=flags)
        with (
            mock.patch.object(exporting_c.CModel, '_compared', return_value={'skipped': 'here'}),
            mock.patch.object(library, 'compile_sources', quick),
        ):
            exporting.export(f'{folder}/model', f'{folder}/trained_on', f'{folder}/exported', 'c')


def _save_results(folder):
    """Over older results of more runs."""
    path, n_node = f'{folder}/results', small.R + small.MODES
    for count, seed in ((3, 1), (2, 2)):
        if seed == 1 and os.path.exists(f'{path}/metrics.json'):
            continue
        rng = np.random.default_rng(seed)
        nodes = rng.normal(size=(1, small.FRAMES, n_node, 3))
        group = types.SimpleNamespace(
            position=nodes, force=rng.normal(size=(1, small.FRAMES, 3)), context=None, source=None,
            all_particles=lambda position, as_recorded=False: position,
            all_particle_types=lambda: np.zeros(n_node, np.int64),
        )  # fmt: skip
        rollout = types.SimpleNamespace(
            position=nodes[:, 6:], force=rng.normal(size=(1, small.FRAMES - 6, 3)),
            judgements=[Judgement(RolloutStatus.OK)],
        )  # fmt: skip
        results = [(i, group, rollout) for i in range(count)]
        evaluation.save_rollouts(path, 'test', results, {'seed': seed}, {}, f'{seed:064d}')


def _solve(folder, frames=SOLVER_FRAMES, cases=SOLVER_CASES):
    from mpm import batch, simulation  # the other tasks do without the solver
    from tests.mpm.small import BLADE

    with mock.patch.object(scenes, 'FRAMES', frames):
        batch.generate(BLADE, cases, f'{folder}/solver', simulation.Settings())


def warm(folder: str) -> None:
    """Loads the compiled solver into this process, for all forks of it: two thirds of a short
    run."""
    with contextlib.redirect_stdout(io.StringIO()):
        _solve(folder, 2, SOLVER_CASES[:1])


def _solved(path):
    """The contents of the runs; files also hold the time that they took."""
    manifest = raw_run.read_manifest(path) or {'runs': []}
    listed = {entry['file']: entry['content'] for entry in manifest['runs']}
    there = {
        name: raw_run.content_digest(raw_run.read_run(os.path.join(path, name)))
        for name in os.listdir(path)
        if name.startswith('run_')
    }
    return {f'manifest {name}': digest for name, digest in listed.items()} | there


TASKS = {
    'training': Task(_train, 'training'),
    'conversion': Task(_convert, 'data'),
    'conversion over an older dataset': Task(_convert_again, 'again'),
    'export of an FMU': Task(_export, 'exported'),
    'results over older ones': Task(_save_results, 'results'),
    'solver runs': Task(_solve, 'solver', _solved),
}

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
        moments: name of `TASKS` -> kills at random moments.
        seed: of points and moments.
        points: named points of each task; None for every one.

    Yields:
        after each kill: task, how many named points it has, the one or '' for a random moment, what
        was lost or ''.

    Raises:
        OSError: a task fails without a kill.
    """
    with tempfile.TemporaryDirectory() as folder:
        folder = os.path.realpath(folder)
        base = os.path.join(folder, 'base')
        os.mkdir(base)
        if _run(prepare, base):
            raise OSError('the data of the tasks could not be made')
        if 'solver runs' in moments:
            warm(os.path.join(folder, 'warm'))
        # What is there now is touched by no collection in a fork: no page of it is copied for one.
        gc.collect()
        gc.freeze()
        for i, (name, count) in enumerate(moments.items()):
            work, rng = os.path.join(folder, str(i)), random.Random(f'{name}:{seed}')
            os.mkdir(work)
            plan = Plan(name, TASKS[name], base, work)
            n = len(plan.points)
            for point in rng.sample(range(n), n if points is None else min(points, n)):
                yield name, n, plan.points[point], plan.kill_at(point)
            for _ in range(count):
                yield name, n, '', plan.kill_at_random(rng)
