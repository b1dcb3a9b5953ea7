"""The soil field on disk, as the registry wants it: train, open, load.

A data path is one dataset folder or several, separated by commas: blades of one and of two bins
train one model. While a model is trained its folder holds `training.npz`: the same command again
goes on from there. Losses and the errors of valid runs are written for TensorBoard as well.
"""

import dataclasses
import json
import os

import numpy as np
import tensorflow as tf
import tqdm

from learning_to_simulate import checkpoints, evaluation
from learning_to_simulate.registry import OpenedModel
from learning_to_simulate.soil_field import field as field_lib
from learning_to_simulate.soil_field import runs as runs_lib
from learning_to_simulate.soil_field import samples, training
from learning_to_simulate.soil_field.evaluation import SoilEvaluator, bounds_of
from learning_to_simulate.soil_field.runs import Run
from learning_to_simulate.soil_field.settings import SCHEDULES
from learning_to_simulate.training.loop import StopSignals
from pca_tools import dataset, files
from pca_tools.storage import folder_lock

load = field_lib.load
METRICS, TRAINING = 'metrics.json', 'training.npz'
# What a model learns from of a dataset.
_LEARNED = 'metadata.json', 'train.tfrecord', 'heights_train.npz', 'particles_train.npz'


def train(data_path, model_path, config, options) -> dict:
    """Trains a field and leaves its model folder, goes on with it, or finds it done; see
    `registry.train`. Without valid runs there are no metrics, and nothing that keeps a network of
    another field that has become worse."""
    if options.rigid_motion:
        raise ValueError(
            'soil_field takes no --rigid_motion: its tool follows a given path, or one that '
            'follows from its load'
        )
    folders = data_path.split(',')
    data = {
        'path': data_path,
        'sha256': [checkpoints.digests(folder, _LEARNED) for folder in folders],
    }
    first = None
    if options.initial_weights:
        first = load(options.initial_weights)
        data['initial_weights'] = checkpoints.folder_digest(options.initial_weights)
    parts = {'config': dataclasses.asdict(config), 'data': data}
    own = METRICS, checkpoints.WEIGHTS_FILE, TRAINING
    with folder_lock.locked(model_path):
        if not checkpoints.holds_model(model_path, parts, own):
            saved = Saved(model_path, parts, options.steps_between_saves(config.num_steps))
            valid = runs_lib.read_all(folders, 'valid', is_needed=False)
            runs = runs_lib.read_all(folders, 'train')
            tool = one_tool(runs + valid, data_path)
            made = training.make_field(config, tool, first=first)
            steps = ', '.join(
                f'{name} {longer * config.num_steps}'
                for name, (_, longer, _) in SCHEDULES[tool].items()
            )
            print(f'{config.preset}: {len(runs)} runs of a {tool}; steps: {steps}')
            # The ranges of a field are those of the runs that come last.
            held = None  # runs as they are judge, not copies of them
            if first and valid:
                held = training.parts_of(made, valid, _bar('valid'), copies=False)
            several = options.num_processes
            pools = training.parts_of(made, runs, _bar('samples'), processes=several)
            events = tf.summary.create_file_writer(model_path)
            with StopSignals() as saved.stop, events.as_default():
                losses = training.fit(made, pools, saved=saved, held=held)
            if valid:
                judge = SoilEvaluator(made, under_load=False)
                results, summary = judge.run(valid, 'valid', _bar('valid'))
                made.bounds = bounds_of(results, summary['runs']['model'])
                summary['training'] = losses
                files.write_json(os.path.join(model_path, METRICS), summary)
                with events.as_default():
                    for name in ('soil_mm', 'force_relative_l2', 'torque_relative_l2'):
                        value = summary['mean']['model'].get(name)
                        if value is not None:  # runs without particles, a model that failed
                            tf.summary.scalar(f'valid/{name}', value, step=config.num_steps)
            events.close()
            made.data = data | {'runs': [f'{run.kind} {run.case}' for run in runs]}
            field_lib.save(model_path, made)
            saved.remove()
    summary = {}
    if os.path.exists(metrics := os.path.join(model_path, METRICS)):
        summary = files.read_json(metrics)
        print(evaluation.table(summary))
    print(f'trained {config.preset}: {model_path}')
    return summary


