"""The document of one scene: what every method's models are wrong by, run by run.

Errors of all methods are of the same frames, axes and particles: those of a dataset's sample, the
solver's own (`soil_truth`). Networks in a subspace follow 5 thousand particles, too few for a map
of heights; so they have no errors of surface, front and heap.
"""

import glob
import hashlib
import os

import numpy as np

from learning_to_simulate import checkpoints, presets, registry
from learning_to_simulate.command import import_tensorflow, named_paths
from mpm.verification import ladder
from pca_tools import dataset, files, workers
from reports import record

SCHEMA_VERSION = 3
SPLIT = 'test'
RIDGE = 'path ridge'
# Columns of an evaluation of a soil field that are methods of their own -> how tables call them.
COLUMNS = {'model': '{}', 'under_load': '{}, under its load'}
PERSISTENCE = 'persistence'
FORMULAS = {'blade': 'earthmoving', 'wheel': 'Bekker-Wong-Janosi'}
# With the soil's own parameters, and times the one factor that fits the train runs best.
RESISTIVE = '3D-RFT', '3D-RFT, fitted'
# Errors of a run that are kept, as `metrics.json` has them.
QUANTITIES = (
    'soil_mm', 'near_mm', 'surface_mm', 'front_mm', 'cut_error_litre', 'heap_error_litre',
    *(f'{load}_{error}' for load in ('force', 'drawbar', 'vertical', 'pitch')
      for error in ('relative_l2', 'rmse', 'peak_error')),
    'side_rmse', 'height_mm', 'travel_mm', 'flagged_share', 'bound_kept', 'bound_newton',
    'near_95_mm', 'payload_litre', 'true_payload_litre', 'payload_error_litre',
)  # fmt: skip
# Of the cases of the ladder whose solutions tell the truth's own errors: how their names begin.
_LADDERS = {'blade': 'excavation', 'wheel': 'wheel'}
LADDER = os.path.join(record.ROOT, 'mpm', 'verification', 'ladder.json')


def folders_of(given: list[str]) -> dict[str, list[str]]:
    """Method -> folders of its models, one a training, of NAME=FOLDER[,FOLDER...]; ValueError for
    another form, or a name that is given twice."""
    named = named_paths('model', [item.rstrip(',') for item in given], 'FOLDER[,FOLDER...]')
    return {name: [os.path.abspath(p) for p in paths.split(',')] for name, paths in named.items()}


def judge(
    data_path: str, methods: dict[str, list[str]], work_path: str, num_processes: int = 1
) -> dict:
    """The document of a scene, of dataset folders separated by commas (all methods know the first;
    the others are for soil fields) and methods of `folders_of`; raises as `make_all`. Rollouts and
    the fitted ridge stay in the work folder, where a second call finds them."""
    from learning_to_simulate.soil_field import evaluation
    from learning_to_simulate.soil_field import runs as runs_lib
    from reports.protocol import resistive_force

    folders = [os.path.abspath(path) for path in data_path.split(',')]
    name = os.path.basename(folders[0])
    output = os.path.join(work_path, 'rollouts', name)
    fitted = os.path.join(work_path, f'{name}_{digest(folders[0], "train")[:12]}')
    ridge = os.path.join(fitted, 'path_ridge_0')
    jobs = {ridge: (folders[0], ridge, presets.make_config('path_ridge'), output)}
    for path in (path for of in methods.values() for path in of):
        data = ','.join(folders) if registry.of_folder(path).on_terrain else folders[0]
        jobs[path] = data, path, None, output
    make_all(list(jobs.values()), num_processes)

    runs = [(i, run) for i, path in enumerate(folders) for run in runs_lib.read(path, SPLIT)]
    tool = runs[0][1].tool.name
    found: list[dict] = []
    for method, paths in (methods | {RIDGE: [ridge]}).items():
        # Seeds of each column; networks have one.
        of_columns: dict[str, list] = {}
        for path in paths:
            folder = roll_out(jobs[path][0], path, output)
            for column, seed in _seeds(path, folder, len(runs)).items():
                of_columns.setdefault(column.format(method), []).append(seed)
        found += [{'name': n, 'seeds': seeds} for n, seeds in of_columns.items()]
    still = [evaluation.still(run) for _, run in runs]
    formula = [evaluation.formula(run) or {} for _, run in runs]
    found.append({'name': FORMULAS[tool], 'seeds': [{'errors': _columns(formula)}]})
    factors = 1.0, resistive_force.gain(runs_lib.read(folders[0], 'train'))
    theory = zip(*(resistive_force.errors(run, factors) for _, run in runs), strict=True)
    for name, factor, rows in zip(RESISTIVE, factors, theory, strict=True):
        about = {'factor': record.four(factor), 'errors': _columns(list(rows))}
        found.append({'name': name, 'seeds': [about]})
    found.append({'name': PERSISTENCE, 'seeds': [{'errors': _columns(still)}]})
    return {
        'schema_version': SCHEMA_VERSION,
        'scene': tool,
        'record': record.provenance(),
        'data': [_facts(path) for path in folders],
        'runs': [{'data': i, 'case': run.case, 'kind': run.kind} for i, run in runs],
        'methods': found,
        'truth': truth_errors(tool),
    }


