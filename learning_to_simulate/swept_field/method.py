"""The swept field on disk, as the registry wants it: train, open, load."""

import dataclasses
import os

import numpy as np
import tqdm

from learning_to_simulate import checkpoints, evaluation, reading_utils
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live import starts
from learning_to_simulate.registry import OpenedModel
from learning_to_simulate.swept_field import field as field_lib
from learning_to_simulate.swept_field import training
from learning_to_simulate.swept_field.episodes import EpisodeReader
from learning_to_simulate.swept_field.evaluation import FieldEvaluator, model_of
from pca_tools import dataset, files, particles, splits
from pca_tools.storage import folder_lock

METRICS = 'metrics.json'


def train(data_path, model_path, config, options) -> dict:
    """Trains a field and leaves its model folder, or finds it done; see `registry.train`.

    The dataset needs its subspace and a sample of particles; nothing is saved on the way, a
    training takes minutes. Without valid runs there are no metrics, and frames have no bound.
    """
    if options.rigid_motion or options.raw_path:
        raise ValueError(
            'swept_field takes neither --rigid_motion nor --raw_path: its tool follows a given '
            'path, its particles are those of the dataset'
        )
    metadata = dataset.read_metadata(data_path)
    data = checkpoints.data_record(data_path, metadata)
    parts = {'config': dataclasses.asdict(config), 'data': data}
    own = METRICS, checkpoints.WEIGHTS_FILE
    with folder_lock.locked(model_path, options.take_over_lock):
        if not checkpoints.holds_model(model_path, parts, own):
            valid = _valid_runs(data_path, metadata)
            field, facts = training.fit(config, data_path, metadata)
            if valid:
                evaluator = _evaluator(field, data_path, metadata, 'valid', facts['force_mean'])
                _, summary = evaluator.run(valid, 'valid', _bar)
                field.calibration = {
                    kind: row['weights_of_this_split']
                    for kind, row in summary['reliability'].items()
                }
                summary['training'] = facts
                files.write_json(os.path.join(model_path, METRICS), summary)
            cases = metadata.get('cases', {}).get('train', [])
            chosen = splits.spread_over(len(cases), config.train_runs)
            runs = [cases[i].get('case') for i in chosen]
            written = starts.write(model_path, data_path, {})
            data |= {'force_mean': facts['force_mean'], 'runs': runs}
            field_lib.save(model_path, field, data, written)
    summary = {}
    if os.path.exists(metrics := os.path.join(model_path, METRICS)):
        summary = files.read_json(metrics)
        print(evaluation.table(summary))
    else:
        print(f'{data_path}: no valid runs, so nothing is judged and frames have no bound')
    print(f'trained {config.preset}: {model_path}')
    return summary


def _valid_runs(data_path, metadata):
    """The `RunGroup`s of valid, with their particles; [] where there are none."""
    if not os.path.exists(dataset.split_path(data_path, 'valid')):
        return []
    groups = reading_utils.read_groups(data_path, 'valid', metadata)
    if groups:
        particles.read_sample(data_path, 'valid')  # missed now and not after the training
    return groups


def _bar(runs):
    return tqdm.tqdm(runs, unit='run', desc='valid', disable=None)


def _evaluator(field, data_path, metadata, split, force_mean):
    reader = EpisodeReader(data_path, metadata, field)
    return FieldEvaluator(field, reader, metadata, split, force_mean)


def load(model_path: str):
    """A trained field, as `evaluation.model_of` wraps it; `field` is the `SweptField`.

    Raises:
      FileNotFoundError, ValueError: see `field_lib.load`.
    """
    field = field_lib.load(model_path)
    mean = checkpoints.read_config(model_path)['data'].get('force_mean', [0.0, 0.0, 0.0])
    return model_of(field, mean)


def open_model(model_path, data_path, split, overrides=None, raw_path=None) -> OpenedModel:
    """A trained field with the runs of a split; see `registry`."""
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
