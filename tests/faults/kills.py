"""SIGKILL in training, conversion, export, results and solver runs: the same command again gives
the same files.

Named points are all moments before a file of the work folder is opened for writing, renamed,
removed or made, as Python's audit events name them; beside them lie random moments. After every
kill the task is given again, without one, and must end with the bytes of an undisturbed run. All
runs are forks of this process, which has imported what they need; nothing here may run a TensorFlow
operation at import.

A task writes into a folder of its own; given again after a kill it goes on, or says that it is
done. What costs seconds and writes nothing is left out: gradients of the
training, the comparison of an export with TensorFlow, the optimisation by the C compiler.
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


def _prepare(folder):
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


def _broken(folder):
    """Results written file by file, of which a kill leaves a mixture: they must be lost."""
    os.makedirs(f'{folder}/results', exist_ok=True)
    for name in 'ab':
        path = f'{folder}/results/{name}'
        if not os.path.exists(path):  # a half one is taken for whole
            with open(path, 'w') as file:
                file.write('x')
                file.flush()
                open(f'{folder}/results/c', 'w').close()
                file.write('y' * 100)


def fingerprint(path: str) -> dict[str, str]:
    """Name -> digest of what must be the same in a result: of a run its contents, as its file also
    holds the time that it took; logs not."""
    names = sorted(n for n in os.listdir(path) if not n.startswith(('.', 'events.')))
    whole = {name: os.path.join(path, name) for name in names if not name.endswith('.damaged')}
    if os.path.basename(path) != 'solver':
        return {name: files.sha256_of_file(file) for name, file in whole.items()}
    listed = (raw_run.read_manifest(path) or {'runs': []})['runs']
    runs = {n: raw_run.read_run(file) for n, file in whole.items() if n.startswith('run_')}
    return {f'manifest {entry["file"]}': entry['content'] for entry in listed} | {
        name: raw_run.content_digest(run) for name, run in runs.items()
    }


# Name -> what writes into a folder, and the name of its result there.
TASKS: dict[str, tuple[Callable[[str], None], str]] = {
    'training': (_train, 'training'),
    'conversion': (_convert, 'data'),
    'conversion over an older dataset': (_convert_again, 'again'),
    'export of an FMU': (_export, 'exported'),
    'results over older ones': (_save_results, 'results'),
    'solver runs': (_solve, 'solver'),
    'broken': (_broken, 'results'),
}
# They take longest, and write as others do.
ONLY_IN_LONG_RUNS = 'conversion', 'export of an FMU'

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

    def __init__(self, name: str, base: str, work: str):
        self._task, result = TASKS[name]
        self._base, self._folder = base, os.path.join(work, 'folder')
        self._result = os.path.join(self._folder, result)
        self._make_folder()
        points_file = os.path.join(work, 'points.json')
        start = time.monotonic()
        if _run(self._task, self._folder, points_file=points_file):
            raise OSError(f'{name} fails without a kill')
        self._seconds = time.monotonic() - start
        self.points = files.read_json(points_file)
        self._whole = fingerprint(self._result)

    def _make_folder(self):
        shutil.rmtree(self._folder, ignore_errors=True)
        shutil.copytree(self._base, self._folder)

    def kill_at(self, point: int) -> str:
        """Kills at a named point; returns what was lost, '' for nothing."""
        self._make_folder()
        if _run(self._task, self._folder, point) != -signal.SIGKILL:
            return 'the point was not reached'
        return self._lost()

    def kill_at_random(self, rng: random.Random) -> str:
        """Kills at a random moment; one after the end is drawn again. Returns as `kill_at`."""
        while True:
            self._make_folder()
            start, after = time.monotonic(), rng.uniform(0.0, self._seconds)
            if _run(self._task, self._folder, kill_after=after) == -signal.SIGKILL:
                return self._lost()
            self._seconds = time.monotonic() - start  # the first run may have compiled something

    def _lost(self):
        if code := _run(self._task, self._folder):
            return f'the same command fails afterwards ({code})'
        found = fingerprint(self._result)
        differing = sorted(n for n in {*found, *self._whole} if found.get(n) != self._whole.get(n))
        return f'other files: {", ".join(differing)}' if differing else ''


def run(moments: int, points: int) -> Iterator[tuple[str, int, str, str]]:
    """Kills each task at so many random moments and named points.

    Yields after each kill: task, how many named points it has, the one or '' for a random moment,
    what was lost or ''. OSError: a task fails without a kill.
    """
    with tempfile.TemporaryDirectory() as folder:
        folder = os.path.realpath(folder)
        base = os.path.join(folder, 'base')
        os.mkdir(base)
        if _run(_prepare, base):
            raise OSError('the data of the tasks could not be made')
        with contextlib.redirect_stdout(io.StringIO()):
            # Loads the compiled solver for all forks of this process: two thirds of a short run.
            _solve(os.path.join(folder, 'warm'), 2, SOLVER_CASES[:1])
        # What is there now is touched by no collection in a fork: no page of it is copied for one.
        gc.collect()
        gc.freeze()
        for name in TASKS:
            if moments < 2 and name in ONLY_IN_LONG_RUNS:
                continue
            work, rng = os.path.join(folder, name.replace(' ', '_')), random.Random(f'{name}:0')
            os.mkdir(work)
            plan = Plan(name, base, work)
            n = len(plan.points)
            for point in rng.sample(range(n), min(points, n)):
                yield name, n, plan.points[point], plan.kill_at(point)
            for _ in range(moments):
                yield name, n, '', plan.kill_at_random(rng)


if __name__ == '__main__':
    files.write_json(sys.argv[1], list(run(*map(int, sys.argv[2:]))))
