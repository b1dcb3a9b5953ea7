"""Models as the protocol judges them: trained and rolled out by the commands that a user types,
each in a process of its own. The errors are those that an evaluation writes (`metrics.json`)."""

import glob
import os
import re
import shlex
import subprocess
import sys

import numpy as np

from learning_to_simulate import checkpoints, command, presets
from pca_tools import files
from reports.record import ROOT

_TRAIN = 'learning_to_simulate.train'
LOADS = ('force', 'drawbar', 'vertical', 'torque', 'pitch')
# Errors of a run: key in metrics.json -> key in documents.
_ERRORS = {'soil_mm': 'soil_mm', 'height_mm': 'height_mm', 'status': 'status'} | {
    f'{load}_{name}': f'{load}_{short}'
    for load in LOADS
    for name, short in (('relative_l2', 'l2'), ('rmse', 'n'), ('peak_error', 'peak_n'))
}
# What a training logs of valid at its checkpoints.
_LOGGED = {'rollout_error_mse': 'soil_mse', 'force_error_mse': 'force_mse'}


def make(job: tuple) -> None:
    """Trains a model and rolls it out over splits, or finds that done: one task of a worker.

    Args:
      job: (dataset folder, model folder, flags of its training or None where it is trained,
        splits, folder of the rollouts); all on a disk that this process sees.

    Raises:
      ValueError: see `_run`.
    """
    data_path, model_path, flags, splits, folder = job
    if flags is not None and not _is_trained(model_path):
        _run([f'--data_path={data_path}', f'--model_path={model_path}', *flags])
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


def trainings(name: str, n_seed: int, folder: str) -> list[tuple[str, list[str]]]:
    """Model folder and flags of each training of a method of --train: one a seed, in whose flags
    {seed} stands for it, and a single one where nothing is drawn.

    Raises:
      ValueError: no preset of that name, or as `training_flags`.
    """
    given = training_flags(name)
    draws = hasattr(presets.make_config(given[0].removeprefix('--preset=')), 'seed')
    stem = os.path.join(folder, re.sub(r'\W+', '_', name))
    found = []
    for seed in range(n_seed if draws else 1):
        flags = [flag.replace('{seed}', str(seed)) for flag in given]
        found.append((f'{stem}_{seed}', [*flags, *[f'--seed={seed}'] * draws, '--num_threads=1']))
    return found


def _is_trained(model_path):
    """Whether the last checkpoint of a network is that of its last step; a process that only says
    so would take as long to start as a rollout."""
    path = os.path.join(model_path, 'config.json')
    total = files.read_json(path).get('config', {}).get('num_steps') if os.path.exists(path) else 0
    return bool(total) and os.path.exists(os.path.join(model_path, f'ckpt-{total}.json'))


def roll_out(data_path: str, model_path: str, split: str, folder: str) -> str:
    """Rolls a model out over a split; returns the folder of its files.

    The folder is named by what the model is, so a second call finds it done; metrics.json is the
    last file to be written.
    """
    name = f'{os.path.basename(model_path)}_{checkpoints.folder_digest(model_path)[:12]}'
    output = os.path.join(folder, name, split)
    if not os.path.exists(os.path.join(output, 'metrics.json')):
        _run(
            ['--mode=eval_rollout', f'--data_path={data_path}', f'--model_path={model_path}',
             f'--eval_split={split}', f'--output_path={output}']
        )  # fmt: skip
    return output


def _run(flags):
    """Runs `learning_to_simulate.train`.

    Raises:
      ValueError: it failed; the message holds its last lines.
    """
    # Ends with this process: a worker that is killed leaves no training behind.
    program = [sys.executable, '-m', 'pca_tools.storage.parent', str(os.getpid()), _TRAIN, *flags]
    done = subprocess.run(program, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        tail = '\n'.join((done.stdout + done.stderr).strip().splitlines()[-5:])
        raise ValueError(f'{_TRAIN} {" ".join(flags)} failed:\n{tail}')


def read(folder: str, method: str = 'model', said: tuple[str, ...] | None = None) -> list[dict]:
    """Errors of every run of a split, in the order of the records.

    Args:
      folder: of `roll_out`.
      method: 'model', or a trivial predictor that stands beside it: 'stay_still',
        'constant_velocity'.
      said: first words of the errors that count ('soil', 'force'); None for all there are.

    Raises:
      ValueError: not one row for each record.
    """
    path = os.path.join(folder, 'metrics.json')
    rows = files.read_json(path)['runs'][method]
    if [row['record'] for row in rows] != list(range(len(rows))):
        raise ValueError(f'{path}: runs are not the records of a split; remove the folder')
    return [
        {
            _ERRORS[key]: value
            for key, value in row.items()
            if key in _ERRORS and (said is None or key.partition('_')[0] in said)
        }
        for row in rows
    ]


def curve(model_path: str) -> list[dict]:
    """What a training logged of valid at its checkpoints: [{step, soil_mse, force_mse}], by step.

    Steps that were trained twice, after a training was killed, count as they were last. Empty for a
    method that is fitted at once.
    """
    command.import_tensorflow()
    import tensorflow as tf

    found: dict[int, dict] = {}
    for path in sorted(glob.glob(os.path.join(model_path, 'events.*'))):
        for event in tf.compat.v1.train.summary_iterator(path):
            for value in event.summary.value:
                if value.tag in _LOGGED:
                    number = float(tf.make_ndarray(value.tensor))
                    row = found.setdefault(event.step + 1, {'step': event.step + 1})
                    row[_LOGGED[value.tag]] = number if np.isfinite(number) else None
    return [found[step] for step in sorted(found)]
