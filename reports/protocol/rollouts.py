"""Models as the protocol judges them: trained and rolled out by the commands that a user types,
each in a process of its own. The errors are those that an evaluation writes (`metrics.json`)."""

import hashlib
import os
import re
import shlex
import subprocess
import sys

from learning_to_simulate import checkpoints, presets
from pca_tools import dataset, files
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
    if flags is not None and not _is_trained(model_path):
        _run([f'--data_path={data_path}', f'--model_path={model_path}', *flags])
    for split in splits:
        roll_out(data_path, model_path, split, folder)


def trainings(name: str, n_seed: int, folder: str) -> list[tuple[str, list[str]]]:
    """Model folder and flags of each training of a method, `PRESET` or `PRESET --FLAG=VALUE ...`:
    one a seed, in whose flags {seed} stands for it, and a single one where nothing is drawn.

    Raises:
      ValueError: what follows the preset is no flag, or no preset of that name.
    """
    preset, *others = shlex.split(name) or ['']
    if not preset or preset[0] == '-' or not all(other.startswith('--') for other in others):
        raise ValueError(f'{name!r}: PRESET or PRESET --FLAG=VALUE was expected')
    draws = hasattr(presets.make_config(preset), 'seed')
    stem = os.path.join(folder, re.sub(r'\W+', '_', name))
    found = []
    for seed in range(n_seed if draws else 1):
        flags = [f'--preset={preset}', *(other.replace('{seed}', str(seed)) for other in others)]
        found.append((f'{stem}_{seed}', [*flags, *[f'--seed={seed}'] * draws, '--num_threads=1']))
    return found


def digest(data_path: str, split: str) -> str:
    """Of the records of a split of datasets, separated by commas."""
    paths = [dataset.split_path(path, split) for path in data_path.split(',')]
    return hashlib.sha256(''.join(map(files.sha256_of_file, paths)).encode()).hexdigest()


def _is_trained(model_path):
    """Whether a network has the checkpoint of its last step, and what is fitted at once is there; a
    process that only says so would take as long to start as a rollout."""
    path = os.path.join(model_path, 'config.json')
    if not os.path.exists(path):
        return False
    total = files.read_json(path).get('config', {}).get('num_steps')
    return not total or os.path.exists(os.path.join(model_path, f'ckpt-{total}.json'))


def roll_out(data_path: str, model_path: str, split: str, folder: str) -> str:
    """Rolls a model out over a split; returns the folder of its files.

    The folder is named by what model and runs are, so a second call finds it done; metrics.json is
    the last file to be written.
    """
    digests = [checkpoints.folder_digest(model_path), digest(data_path, split)]
    name = '_'.join([os.path.basename(model_path), *(d[:12] for d in digests)])
    output = os.path.join(folder, name, split)
    if not os.path.exists(os.path.join(output, 'metrics.json')):
        _run(
            ['--mode=eval_rollout', f'--data_path={data_path}', f'--model_path={model_path}',
             f'--eval_split={split}', f'--output_path={output}', '--num_threads=1']
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
