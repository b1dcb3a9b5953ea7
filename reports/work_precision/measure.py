"""The numbers of one row: training, errors and memory in a process of its own, times in turns.

Training and evaluation run in a fresh process each, so that memory and first calls are the row's
own and a row that dies takes nothing with it. Times are taken in one process, all models in turns,
so that a drift of the machine's speed meets them all.
"""

import dataclasses
import hashlib
import json
import math
import os
import resource
import time
from collections.abc import Sequence
from functools import partial

import numpy as np
import tqdm

from learning_to_simulate import checkpoints
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH, TrainConfig
from learning_to_simulate.methods import registry
from pca_tools import dataset, files, subspace
from reports import markdown, timing
from reports.speed import step_latency
from reports.timing import Timing
from reports.work_precision import points

SPLITS = ('valid', 'test')
WARM_UP = 5
# A rollout that takes longer than this is not repeated as often: its spread is small beside it.
SLOW_S, SLOW_ROUNDS = 2.0, 3
# What of `metrics.run_errors` a point keeps for every run.
ERRORS = (
    'soil_mse', 'soil_rms_mm', 'soil_mse_full', 'soil_rms_mm_full', 'rigid_mse',
    'force_relative_l2', 'force_mpe',
)  # fmt: skip


def digest(config: TrainConfig, data_sha256: dict, files_used: Sequence[str] = ()) -> str:
    """sha256 of what a row is made from.

    Args:
      config: only fields that differ from the defaults count, so that a new field with a default
        keeps old rows valid.
      data_sha256: file -> digest of the dataset.
      files_used: what else decides: weights that are loaded instead of trained, an edge list.
    """
    defaults = {f.name: f.default for f in dataclasses.fields(TrainConfig)}
    values = {k: v for k, v in dataclasses.asdict(config).items() if v != defaults[k]}
    parts = [values, data_sha256, [files.sha256_of_file(path) for path in files_used]]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def find_shipped(models_path: str | None, config: TrainConfig, data_sha256: dict) -> str | None:
    """The folder below `models_path` that holds a model of this config and data, if there is
    one."""
    if not models_path or not os.path.isdir(models_path):
        return None
    for name in sorted(os.listdir(models_path)):
        folder = os.path.join(models_path, name)
        if not os.path.isfile(os.path.join(folder, checkpoints.WEIGHTS_FILE)):
            continue
        stored = checkpoints.read_config(folder)
        defaults = dataclasses.asdict(TrainConfig('pcg'))
        same = defaults | stored['config'] == dataclasses.asdict(config)
        if same and stored['data'].get('sha256') == data_sha256:
            return folder
    return None


def train(data_path: str, model_path: str, config) -> float:
    """Trains, or finishes, a row's model; returns the seconds that this call took."""
    start = time.perf_counter()
    registry.train(data_path, model_path, config)
    return time.perf_counter() - start


def open_model(data_path: str, model_path: str, split: str):
    """The evaluator of a trained model, the model, and the runs of a split."""
    opened = registry.open_model(model_path, data_path, split)
    return opened.evaluator, opened.model, opened.groups


def evaluate(data_path: str, model_path: str) -> dict:
    """Errors on valid and test, sizes, and what opening and the first rollout cost.

    Returns:
      fields of `WorkPrecisionPoint`, and 'references': method -> split -> error -> values, for
      staying still, constant velocity and the truncation error.
    """
    base = _peak_memory_mb()
    start = time.perf_counter()
    evaluator, model, groups = open_model(data_path, model_path, 'test')
    load_s = time.perf_counter() - start
    group = _largest(groups)
    start = time.perf_counter()
    seconds = evaluator.roll_out(group).seconds
    first_call_s = time.perf_counter() - start - seconds  # A first call runs twice: see roll_out.
    layout = model.layout(group.n_rigid)
    values = {
        'load_s': load_s,
        'first_call_s': first_call_s,
        'n_node': layout.n_node,
        'n_weight': sum(int(np.prod(v.shape)) for v in model.simulator.trainable_variables),
    }
    summaries = {}
    for split in SPLITS:
        _, _, groups = open_model(data_path, model_path, split)
        summaries[split] = evaluator.run(groups, split)[1]
    # Edges that are made anew in every step are counted on the way.
    edges = [row['edges'] for row in summaries['test']['runs']['model']]
    values['n_edge'] = layout.n_edge or round(float(np.mean(edges)))
    values['peak_memory_mb'], values['base_memory_mb'] = _peak_memory_mb(), base
    values['runs'] = {split: _per_run(s, 'model') for split, s in summaries.items()}
    values['status'], values['note'] = _judge(summaries)
    references = {
        name: {split: _per_run(s, name) for split, s in summaries.items()}
        for name in markdown.TRIVIAL
    }
    floors = dataset.read_metadata(data_path).get('projection_mse', {})
    if all(split in floors for split in SPLITS):
        references['projection'] = {
            split: {
                'soil_mse_full': list(floors[split]),
                'soil_rms_mm_full': [1e3 * math.sqrt(v) for v in floors[split]],
            }
            for split in SPLITS
        }
    return values | {'references': references}


