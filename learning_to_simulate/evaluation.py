"""Rollouts of a model over a split: result files and `metrics.json` (soil fields:
`soil_field.evaluation`).

Each run is rolled out on its own (batch 1), as a user does. A loop is compiled once per number of
rigid particles and warmed up before it is timed.
"""

import json
import os
import re

import numpy as np

from learning_to_simulate import metrics, soil_truth
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.rollout import RolloutFunction, roll_out
from learning_to_simulate.rollout_status import RolloutStatus
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace.subspace_model import Model
from pca_tools import files
from pca_tools.storage import folder_lock

METRICS_FILE = 'metrics.json'


class Evaluator:
    """Keeps the compiled rollouts of one model, so that evaluation during training compiles once.
    Projection errors are used where the `metadata` of the dataset state them. `force_limit` is the
    largest force of the training runs, N, or None if it is not known."""

    def __init__(self, model: Model, metadata: dict, force_limit: float | None = None):
        self._model, self._metadata, self._force_limit = model, metadata, force_limit
        self._functions = {}

    def roll_out(self, group):
        """`Rollout` of one `RunGroup` (its runs as one batch)."""
        key = group.position.shape, group.context_changes
        if key not in self._functions:
            layout = self._model.layout(group.n_rigid)
            self._functions[key] = RolloutFunction(self._model.simulator, layout)
        return roll_out(self._functions[key], group, self._force_limit)

    def run(self, groups, split: str, progress=iter):
        """Rolls out every run of a list of `RunGroup` on its own; `progress` wraps the runs.
        Returns (record index, one-run `RunGroup`, its `Rollout`) of each, sorted by record, and the
        metrics of `summarise`."""
        runs = [(int(g.record[i]), g.select(i)) for g in groups for i in range(len(g.position))]
        runs.sort(key=lambda run: run[0])
        results = [(record, one, self.roll_out(one)) for record, one in progress(runs)]
        return results, summarise(results, self._model, self._metadata, split)


def summarise(results, model, metadata: dict, split: str) -> dict:
    """The metrics of rolled-out runs of a split (record, one-run `RunGroup`, its `Rollout`): per
    run, their mean, and those of the trivial predictors.

    Only `scene` and `statistics` of the model are used. `metadata` is that of the dataset; {} where
    the nodes of the groups are the solver's own particles. `mean` and `runs` are method -> errors:
    `soil_mm` (`soil_truth`), `soil_mse` within the subspace, `rigid_mse`, `height_mm` of a driven
    body, those of `metrics.load_errors`; of the model also its status, edges and times.
    """
    scene, statistics = model.simulator.scene, model.simulator.statistics
    truths = _Truths(metadata, split, scene)
    methods: dict[str, list] = {'model': [], 'stay_still': [], 'constant_velocity': []}
    for record, group, rollout in results:
        # Modes that the model leaves out count as they do in its particles: they say 0. The
        # trivial predictors know all of them, so that they are the same for every model.
        recorded = group.with_left_modes(group.position, as_recorded=True)
        n_frame, n_rigid = recorded.shape[1] - H, group.n_rigid
        soil = truths.of(group, recorded[0, :, n_rigid:])
        axes = metrics.travel_axes(group.position[0, :, :n_rigid], scene.up_axis)
        positions = {
            'model': group.with_left_modes(rollout.position),
            'stay_still': metrics.stay_still(recorded[:, :H], n_frame),
            'constant_velocity': metrics.constant_velocity(recorded[:, :H], n_frame),
        }
        forces = {}
        if scene.has_force:
            true_force = group.force[:, H:]
            forces = {
                'model': rollout.force,
                'stay_still': np.repeat(group.force[:, H - 1 : H], n_frame, axis=1),
                'constant_velocity': np.broadcast_to(statistics.force_mean, true_force.shape),
            }
        for name, rows in methods.items():
            position, truth = positions[name], recorded[:, H:]
            errors = {'rigid_mse': metrics.rigid_mse(position, truth, n_rigid)} if n_rigid else {}
            if scene.rigid_motion == RigidMotion.DRIVEN:
                errors['height_mm'] = metrics.height_mm(position, truth, n_rigid, scene.up_axis)
            errors['soil_mse'] = metrics.soil_mse(position, truth, n_rigid, scene.n_soil)
            errors['soil_mm'] = [soil.soil_mm(soil.of_modes(position[0, :, n_rigid:]))]
            if forces:
                errors |= metrics.load_errors(forces[name], true_force, axes)
            rows.append({'record': record} | {k: float(v[0]) for k, v in errors.items()})
        methods['model'][-1] |= {
            **rollout.judgements[0].fields(),
            'edges': rollout.edges,
            'milliseconds_per_step': 1e3 * rollout.seconds / n_frame,
            'seconds_per_simulated_second': rollout.seconds / (n_frame * scene.dt),
        }
    floors = metadata.get('projection_mse', {}).get(split)
    return _summary(methods, scene, soil.space, floors)


