"""What is killed: training, conversion, export, results and solver runs, small and as users call
them.

Each works in a folder of its own that `prepare` has made, and is given again after a kill. Nothing
here may run a TensorFlow operation at import: the processes that are killed are forks. What costs
seconds and writes nothing is left out: gradients of the training, the comparison of an export with
TensorFlow, the optimisation by the C compiler. Solver runs are short ones on coarse cells.
"""

import contextlib
import functools
import io
import os
import types
from collections.abc import Callable
from dataclasses import dataclass
from unittest import mock

import numpy as np

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
            exporting.export(f'{folder}/model', f'{folder}/trained_on', f'{folder}/exported', 'fmu')


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