def _peak_memory_mb():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _largest(groups):
    """The first run of the group with the most rigid particles."""
    return max(groups, key=lambda g: g.n_rigid).select(0)


def _per_run(summary, method):
    rows = summary['runs'][method]
    return {name: [row[name] for row in rows] for name in ERRORS if name in rows[0]}


def _judge(summaries):
    """(status, note) of a model's rollouts."""
    status, notes = points.OK, []
    for split, summary in summaries.items():
        runs = summary['runs']['model']
        for kind in sorted({row['status'] for row in runs} - {points.OK}):
            bad = [row for row in runs if row['status'] == kind]
            first = min(row['first_bad_frame'] for row in bad)
            notes.append(f'{kind} in {len(bad)} of {len(runs)} {split} runs, from frame {first}')
        ratio = summary['soil_mse_over_best_trivial']
        if any(row['soil_mse'] is None for row in runs):
            status = 'non_finite'
        elif status == points.OK and ratio is not None and ratio > points.DIVERGED_RATIO:
            status = 'diverged'
            notes.append(f'{split} soil MSE {ratio:.3g} times that of the best trivial predictor')
    return status, '; '.join(notes)


def _rollout_seconds(evaluator, group):
    return evaluator.roll_out(group).seconds


def time_rollouts(data_path: str, model_paths: dict, rounds: int) -> dict[str, Timing]:
    """Times whole rollouts of one test run of all models in turns.

    Args:
      data_path: dataset folder.
      model_paths: key -> model folder.
      rounds: timed rollouts of each, after warm-up; fewer of slow ones.

    Returns:
      key -> `Timing`.
    """
    jobs = {}
    for key, path in tqdm.tqdm(model_paths.items(), 'opening', unit='model', disable=None):
        evaluator, _, groups = open_model(data_path, path, 'test')
        group = _largest(groups)
        slow = evaluator.roll_out(group).seconds > SLOW_S
        jobs[key] = timing.Job(
            partial(_rollout_seconds, evaluator, group),
            group.position.shape[1] - INPUT_SEQUENCE_LENGTH,
            min(rounds, SLOW_ROUNDS) if slow else None,
            0 if slow else WARM_UP,
        )
    return timing.in_turns(jobs, rounds, 'rollouts in turns')


def time_live_steps(data_path: str, model_paths: dict, n_run: int) -> dict[str, Timing]:
    """Times single steps from Python, particles included, run by run in turns.

    Args:
      data_path: dataset folder.
      model_paths: key -> model folder.
      n_run: test runs that each model is stepped through.

    Returns:
      key -> `Timing` of every step; models on particles have no live stepping and no entry.
    """
    jobs = {
        key: timing.Job(step_latency.Timed(f'{path}:{data_path}'), warm_up=0)
        for key, path in tqdm.tqdm(model_paths.items(), 'steppers', unit='model', disable=None)
        if not registry.of_folder(path).on_particles
    }
    return timing.in_turns(jobs, n_run, 'live runs in turns')


def time_decoding(data_path: str, rounds: int) -> Timing | None:
    """Times modes -> particles of one frame, ms; None where the dataset holds no subspace."""
    path = os.path.join(data_path, 'subspace.npz')
    if not os.path.exists(path):
        return None
    space = subspace.Subspace.load(path)
    run = dataset.read_split(data_path, 'test')[0]
    scores = run.position[-1, run.n_rigid :].astype(np.float64)
    job = timing.Job(lambda: space.decode(scores), warm_up=WARM_UP)
    return timing.in_turns({'decoding': job}, rounds)['decoding']