class _Truths:
    """The `soil_truth.SoilTruth` of runs; a dataset is opened once."""

    def __init__(self, metadata, split, scene):
        self._metadata, self._split, self._n_soil = metadata, split, scene.n_soil
        self._readers = {}

    def of(self, group, nodes):
        """Of a one-run group whose soil nodes are [T, r, 3]."""
        folder, split = group.source or ('', self._split)
        if not folder and not self._metadata:
            return soil_truth.of_nodes(nodes, self._n_soil, space=soil_truth.PARTICLES)
        if folder not in self._readers:
            metadata = None if folder else self._metadata
            self._readers[folder] = soil_truth.TruthReader(folder, metadata)
        return self._readers[folder].read(split, int(group.record[0]), nodes, self._n_soil)


def _summary(methods, scene, space, floors):
    mean = {}
    for name, rows in methods.items():
        keys = [k for k, v in rows[0].items() if isinstance(v, float)]
        mean[name] = {k: float(np.mean([row[k] for row in rows])) for k in keys}
        for key in ('milliseconds_per_step', 'seconds_per_simulated_second'):
            if key in mean[name]:
                mean[name][key] = float(np.median([row[key] for row in rows]))
        if 'force_mpe' in mean[name]:
            mean[name]['force_abs_mpe'] = float(np.mean([abs(row['force_mpe']) for row in rows]))
    best = min(mean[name]['soil_mse'] for name in ('stay_still', 'constant_velocity'))
    summary = {
        'scene': scene.name,
        'rigid_motion': str(scene.rigid_motion),
        'soil_error': space,
        'mean': mean,
        'soil_mse_over_best_trivial': mean['model']['soil_mse'] / best if best > 0 else None,
        'projection_mse': None if floors is None else float(np.mean(floors)),
        'force_of_trivial_predictors': 'stay_still: last input force; constant_velocity: mean '
        'force of the training runs',
        'runs': methods,
    }
    return without_nan(summary)


def without_nan(summary: dict) -> dict:
    """A summary with null for what is not a number: JSON has none, and a failed run lacks it."""
    return json.loads(json.dumps(summary), parse_constant=lambda _: None)


def soil_of_run(group, rollout, scene):
    """`SoilTruth` of a one-run `RunGroup`, and the particles [F, P, 3] that its `Rollout` predicts
    for it."""
    n = group.n_rigid
    recorded = group.with_left_modes(group.position, as_recorded=True)[0, :, n:]
    found = _Truths({'mode_number': scene.n_modes}, None, scene).of(group, recorded)
    return found, found.of_modes(group.with_left_modes(rollout.position)[0, :, n:])


def total_force(force):
    """The force [T, 3] on all bodies together, of one [T, 3 B] on each; None for None."""
    return None if force is None else force.reshape(len(force), -1, 3).sum(axis=1)


