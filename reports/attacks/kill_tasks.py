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
import tensorflow as tf

from learning_to_simulate import checkpoints, evaluation, presets, reading_utils, registry
from learning_to_simulate.export import exporting
from learning_to_simulate.live import starts
from learning_to_simulate.native import agreement, library
from learning_to_simulate.subspace import method, trainer
from learning_to_simulate.training import loop
from mpm import raw_run, scenes
from pca_tools import convert, dataset, files, raw_writer

FRAMES, R, MODES = 12, 4, 3
SOLVER_FRAMES, SOLVER_CASES = 12, (22, 100, 186)
TINY = {'latent_size': 4, 'hidden_layers': 1, 'num_steps': 6, 'unroll_steps': 0, 'mode_edges': 4}


def fingerprint(path: str) -> dict[str, str]:
    """Name -> sha256 of the files that a result is made of; arrays by value, logs not."""
    found = {}
    for name in sorted(os.listdir(path)):
        if name.startswith(('.', 'events.')) or name.endswith('.damaged'):
            continue
        if name.startswith('ckpt-') and not name.endswith('.json'):
            found[name] = 'there'  # TensorFlow's files hold times
        elif name.endswith('.json') and name.startswith('ckpt-'):
            found[name] = 'there'
        else:
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
    """Raw runs, a dataset and an untrained model."""
    rng = np.random.default_rng(0)
    bed = rng.uniform(0.0, 0.3, (40, 3))
    plate = rng.uniform(0.0, 0.1, (R, 3))

    def run(speed):
        travel = (speed * np.arange(FRAMES) / 60)[:, None, None] * np.array([1.0, 0.0, 0.0])
        force = rng.normal(size=(FRAMES, 3))
        moved = bed + travel * rng.uniform(0.2, 0.4, (1, len(bed), 1))
        return {'positions': moved, 'rigid_positions': plate + travel, 'force': force}

    raw_writer.write_raw(
        f'{folder}/raw', [run(speed) for speed in (0.2, 0.3, 0.4, 0.5, 0.6)], 1 / 60, up_axis='y'
    )
    _convert(folder)
    os.rename(f'{folder}/data', f'{folder}/trained_on')
    path = f'{folder}/model'
    os.makedirs(path)
    training = _training(folder)
    loop.open_model_path(path, training)
    checkpoints.save_weights(path, training.model.simulator)


def _convert(folder: str) -> None:
    if not os.path.exists(f'{folder}/data/manifest.json'):
        convert.convert(f'{folder}/raw', f'{folder}/data', modes=MODES)


def _convert_again(folder: str) -> None:
    """Over an older dataset."""
    if not os.path.exists(f'{folder}/again'):
        os.rename(f'{folder}/trained_on', f'{folder}/again')
    convert.convert(f'{folder}/raw', f'{folder}/again', modes=MODES - 1, overwrite=True)


class _CheapTrainer(trainer.Trainer):
    """The trainer with steps that cost nothing: what lies on the disk does not see them."""

    def step(self, step):
        """Moves all variables by a known amount."""
        variables = self.simulator.trainable_variables
        for variable, average in zip(variables, self.averaging.variables, strict=True):
            variable.assign(variable * 0.9 + 0.01 * step)
            average.assign(average * 0.5 + variable * 0.5)
        self.optimizer.iterations.assign_add(1)
        return {'loss': tf.constant(1.0)}


def _training(folder: str) -> loop.Training:
    data = f'{folder}/trained_on'
    metadata = dataset.read_metadata(data)
    config = presets.make_config('pcg', **TINY)
    groups = reading_utils.read_groups(data, 'train', metadata, **config.nodes)
    model = method.make_model(data, metadata, groups, config)
    return loop.Training(
        model=model, trainer=_CheapTrainer(model, groups), evaluator=None, valid=[],
        n_rigid=groups[0].n_rigid, data={'path': data, 'sha256': {}}, title='kills',
        write_files=lambda path: starts.write(path, data, config.nodes),
    )  # fmt: skip


def _train(folder: str) -> None:
    loop.run(_training(folder), f'{folder}/training', registry.TrainOptions(save_every=2))


def _export(folder: str) -> None:
    if not os.path.exists(f'{folder}/exported/export.json'):  # an empty folder may be filled
        flags = [flag.replace('-O3', '-O0') for flag in library.FLAGS]
        quick = functools.partial(library.compile_sources, flags=flags)
        with (
            mock.patch.object(agreement, 'of_project', return_value={'skipped': 'here'}),
            mock.patch.object(library, 'compile_sources', quick),
        ):
            exporting.export(f'{folder}/model', f'{folder}/trained_on', f'{folder}/exported', 'fmu')


def _save_results(folder: str) -> None:
    """Over older results of more runs."""
    path = f'{folder}/results'
    for count, seed in ((3, 1), (2, 2)):
        if seed == 2 or not os.path.exists(f'{path}/metrics.json'):
            _save(path, count, seed)


def _save(path, count, seed):
    rng = np.random.default_rng(seed)
    nodes = rng.normal(size=(1, FRAMES, R + MODES, 3))
    group = types.SimpleNamespace(
        position=nodes, force=rng.normal(size=(1, FRAMES, 3)), context=None, source=None,
        all_particles=lambda position, as_recorded=False: position,
        all_particle_types=lambda: np.zeros(R + MODES, np.int64),
    )  # fmt: skip
    rollout = types.SimpleNamespace(
        position=nodes[:, 6:], force=rng.normal(size=(1, FRAMES - 6, 3)),
        judgements=[('ok', -1, -1, '')],
    )  # fmt: skip
    results = [(i, group, rollout) for i in range(count)]
    evaluation.save_rollouts(path, 'test', results, {'seed': seed}, {}, f'{seed:064d}')


def _solve(folder: str, frames: int = SOLVER_FRAMES, cases=SOLVER_CASES) -> None:
    from mpm import batch, experiments, simulation  # the other tasks do without the solver

    with mock.patch.object(scenes, 'FRAMES', frames):
        batch.generate(
            experiments.coarse(scenes.EXCAVATION), cases, f'{folder}/solver',
            simulation.Settings(), show_progress=False,
        )  # fmt: skip


def warm(folder: str) -> None:
    """Loads the compiled solver into this process, for all forks of it: two thirds of a short
    run."""
    with contextlib.redirect_stdout(io.StringIO()):
        _solve(folder, 2, SOLVER_CASES[:1])


def _solved(path: str) -> dict[str, str]:
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
