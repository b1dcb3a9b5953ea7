"""The swept field on disk, as the registry wants it: train, open, load."""

import dataclasses
import os

import numpy as np
import tqdm

from learning_to_simulate import checkpoints, evaluation, reading_utils
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live import resting_start
from learning_to_simulate.methods.registry import OpenedModel
from learning_to_simulate.methods.subspace_method import data_digests
from learning_to_simulate.methods.swept_field import episodes, fitting, model_files
from learning_to_simulate.methods.swept_field.evaluation import FieldEvaluator, model_of
from pca_tools import dataset, files, folder_lock

METRICS = 'metrics.json'
_OF_A_FIELD = {
    folder_lock.LOCK_NAME, METRICS, checkpoints.WEIGHTS_FILE, resting_start.START_FILE,
    resting_start.SUBSPACE_FILE,
}  # fmt: skip


def train(
    data_path,
    model_path,
    config,
    rigid_motion=None,
    save_every=None,
    take_over_lock=False,
    raw_path=None,
) -> dict:
    """Trains a field and leaves its model folder; a second call finds it done.

    Args:
      data_path: dataset folder with train and valid, subspace and particle samples.
      model_path: model folder, made if absent.
      config: `SweptFieldConfig`.
      rigid_motion: must be None: the tool follows a given path.
      save_every: nothing is saved on the way; a training takes minutes.
      take_over_lock: of `folder_lock.locked`.
      raw_path: must be None: particles come from the dataset's sample.

    Returns:
      the metrics of the valid rollouts, as in `metrics.json`.

    Raises:
      FileNotFoundError: a dataset without subspace or particle sample.
      ValueError: data that a field cannot learn from, or a folder of something else.
    """
    if rigid_motion or raw_path:
        raise ValueError(
            'swept_field takes neither --rigid_motion nor --raw_path: its tool follows a given '
            'path, its particles are those of the dataset'
        )
    metadata = dataset.read_metadata(data_path)
    data = {
        'path': os.path.abspath(data_path),
        'sha256': data_digests(data_path),
        'subspace': checkpoints.subspace_digest(metadata),
    }
    with folder_lock.locked(model_path, take_over_lock):
        if not _finished(model_path, config, data):
            field, facts = fitting.fit(config, data_path, metadata)
            _, summary = _evaluator(field, data_path, metadata, 'valid', facts['force_mean']).run(
                reading_utils.read_groups(data_path, 'valid', metadata), 'valid', _bar
            )
            field.calibration = {
                kind: row['weights_of_this_split'] for kind, row in summary['reliability'].items()
            }
            summary['training'] = facts
            files.write_json(os.path.join(model_path, METRICS), summary)
            cases = metadata.get('cases', {}).get('train', [])
            chosen = episodes.spread_over(len(cases), config.train_runs)
            runs = [cases[i].get('case') for i in chosen]
            written = resting_start.write(model_path, data_path, {})
            data |= {'force_mean': facts['force_mean'], 'runs': runs}
            model_files.save(model_path, field, data, written)
    summary = files.read_json(os.path.join(model_path, METRICS))
    print(evaluation.table(summary))
    print(f'trained {config.preset}: {model_path}')
    return summary


def _bar(runs):
    return tqdm.tqdm(runs, unit='run', desc='valid', disable=None)


def _finished(path, config, data):
    """Whether the folder holds this very model; refuses a folder of something else."""
    present = set(os.listdir(path)) - _OF_A_FIELD
    if not present:
        return False
    if checkpoints.CONFIG_FILE not in present:
        raise ValueError(
            f'{path}: not empty and not a model folder (holds {sorted(present)[:3]}); nothing was '
            f'written'
        )
    stored = checkpoints.read_config(path)
    for key, now in (('config', dataclasses.asdict(config)), ('data', data)):
        old = stored.get(key) or {}
        differing = [k for k, v in now.items() if k != 'path' and old.get(k) != v]
        if differing:
            raise ValueError(
                f'{path}: holds a model of another {key} (differing: {differing[:4]}); nothing was '
                f'written, give another --model_path'
            )
    return True


def _evaluator(field, data_path, metadata, split, force_mean):
    reader = fitting.reader_of(field, data_path, metadata)
    return FieldEvaluator(field, reader, metadata, split, force_mean)


def load(model_path: str):
    """A trained field, as `evaluation.model_of` wraps it; `field` is the `SweptField`.

    Raises:
      FileNotFoundError, ValueError: see `model_files.load`.
    """
    field = model_files.load(model_path)
    mean = checkpoints.read_config(model_path)['data'].get('force_mean', [0.0, 0.0, 0.0])
    return model_of(field, mean)


def open_model(
    model_path, data_path, split, overrides=None, raw_path=None, rigid_correction=True
) -> OpenedModel:
    """A trained field with the runs of a split; see `registry`."""
    if raw_path:
        raise ValueError('--raw_path is for --model=full_space only')
    model = load(model_path)
    field = model.field
    checkpoints.refuse_contradictions(model_path, field.config, overrides or {})
    metadata = dataset.read_metadata(data_path)
    if metadata['mode_number'] != field.scene.n_modes:
        raise ValueError(
            f'{data_path} has {metadata["mode_number"]} modes, the data of {model_path} had '
            f'{field.scene.n_modes}: rollouts are written in the modes of the dataset'
        )
    groups = reading_utils.read_groups(data_path, split, metadata)
    evaluator = _evaluator(field, data_path, metadata, split, model.simulator.statistics.force_mean)
    return OpenedModel(
        model, groups, metadata, evaluator, lambda: _one_step_errors(evaluator, groups)
    )


def _one_step_errors(evaluator, groups):
    """Mean squared errors of the first predicted frame: each frame is a prediction of its own."""
    rows = []
    for group in groups:
        for i in range(len(group.position)):
            run = group.select(i)
            rollout = evaluator.roll_out(run)
            square = (rollout.force[:, 0] - run.force[:, H]) ** 2
            soil = (rollout.position - run.position[:, H:])[:, 0, run.n_rigid :]
            rows.append((float((soil**2).mean()), float(square.mean())))
    soil, force = np.mean(rows, axis=0)
    return {'one_step_position_mse': float(soil), 'one_step_force_mse': float(force)}