class Saved:
    """A training of several networks on disk, as `training.fit` saves it every so many steps:
    nothing that was trained is lost when it is killed. `parts` say, for JSON, what is trained and
    on what, `stop` are `StopSignals` that end it after the step at hand. ValueError for a damaged
    file, or one of another training."""

    def __init__(self, model_path: str, parts: dict, every: int):
        self._path, self._every = os.path.join(model_path, TRAINING), every
        self._arrays = {'of': np.array(json.dumps(parts, sort_keys=True))}
        self.stop: StopSignals | None = None
        if os.path.exists(self._path):
            arrays = files.read_npz(self._path)
            if str(arrays.get('of')) != str(self._arrays['of']):
                raise ValueError(
                    f'{self._path}: is of a training with other settings or data; give another '
                    f'--model_path, or delete the file to begin anew'
                )
            self._arrays = arrays

    def restore(self, name: str, variables) -> tuple[int, list[float]]:
        """Number of steps that a network has done, and its last losses; sets its variables."""
        if f'{name}/step' not in self._arrays:
            return 0, []
        for i, variable in enumerate(variables):
            variable.assign(self._arrays[f'{name}/{i}'])
        step = int(self._arrays[f'{name}/step'])
        print(f'the {name} goes on at step {step}')
        return step, self._arrays[f'{name}/losses'].tolist()

    def keep(self, name: str, step: int, last: bool, variables, losses) -> None:
        """Writes what a network is after a step, where it is due; SystemExit where somebody asked
        for an end."""
        number = self.stop.number if self.stop else None
        if not (step % self._every == 0 or last or number):
            return
        self._arrays |= {f'{name}/{i}': np.asarray(v) for i, v in enumerate(variables)}
        self._arrays |= {f'{name}/step': np.array(step), f'{name}/losses': np.array(losses)}
        files.write_npz(self._path, **self._arrays)
        if number:
            print(f'stopped; step {step} of the {name} is saved, go on by the same call')
            raise SystemExit(self.stop.exit_code)  # type: ignore[union-attr]

    def remove(self) -> None:
        os.remove(self._path)


def one_tool(runs: list[Run], data_path: str) -> str:
    """The name of the kind of tool of all runs; ValueError for no runs, or runs of blades and of
    wheels."""
    kinds = sorted({run.tool.name for run in runs})
    if len(kinds) != 1:
        found = f'runs of {" and ".join(kinds)}' if kinds else 'no runs'
        raise ValueError(f'{data_path}: has {found}; a soil field knows one kind of tool')
    return kinds[0]


def _bar(name):
    return lambda runs: tqdm.tqdm(runs, unit='run', desc=name, disable=None)


def open_model(model_path, data_path, split, raw_path=None) -> OpenedModel:
    """A trained field with the runs of a split of one or several datasets; see `registry`."""
    return opened(load(model_path), model_path, data_path, split)


def opened(field: field_lib.SoilField, model_path: str, data_path: str, split: str) -> OpenedModel:
    """`open_model` of a field that is in memory."""
    folders = data_path.split(',')
    runs = runs_lib.read_all(folders, split)
    known, found = field.networks.tool.name, one_tool(runs, data_path)
    if known != found:
        raise ValueError(
            f'{data_path} has runs of a {found}, the model in {model_path} knows a {known}'
        )
    metadata = dataset.read_metadata(folders[0])
    return OpenedModel(
        field, runs, metadata, SoilEvaluator(field), lambda: _one_step_errors(field, runs)
    )


def _one_step_errors(field, runs) -> dict[str, float]:
    """Mean squared errors of loads on the terrain as it was recorded: each frame is a prediction of
    its own."""
    rows = []
    for run in runs:
        whole = samples.episode_of(run)
        off = field.loads(whole.frames).mean(axis=0) - whole.loads
        off = off * run.tool.units(run.soil)
        rows.append([np.mean(np.square(off[:, part])) for part in (slice(0, 3), slice(3, 6))])
    force, torque = np.mean(rows, axis=0)
    return {'one_step_force_mse': float(force), 'one_step_torque_mse': float(torque)}
