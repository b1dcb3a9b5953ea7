"""Rollouts of trained models, as the files that `train --mode=eval_rollout` writes: the same for
every method of the registry."""

import os
import re
import shlex
import subprocess
import sys

import numpy as np

from learning_to_simulate import presets
from pca_tools import dataset, files
from reports.protocol.run_errors import RunPrediction
from reports.record import ROOT

_TRAIN = 'learning_to_simulate.train'


def make(job: tuple) -> None:
    """Trains a model and rolls it out over splits, or finds that done: one task of a worker.

    Args:
      job: (dataset folder, model folder, flags of its training or None where it is trained,
        splits, folder of the rollouts); all on a disk that this process sees.

    Raises:
      ValueError: see `_run`.
    """
    data_path, model_path, flags, splits, folder = job
    if flags is not None:
        train(data_path, model_path, flags)
    for split in splits:
        roll_out(data_path, model_path, split, folder)


def training_flags(name: str) -> list[str]:
    """Flags of the training of a method of --train, `PRESET` or `PRESET --FLAG=VALUE ...`.

    Raises:
      ValueError: what follows the preset is no flag.
    """
    preset, *others = shlex.split(name) or ['']
    if not preset or preset[0] == '-' or not all(other.startswith('--') for other in others):
        raise ValueError(f'--train={name}: PRESET or PRESET --FLAG=VALUE was expected')
    return [f'--preset={preset}', *others]


def seeds_of(name: str, count: int) -> range:
    """The seeds of a method of --train: `count` of them, one where nothing is drawn.

    Raises:
      ValueError: no preset of that name, or as `training_flags`.
    """
    return range(count if _draws(name) else 1)


def flags_of_seed(name: str, seed: int) -> list[str]:
    """Flags of the training of a method of --train from a seed, which stands for {seed} in them.

    Raises:
      ValueError: as `seeds_of`.
    """
    given = [flag.replace('{seed}', str(seed)) for flag in training_flags(name)]
    return [*given, *[f'--seed={seed}'] * _draws(name)]


def _draws(name):
    """Whether anything is drawn in the training of a method of --train."""
    preset = training_flags(name)[0].removeprefix('--preset=')
    return hasattr(presets.make_config(preset), 'seed')


def name_of_folder(name: str) -> str:
    """A method of --train as part of a path."""
    return re.sub(r'\W+', '_', name)


def train(data_path: str, model_path: str, flags: list[str], shown: bool = False) -> None:
    """Trains a model, goes on where its training ended, or finds it done; see `_run`."""
    if not _is_trained(model_path):
        _run([f'--data_path={data_path}', f'--model_path={model_path}', *flags], shown)


def _is_trained(model_path):
    """Whether the last checkpoint of a network is that of its last step; a process that only says
    so would take as long to start as a rollout."""
    path = os.path.join(model_path, 'config.json')
    if not os.path.exists(path):
        return False
    config = files.read_json(path).get('config', {})
    total = config.get('num_steps', 0)
    return total > 0 and os.path.exists(os.path.join(model_path, f'ckpt-{total}.json'))


def roll_out(data_path: str, model_path: str, split: str, folder: str) -> str:
    """Rolls a model out over a split; returns the folder of its files.

    The folder is named by what the model is, so a second call finds it done; metrics.json is the
    last file to be written.
    """
    digest = files.sha256_of_file(os.path.join(model_path, 'config.json'))[:6]
    weights = [n for n in sorted(os.listdir(model_path)) if n.endswith('.npz')]
    digest += ''.join(files.sha256_of_file(os.path.join(model_path, n))[:6] for n in weights)
    output = os.path.join(folder, f'{os.path.basename(model_path)}_{digest}', split)
    if not os.path.exists(os.path.join(output, 'metrics.json')):
        _run(
            [
                '--mode=eval_rollout',
                f'--data_path={data_path}',
                f'--model_path={model_path}',
                f'--eval_split={split}',
                f'--output_path={output}',
            ]
        )
    return output


def _run(flags, shown=False):
    """Runs `learning_to_simulate.train`; `shown`: on the terminal.

    Raises:
      ValueError: it failed; the message holds its last lines, where they were not shown.
    """
    # Ends with this process: a worker that is killed leaves no training behind.
    command = [sys.executable, '-m', 'pca_tools.storage.parent', str(os.getpid()), _TRAIN, *flags]
    done = subprocess.run(command, cwd=ROOT, capture_output=not shown, text=True, check=False)
    if done.returncode:
        printed = (done.stdout or '') + (done.stderr or '')
        tail = '\n'.join(printed.strip().splitlines()[-5:])
        raise ValueError(f'learning_to_simulate.train {" ".join(flags)} failed:\n{tail}')


def read(folder: str, split: str, n_run: int, metadata: dict) -> list[RunPrediction]:
    """The predictions of a folder of rollout files, in the order of the records.

    A method that predicts particles and no modes writes them beside DeepMind's keys as
    `predicted_particles` [F, P, 3], `particle_frames` [F] (numbers of the record's frames) and
    `particle_indices` [P].

    Raises:
      FileNotFoundError: a run has no file.
      ValueError: a file holds neither the modes of the dataset nor particles.
    """
    return [
        _prediction(os.path.join(folder, f'rollout_{split}_{record}.npz'), metadata)
        for record in range(n_run)
    ]


def _prediction(path, metadata):
    arrays = files.read_npz(path)
    if lacking := {'predicted_rollout', 'particle_types'} - arrays.keys():
        raise ValueError(f'{path}: lacks {sorted(lacking)}')
    nodes = arrays['predicted_rollout'].astype(np.float64)
    soil = arrays['particle_types'] == dataset.MODE_PARTICLE_ID
    own, modes = {}, None
    if 'predicted_particles' in arrays:
        names = 'predicted_particles', 'particle_frames', 'particle_indices'
        own = {name: arrays[name] for name in names}
    elif soil.sum() == metadata['mode_number']:
        modes = nodes[:, soil]
    else:
        raise ValueError(
            f'{path}: holds {soil.sum()} soil nodes and no predicted_particles; the dataset has '
            f'{metadata["mode_number"]} modes'
        )
    up = metadata.get('scene', {}).get('up_axis', 1)
    # Of several bodies `predicted_forces` is the sum; each is judged.
    bodies = 'predicted_body_forces' in arrays
    force, torque = (
        arrays[key].astype(np.float64).reshape(len(nodes), -1) if key in arrays else None
        for key in ('predicted_body_forces' if bodies else 'predicted_forces', 'predicted_torques')
    )
    return RunPrediction(
        modes=modes,
        own=own,
        force=force,
        height=nodes[:, ~soil, up].mean(axis=1) if (~soil).any() else None,
        torque=torque,
        status=str(arrays['status']) if 'status' in arrays else None,
    )


def from_open_loop(prediction, group, run: int, scene) -> RunPrediction:
    """One run of an `open_loop.Prediction`; what the method does not predict is None."""
    said, n_rigid = prediction.predicts, group.n_rigid
    position = prediction.position[run]
    return RunPrediction(
        modes=position[:, n_rigid:] if 'soil' in said else None,
        force=prediction.force[run] if 'force' in said else None,
        height=position[:, :n_rigid, scene.up_axis].mean(axis=1) if 'height' in said else None,
        torque=prediction.torque[run]
        if 'torque' in said and prediction.torque is not None
        else None,
    )
