"""The small world that is killed and damaged: raw runs, their dataset, an untrained model."""

import functools
import os
import shutil
import tempfile
from collections.abc import Callable

import numpy as np
import tensorflow as tf

from learning_to_simulate import checkpoints, presets, reading_utils
from learning_to_simulate.live import starts
from learning_to_simulate.subspace import method, trainer
from learning_to_simulate.training import loop
from pca_tools import convert, dataset, raw_runs

FRAMES, N_SOIL, R, MODES = 12, 40, 4, 3
TINY = {'latent_size': 4, 'hidden_layers': 1, 'num_steps': 6, 'unroll_steps': 0, 'mode_edges': 4}


def write_raw(folder: str) -> None:
    """Five runs of a plate through soil, at speeds of their own, with force and context."""
    rng = np.random.default_rng(0)
    bed, plate = rng.uniform(0.0, 0.3, (N_SOIL, 3)), rng.uniform(0.0, 0.1, (R, 3))

    def run(speed):
        travel = (speed * np.arange(FRAMES) / 60)[:, None, None] * np.array([1.0, 0.0, 0.0])
        return {
            'positions': bed + travel * rng.uniform(0.2, 0.4, (1, N_SOIL, 1)),
            'rigid_positions': plate + travel,
            'force': rng.normal(size=(FRAMES, 3)),
            'context': {'friction_angle_deg': 30.0 + 10.0 * speed},
        }

    raw_runs.write_raw(folder, map(run, (0.2, 0.3, 0.4, 0.5, 0.6)), 1 / 60, up_axis='y')


def cheap_step(self: trainer.Trainer, step: int) -> dict:
    """In place of a training step: moves all variables by a known amount, and costs nothing. What
    lies on the disk does not see it."""
    variables = self.simulator.trainable_variables
    for variable, average in zip(variables, self.averaging.variables, strict=True):
        variable.assign(variable * 0.9 + 0.01 * step)
        average.assign(average * 0.5 + variable * 0.5)
    self.optimizer.iterations.assign_add(1)
    return {'loss': tf.constant(1.0)}


class CheapTrainer(trainer.Trainer):
    step = cheap_step


def training(data: str, **overrides) -> loop.Training:
    """A training of a tiny model on a dataset."""
    metadata = dataset.read_metadata(data)
    config = presets.make_config('pcg', **TINY | overrides)
    groups = reading_utils.read_groups(data, 'train', metadata, **config.nodes)
    model = method.make_model(data, metadata, groups, config)
    return loop.Training(
        model=model, trainer=CheapTrainer(model, groups), evaluator=None, valid=[],
        n_rigid=groups[0].n_rigid, data={'path': data, 'sha256': {}}, title='kills',
        write_files=lambda path: starts.write(path, data, config.nodes),
    )  # fmt: skip


def write(folder: str) -> None:
    """`raw`, its dataset `data`, and an untrained `model`."""
    write_raw(f'{folder}/raw')
    convert.convert(f'{folder}/raw', f'{folder}/data', modes=MODES)
    path = f'{folder}/model'
    os.makedirs(path)
    begun = training(f'{folder}/data')
    loop.open_model_path(path, begun)
    checkpoints.save_weights(path, checkpoints.weights_of(begun.model))


@functools.cache
def _held():
    held = tempfile.TemporaryDirectory()
    write(held.name)
    return held


def world() -> str:
    """The folder of `write`, made once in a process and gone with it."""
    return _held().name


def copies(part: str, *names: str) -> Callable[[str], None]:
    """What copies files of a part of the world into a folder, by default all."""

    def copy(folder):
        source = os.path.join(world(), part)
        for name in names or os.listdir(source):
            shutil.copy(os.path.join(source, name), folder)

    return copy