def save_rollouts(
    path: str, split: str, results, summary: dict, metadata: dict, model_digest: str | None = None
) -> list[str]:
    """Writes `rollout_{split}_{i}.npz` (DeepMind's key names) and `metrics.json`, the summary of
    `summarise`, into a folder, made if absent; returns the file names.

    The files of an older evaluation of the split go when all new ones are complete. `metrics.json`
    goes first and comes last: where it lies, all rollouts beside it are of its evaluation.
    `results` are (record, one-run `RunGroup`, its `Rollout`), without a group where the rollout
    knows the arrays of its file; `model_digest` of `checkpoints.folder_digest` is kept in every
    file, None where there is none.
    """
    names = [f'rollout_{split}_{record}.npz' for record, _, _ in results]

    def fill(folder):
        for name, (_, group, rollout) in zip(names, results, strict=True):
            arrays = rollout.arrays() if group is None else _arrays(group, rollout)
            if group is not None:
                arrays['metadata'] = np.array(json.dumps(metadata))
            arrays |= {k: np.array(v) for k, v in digest.items()}
            files.write_npz(os.path.join(folder, name), **arrays)
        files.write_json(os.path.join(folder, METRICS_FILE), summary | digest)

    digest = {} if model_digest is None else {'model_digest': model_digest}
    old = re.compile(rf'rollout_{split}_\d+\.npz')
    with folder_lock.locked(path):
        files.replace_files(path, fill, lambda name: bool(old.fullmatch(name)), METRICS_FILE)
    return [os.path.join(path, name) for name in (*names, METRICS_FILE)]


def file_arrays(given, predicted, true, types, judgement, force=None, true_force=None) -> dict:
    """The arrays of a rollout file, DeepMind's key names: nodes given [H, V, 3], predicted [T', V,
    3], and true [T', V, 3] or None, m; their types int [V]; the judgement of the rollout; force
    [T', 3] and true force [H + T', 3], N, or None."""
    arrays = {
        'initial_positions': given,
        'predicted_rollout': predicted,
        'ground_truth_rollout': true,
        'initial_forces': None if true_force is None else true_force[:H],
        'predicted_forces': force,
        'ground_truth_forces': None if true_force is None else true_force[H:],
    }
    found = {k: np.asarray(v, np.float32) for k, v in arrays.items() if v is not None}
    more = {'particle_types': types} | judgement.fields()
    return found | {key: np.array(value) for key, value in more.items()}


def _arrays(group, rollout) -> dict:
    """The arrays of one run's file."""
    truth = group.all_particles(group.position, as_recorded=True)[0]
    force, known = None, None
    if rollout.force is not None:
        force, known = total_force(rollout.force[0]), total_force(group.force[0])
    arrays = file_arrays(
        truth[:H], group.all_particles(rollout.position)[0], truth[H:],
        group.all_particle_types(), rollout.judgements[0], force, known,
    )  # fmt: skip
    if group.context is not None:
        arrays['global_context'] = group.context.astype(np.float32)
    if force is not None and force.shape != rollout.force[0].shape:  # of each of several bodies
        each = (len(force), -1, force.shape[1])
        arrays['predicted_body_forces'] = rollout.force[0].reshape(each)
        arrays['ground_truth_body_forces'] = group.force[0, H:].reshape(each).astype(np.float32)
    if group.source is not None:
        arrays |= {'split': np.array(group.source[1]), 'record': group.record[0]}
    return arrays