def make_all(jobs: list[tuple], num_processes: int) -> None:
    """Does jobs of `make`, so many at a time; ValueError: some failed, the others are done."""
    with workers.start('', num_processes) as crew:
        failed = [
            f'{jobs[outcome.index][1]}: {outcome.error}'
            for outcome in crew.run(make, jobs) if outcome.error is not None
        ]  # fmt: skip
    if failed:
        raise ValueError(f'{len(failed)} of {len(jobs)} models failed:\n' + '\n'.join(failed))


def make(job: tuple) -> None:
    """Trains a model and rolls it out, or finds that done: one task of a worker, on one thread. The
    job: dataset folder, model folder, settings of its training or None where it is trained, folder
    of the rollouts or None for none."""
    import_tensorflow(1)
    data_path, model_path, config, folder = job
    if config is not None:
        registry.train(data_path, model_path, config)
    if folder is not None:
        roll_out(data_path, model_path, folder)


def roll_out(data_path: str, model_path: str, folder: str) -> str:
    """Rolls a model out over the test split, as `lts evaluate` does; returns the folder of its
    files. It is named by what model and runs are, so a second call finds it done; metrics.json is
    the last file to be written."""
    digests = [checkpoints.folder_digest(model_path), digest(data_path, SPLIT)]
    name = '_'.join([os.path.basename(model_path), *(d[:12] for d in digests)])
    output = os.path.join(folder, name, SPLIT)
    if not os.path.exists(os.path.join(output, 'metrics.json')):
        from learning_to_simulate import evaluation

        opened = registry.open_model(model_path, data_path, SPLIT)
        results, summary = opened.evaluator.run(opened.groups, SPLIT)
        evaluation.save_rollouts(output, SPLIT, results, summary, opened.metadata, digests[0])
    return output


def digest(data_path: str, split: str) -> str:
    """Of the records of a split of datasets, separated by commas."""
    paths = [dataset.split_path(path, split) for path in data_path.split(',')]
    return hashlib.sha256(''.join(map(files.sha256_of_file, paths)).encode()).hexdigest()


def _facts(path):
    cases = dataset.read_metadata(path)['cases']
    return {
        'path': os.path.relpath(path, record.ROOT),
        'runs': {split: len(of) for split, of in cases.items()},
        'solver_version': cases[SPLIT][0].get('solver_version'),
        'sha256': files.sha256_of_file(dataset.split_path(path, SPLIT)),
    }


def _seeds(path, folder, n_run):
    """Column -> what the document holds of a model: where it is from, and its errors."""
    rows = files.read_json(os.path.join(folder, 'metrics.json'))['runs']
    config = files.read_json(os.path.join(path, 'config.json'))
    about = {'seed': config.get('config', {}).get('seed')}
    if os.path.commonpath([os.path.abspath(path), record.ROOT]) == record.ROOT:
        about['folder'] = os.path.relpath(path, record.ROOT)
    found = {}
    for key, name in COLUMNS.items():
        if key not in rows:
            continue
        of_run = {row['record']: row for row in rows[key]}
        ordered = [of_run.get(i, {}) for i in range(n_run)]
        found[name] = about | {'errors': _columns(ordered)}
        if key == 'model' and (bounds := config.get('field', {}).get('bounds')):
            found[name] |= {'bounds': bounds}
        if key == 'model' and 'field' in config:
            found[name] |= separation(_saved(folder))
    return found


def _columns(rows: list[dict]) -> dict[str, list]:
    """Quantity -> errors of all runs, to four digits; None where there is no number."""
    found: dict[str, list] = {}
    for key in QUANTITIES:
        values = [record.four(row.get(key)) for row in rows]
        if any(value is not None for value in values):
            found[key] = values
    if refused := [i for i, row in enumerate(rows) if row.get('status') == 'non_finite']:
        found['refused'] = refused
    return found


