"""How good a method is on data of a dozen runs: every run judged by models that did not see it.

The runs of all splits are dealt into folds. Of each fold the other runs train, but for
`--num_valid` of them by which a method may choose (the widths of a ridge); the fold's own are only
judged. Each method is trained anew on every fold, from as many seeds as asked for. The subspace and
what metadata.json says of the data stay as they are.

Examples:
    # your own dozen runs
    python -m reports cross_validation --data_path=my_data --train='path_ridge_few_runs,pcg' \\
        --work_path=build/folds --output_path=build/cross_validation.json

    # the authors' records: eleven and twelve runs
    python -m reports cross_validation --data_path=../original/Excavation_PCA \\
        --train='path_ridge_few_runs,pcg' --work_path=build/folds \\
        --output_path=docs/cross_validation.json

A second call goes on, and keeps the rows of other data and methods.
"""

import os
import shutil

import numpy as np
from absl import flags

from pca_tools import dataset, files, subset
from pca_tools.metadata import SPLITS
from pca_tools.splits import spread_over
from reports import command, markdown, record
from reports.protocol import rollouts
from reports.training_curve import KEYS, OF_THE_TRAINING, mean_of

SCHEMA_VERSION = 1
_DONE = 'folds.json'


def deal(n_run: int, n_fold: int, n_valid: int) -> list[dict[str, list[int]]]:
    """Deals runs to the splits of each fold.

    Args:
      n_run: how many there are. Neighbours may be alike (cases count through a grid), so a fold
        takes every `n_fold`-th.
      n_fold: folds.
      n_valid: runs of a fold's training that choose; spread over them.

    Returns:
      of each fold, split -> places of its runs; each run is once in 'test'.

    Raises:
      ValueError: fewer than two folds, or too few runs to train, choose and judge in each.
    """
    if not 2 <= n_fold <= n_run:
        raise ValueError(f'{n_fold} folds of {n_run} runs; at least 2 and at most as many as runs')
    folds = []
    for fold in range(n_fold):
        rest = [run for run in range(n_run) if run % n_fold != fold]
        if not 1 <= n_valid < len(rest):
            raise ValueError(f'{n_valid} runs of {len(rest)} that are not judged cannot be valid')
        chosen = {rest[place] for place in spread_over(len(rest), n_valid)}
        folds.append(
            {
                'train': [run for run in rest if run not in chosen],
                'valid': sorted(chosen),
                'test': list(range(fold, n_run, n_fold)),
            }
        )
    return folds


def make_folds(data_path: str, n_fold: int, n_valid: int, work_path: str) -> list[str]:
    """Writes a dataset folder for each fold, or finds them there; returns their paths.

    Args:
      data_path: a dataset of `pca_tools.convert`, or a folder in the authors' form: records,
        metadata.json and the files of the subspace, which are copied.
      n_fold, n_valid: of `deal`.
      work_path: folder for the folds.

    Raises:
      ValueError: as of `deal`, or other folds in `work_path`.
    """
    held = [split for split in SPLITS if os.path.exists(dataset.split_path(data_path, split))]
    runs = [run for split in held for run in dataset.read_split(data_path, split)]
    dealt = deal(len(runs), n_fold, n_valid)
    facts = {'folds': dealt, 'digests': [files.sha256_of_file(dataset.split_path(data_path, s))
                                         for s in held]}  # fmt: skip
    marker = os.path.join(work_path, _DONE)
    folders = [os.path.join(work_path, f'fold_{fold}') for fold in range(n_fold)]
    if os.path.exists(marker):
        if files.read_json(marker) != facts:
            raise ValueError(f'{work_path}: holds folds of other runs or another number of them')
        return folders
    is_ours = files.check_manifest(data_path) is not None
    for folder, parts in zip(folders, dealt, strict=True):
        shutil.rmtree(folder, ignore_errors=True)  # of a call that was killed
        if is_ours:
            subset.deal(data_path, folder, parts)
            continue
        os.makedirs(folder, exist_ok=True)
        for name in sorted(os.listdir(data_path)):
            if not name.endswith('.tfrecord'):
                shutil.copy(os.path.join(data_path, name), folder)
        for split, places in parts.items():
            dataset.write_split(dataset.split_path(folder, split), [runs[p] for p in places])
    files.write_json(marker, facts)
    return folders