# What files call the methods -> what is printed.
NAMES = {
    'model': 'model', 'stay_still': 'persistence', 'constant_velocity': 'constant velocity',
    'under_load': 'under its load', 'bekker_wong_janosi': 'Bekker, Wong, Janosi',
}  # fmt: skip
_ROWS = {
    'soil_mm': 'soil error, mm',
    'near_mm': 'height map near the tool, mm',
    'surface_mm': 'whole height map, mm',
    'front_mm': 'front of the heap, mm',
    'cut_error_litre': 'volume of the cut, litres',
    'heap_error_litre': 'volume of the heap, litres',
    'drawbar': 'force along the way (drawbar), N',
    'vertical': 'vertical force, N',
    'side': 'force across, N',
    'force': 'whole force, N',
    'pitch': 'torque in the plane of travel, N m',
    'torque': 'whole torque, N m',
    'height_mm': "body's height, mm",
    'travel_mm': "body's way, mm",
    'rigid_mse': 'body, mean square 1e-4 m2',
    'soil_mse': 'soil within the subspace, mean square 1e-4 m2',
    'force_abs_mpe': 'force, |MPE| %',
    'seconds_per_simulated_second': 'seconds per simulated second',
    'milliseconds_per_step': 'ms per frame',
}
_WIDTH = 24
# Medians by kind of run: name of an error -> head of its column.
_BY_KIND = {
    'soil_mm': 'soil mm', 'near_mm': 'map mm', 'heap_error_litre': 'heap l',
    'force_relative_l2': 'force', 'drawbar_relative_l2': 'drawbar',
    'vertical_relative_l2': 'vertical', 'pitch_relative_l2': 'torque',
}  # fmt: skip


def table(summary: dict) -> str:
    """The metrics as text: errors by row, the model and its trivial neighbours by column."""
    means = summary['mean']
    cells = {key: [_cell(mean, key) for mean in means.values()] for key in _ROWS}
    shown = {key: row for key, row in cells.items() if any(cell != '-' for cell in row)}
    wide = max(len(_ROWS[key]) for key in shown)
    lines = [' ' * wide + ''.join(f'{NAMES.get(name, name):>{_WIDTH}s}' for name in means)]
    for key, row in shown.items():
        lines.append(f'{_ROWS[key]:{wide}s}' + ''.join(f'{cell:>{_WIDTH}s}' for cell in row))
    lines.append(
        f'soil error: root mean square {summary.get("soil_error", "")}. Loads: root mean square '
        f'per component (relative L2), error of the peak. Means over runs; times: medians.'
    )
    if 'kinds' in summary:
        lines += _medians(summary)
    for row in summary['runs']['model']:
        if row['status'] != RolloutStatus.OK:
            case = f' ({row["case"]})' if 'case' in row else ''
            node = f', node {row["first_bad_node"]}' if row['first_bad_node'] >= 0 else ''
            lines.append(
                f'warning: record {row["record"]}{case} is {row["status"]} from frame '
                f'{row["first_bad_frame"]}{node}: {row["status_reason"]}'
            )
    return '\n'.join(lines)


def _medians(summary):
    """Lines of medians by kind of run, of wins and of status, where a summary has them."""
    rows = [('all', summary['median']), *summary['kinds'].items()]
    keys = [k for k in _BY_KIND if any(k in of for _, found in rows for of in found.values())]
    lines = ['medians; loads: relative L2']
    lines.append(f'{"":32s}{"runs":>5s}' + ''.join(f'{_BY_KIND[key]:>10s}' for key in keys))
    for kind, found in rows:
        for method, values in found.items():
            if values:
                numbers = (values.get(key) for key in keys)
                cells = ''.join(f'{"-" if x is None else f"{x:.3g}":>10s}' for x in numbers)
                name = f'{kind}, {NAMES.get(method, method)}'
                lines.append(f'{name:32s}{values["runs"]:5d}{cells}')
    for other, found in summary['wins'].items():
        counts = ', '.join(f'{key} {won} of {all_}' for key, (won, all_) in found.items())
        lines.append(f'model better than {NAMES.get(other, other)}: {counts}')
    return [*lines, 'status: ' + ', '.join(f'{n} {name}' for name, n in summary['status'].items())]


def _cell(mean, key):
    if f'{key}_rmse' in mean:
        values = (mean.get(f'{key}_{name}') for name in ('rmse', 'relative_l2', 'peak_error'))
        size, share, peak = ('-' if value is None else f'{value:.3g}' for value in values)
        return '-' if size == '-' else f'{size} ({share}), {peak}'
    if mean.get(key) is None:
        return '-'
    return f'{mean[key] * (1e4 if key.endswith("_mse") else 1.0):.4g}'