def separation(rollouts) -> dict[str, float | None]:
    """Whether the status of a soil field tells good frames from bad ones, of rollouts: the
    predicted and the true force [T, 3], and which frames [T] are flagged.

    Returns `flagged_frames`, the share of frames that it flags; `error_flagged` and `error_inside`,
    root of the sum of squared errors of the force over that of the force itself, of frames that are
    flagged and of those that are not; without where there are none."""
    squares = np.zeros((2, 3))  # (inside, flagged) by (error, force, frames)
    for force, true, flagged in rollouts:
        if not np.isfinite(force).all():
            continue
        # Runs count alike, however heavy their tool is.
        size = np.linalg.norm(true) / np.sqrt(len(true))
        for i, mask in enumerate((~flagged, flagged)):
            parts = (force - true)[mask] / size, true[mask] / size
            squares[i] += [np.sum(parts[0] ** 2), np.sum(parts[1] ** 2), mask.sum()]
    found = {'flagged_frames': squares[1, 2] / max(squares[:, 2].sum(), 1)}
    for name, (error, force, _) in zip(('error_inside', 'error_flagged'), squares, strict=True):
        if force:
            found[name] = np.sqrt(error / force)
    return {name: record.four(value) for name, value in found.items()}


def _saved(folder):
    """Of the rollouts of a split in a folder what `separation` takes."""
    for path in sorted(glob.glob(os.path.join(folder, f'rollout_{SPLIT}_*.npz'))):
        arrays = files.read_npz(path)
        yield tuple(arrays[n][6:] for n in ('predicted_forces', 'ground_truth_forces', 'flagged'))


def read(path: str) -> dict:
    """A document from its JSON, with its `summary`."""
    document = files.read_json(path)
    return document | {'summary': summary(document)}


def summary(document: dict) -> dict:
    """Of the runs of the first dataset, which all methods know ('all'), of each kind of run, and of
    all other datasets ('others'): method -> quantity -> `figures`."""
    runs = document['runs']
    chosen = {'all': [i for i, run in enumerate(runs) if not run['data']]}
    if others := [i for i, run in enumerate(runs) if run['data']]:
        chosen['others'] = others
    for kind in sorted({run['kind'] for run in runs}):
        chosen[kind] = [i for i, run in enumerate(runs) if run['kind'] == kind]
    return {
        name: {
            method['name']: {
                key: found for key in QUANTITIES if (found := figures(method['seeds'], key, places))
            }
            for method in document['methods']
        }
        for name, places in chosen.items()
    }


def figures(seeds, key: str, places: list[int]) -> dict:
    """`runs`, their number; `mean` and `median` over them, each a list with a number a seed; {}
    where the method says nothing. A run that was refused is infinitely wrong: then the mean is
    None."""
    found: dict = {'runs': 0, 'mean': [], 'median': []}
    for seed in seeds:
        errors, refused = seed['errors'].get(key), seed['errors'].get('refused', ())
        if errors is None:
            return {}
        values = [np.inf if i in refused else errors[i] for i in places]
        values = [value for value in values if value is not None]
        if not values:
            return {}
        for name, figure in (('mean', np.mean), ('median', np.median)):
            found[name].append(record.four(figure(values)))
        found['runs'] = len(values)
    return found


def truth_errors(tool: str) -> dict:
    """How far the ground truth itself is from finer solutions, over the `cases` of a tool: against
    cells that are a third as long across `surface_mm` of the whole bed at the end and
    `force_relative_l2` of means over five frames; against the limit of fine cells
    `drawbar_relative_l2`, of the mean force along the way (upwards where that matters). Each a list
    with a number a case."""
    names = 'surface_mm', 'force_relative_l2', 'drawbar_relative_l2'
    found: dict = {name: [] for name in ('cases', *names)}
    for name, runs in files.read_json(LADDER)['cases'].items():
        is_case = name in ladder.CASES and name.startswith(_LADDERS[tool])
        if not is_case or 'cubic' not in runs:
            continue
        compared = ladder.compared(runs['base'], runs['cubic'])
        cells, forces = ladder.over_cells(name, runs)
        base = np.mean(runs['base']['force'], axis=0)[ladder.CASES[name][2]]
        limit = ladder.limit(cells, forces)[0]
        found['cases'].append(name)
        values = compared['surface_mm'], compared['force_5_frames'], abs(base / limit - 1.0)
        for key, value in zip(names, values, strict=True):
            found[key].append(record.four(value))
    return found
