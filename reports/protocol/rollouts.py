"""Models as the protocol judges them: trained and rolled out by the commands that a user types,
each in a process of its own. The errors are those that an evaluation writes (`metrics.json`)."""

import hashlib
import os
import subprocess
import sys

from learning_to_simulate import checkpoints, presets
from pca_tools import dataset, files, workers
from reports.record import ROOT

SPLIT = 'test'
_TRAIN = 'learning_to_simulate.train'


def make(job: tuple) -> None:
    """Trains a model and rolls it out, or finds that done: one task of a worker.

    Args:
      job: (dataset folder, model folder, flags of its training or None where it is trained, folder
        of the rollouts or None for none); all on a disk that this process sees.

    Raises:
      ValueError: see `_run`.
    """
    data_path, model_path, flags, folder = job
    if flags is not None and not _is_trained(model_path):
        _run([f'--data_path={data_path}', f'--model_path={model_path}', *flags])
    if folder is not None:
        roll_out(data_path, model_path, folder)


def all_made(jobs: list[tuple], num_processes: int) -> None:
    """Does jobs of `make`, so many at a time.

    Raises:
      ValueError: some failed; the others are done.
    """
    with workers.start('', num_processes) as crew:
        failed = [
            f'{jobs[outcome.index][1]}: {outcome.error}'
            for outcome in crew.run(make, jobs) if outcome.error is not None
        ]  # fmt: skip
    if failed:
        raise ValueError(f'{len(failed)} of {len(jobs)} models failed:\n' + '\n'.join(failed))


def trainings(preset: str, options: list[str], n_seed: int, stem: str) -> dict[str, list[str]]:
    """Model folder, `<stem>_<seed>`, -> flags of each training of a preset with further flags: one
    a seed, in whose flags {seed} stands for it, and a single one where nothing is drawn."""
    draws = hasattr(presets.make_config(preset), 'seed')
    found = {}
    for seed in range(n_seed if draws else 1):
        flags = [f'--preset={preset}', *(option.replace('{seed}', str(seed)) for option in options)]
        found[f'{stem}_{seed}'] = [*flags, *[f'--seed={seed}'] * draws, '--num_threads=1']
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


def roll_out(data_path: str, model_path: str, folder: str) -> str:
    """Rolls a model out over the test split; returns the folder of its files.

    The folder is named by what model and runs are, so a second call finds it done; metrics.json is
    the last file to be written.
    """
    digests = [checkpoints.folder_digest(model_path), digest(data_path, SPLIT)]
    name = '_'.join([os.path.basename(model_path), *(d[:12] for d in digests)])
    output = os.path.join(folder, name, SPLIT)
    if not os.path.exists(os.path.join(output, 'metrics.json')):
        _run(
            ['--mode=eval_rollout', f'--data_path={data_path}', f'--model_path={model_path}',
             f'--eval_split={SPLIT}', f'--output_path={output}', '--num_threads=1']
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