def measure(folders: list[str], method: str, seed: int, work_path: str) -> dict:
    """Trains a method on every fold, rolls it out over the fold's own runs.

    Args:
      folders: of `make_folds`.
      method: `PRESET --FLAG=VALUE ...`, as of `reports.protocol`.
      seed: of the trainings; of no meaning to a method that draws nothing.
      work_path: folder for models and rollouts.

    Returns:
      predictor ('model' and the trivial ones) -> errors of all runs, fold by fold.
    """
    found: dict[str, list] = {}
    for fold, folder in enumerate(folders):
        name = f'{rollouts.name_of_folder(method)}_{seed}_fold_{fold}'
        model = os.path.join(work_path, 'models', name)
        rollouts.train(folder, model, rollouts.flags_of_seed(method, seed))
        output = rollouts.roll_out(folder, model, 'test', os.path.join(work_path, 'rollouts'))
        errors = files.read_json(os.path.join(output, 'metrics.json'))['runs']
        for predictor, runs in errors.items():
            found.setdefault(predictor, []).extend({k: run.get(k) for k in KEYS} for run in runs)
        print(f'{method}, seed {seed}, fold {fold}: {output}', flush=True)
    return found


def table(path: str) -> str:
    """Errors over all runs: mean and range over seeds of the means over runs; wins beside them."""
    header = ('data, runs', 'method', 'runs seen', 'soil MSE 1e-4 m²', 'median',
              'against the better trivial', 'force rel. L2', 'mean size of MPE %')  # fmt: skip
    lines: list[tuple] = []
    rows = files.read_json(path)['rows'].values()
    order = list(dict.fromkeys(row['data'] for row in rows))
    for row in sorted(rows, key=lambda row: (order.index(row['data']), row['folds'])):
        first = row['seeds'][0]
        where = f'{row["data"]}, {len(first["model"])}'
        if where not in {line[0] for line in lines}:
            lines += [
                (where, f'*{text}*', '', *_cells([first[name]], None))
                for name, text in markdown.TRIVIAL.items()
            ]
        seeds = [seed['model'] for seed in row['seeds']]
        count = f' ({len(seeds)} seeds)' if len(seeds) > 1 else ''
        n_run = len(first['model'])
        seen = [n_run - len(range(fold, n_run, row['folds'])) for fold in range(row['folds'])]
        method = OF_THE_TRAINING.sub('', row['method']) + count
        lines.append((where, method, markdown.span(seen), *_cells(seeds, first)))
    return markdown.table(header, lines)


def _cells(seeds, trivial):
    """Cells of one method: `seeds` holds the runs' errors of each seed."""
    soil = [[run['soil_mse'] for run in runs] for runs in seeds]
    beside = ''
    if trivial is not None:
        better = np.min([[run['soil_mse'] for run in trivial[k]] for k in markdown.TRIVIAL], axis=0)
        own = np.array([[np.inf if v is None else v for v in runs] for runs in soil])
        beside = f'wins {markdown.span((own < better).sum(axis=1))} of {own.shape[1]}'
    mean = [mean_of(runs, 'soil_mse') for runs in seeds]
    median = [float(np.median([np.inf if v is None else v for v in runs])) for runs in soil]
    return (
        markdown.span([None if v is None else 1e4 * v for v in mean]),
        markdown.span([1e4 * v for v in median]),
        beside,
        markdown.span([mean_of(runs, 'force_relative_l2') for runs in seeds]),
        markdown.span([mean_of(runs, 'force_mpe') for runs in seeds]),
    )


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('data_path', None, 'Folder of records.', required=True)
    flags.DEFINE_list('train', None, 'Presets, "PRESET --FLAG=VALUE".', required=True)
    flags.DEFINE_integer('num_folds', 4, 'Folds.', 2)
    flags.DEFINE_integer('num_valid', 2, 'Runs of the training by which a method may choose.', 1)
    flags.DEFINE_integer('num_seeds', 1, 'Seeds of each method; one for what has none.', 1)
    flags.DEFINE_string('work_path', None, 'Folder for folds and trainings; calls resume.',
                        required=True)  # fmt: skip
    flags.DEFINE_string('output_path', None, 'JSON file; its rows are kept.', required=True)


def main(values, _) -> None:
    """Runs the command."""
    asked = {method: rollouts.seeds_of(method, values.num_seeds) for method in values.train}
    name = os.path.basename(os.path.normpath(values.data_path))
    work_path = os.path.join(values.work_path, f'{name}_{values.num_folds}')
    folders = make_folds(values.data_path, values.num_folds, values.num_valid, work_path)
    path = values.output_path
    held = files.read_json(path)['rows'] if os.path.exists(path) else {}
    for method, wanted in asked.items():
        seeds = []
        for seed in wanted:
            seeds.append(measure(folders, method, seed, work_path))
            held[f'{name} {method} {len(folders)}'] = {
                'data': name, 'method': method, 'folds': values.num_folds, 'seeds': seeds,
                'record': record.provenance(),
            }  # fmt: skip
            files.write_json(path, {'schema_version': SCHEMA_VERSION, 'rows': held})
    print(table(path))
    print(f'wrote {path}')


if __name__ == '__main__':
    command.start(define_flags, main)
