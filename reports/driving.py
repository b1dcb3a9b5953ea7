"""Rollouts of free driving: what the modes allow, and what each model makes of it, by kind of run.

A quick look beside `reports.protocol`, which fits all baselines: models are rolled out in one
process, and errors in full space are those in the modes with the truncation error added.

Example:
    python -m reports.driving --data_path=my_data --model=mlp_driven=/models/a \\
        --model=mlp_driven=/models/b --output_path=docs/driving.json
    python -m reports documents docs/driving.md
"""

import os

import numpy as np
import tqdm
from absl import flags

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from pca_tools import dataset, files
from reports import command, markdown, record

SPLITS = ('valid', 'test')
COUNTS = (8, 16, 24, 32, 48, 64, 96, 128)
STILL = 'persistence'


def kinds_of(metadata: dict, split: str) -> list[str]:
    """Kind of path of each run of a split."""
    return [case.get('kind') or 'grid' for case in metadata['cases'][split]]


def truncation_of(trajectories, projection_mse, n_soil: int) -> dict[int, np.ndarray]:
    """What the first so many modes cut off each run: number of modes -> root mean squares [S], mm.

    Args:
      trajectories: records of a split.
      projection_mse: [S] m2, what all modes of the records cut off.
      n_soil: N.
    """
    counts = sorted({c for c in COUNTS if c < trajectories[0].n_modes} | {trajectories[0].n_modes})
    found: dict[int, list] = {count: [] for count in counts}
    for run, floor in zip(trajectories, projection_mse, strict=True):
        scores = run.position[H:, run.n_rigid :].astype(np.float64)
        square = (scores**2).sum(axis=2).mean(axis=0) / (scores.shape[2] * n_soil)
        for count in counts:
            found[count].append(1e3 * np.sqrt(floor + square[count:].sum()))
    return {count: np.array(values) for count, values in found.items()}


def judge(folder: str, data_path: str) -> dict:
    """A model on valid and test: split -> per run, sorted by record, errors in full space.

    Returns:
      `preset`, `milliseconds_per_step` (median over runs) and of each split `method` and `still`,
      lists of dicts `soil_mm` and `force_l2`.
    """
    from learning_to_simulate.methods import registry

    found: dict = {}
    for split in SPLITS:
        opened = registry.of_folder(folder).load_code().open_model(folder, data_path, split)
        _, summary = opened.evaluator.run(opened.groups, split, tqdm.tqdm)
        found[split] = {
            name: [
                {'soil_mm': row['soil_rms_mm_full'], 'force_l2': row.get('force_relative_l2')}
                for row in sorted(summary['runs'][key], key=lambda row: row['record'])
            ]
            for name, key in (('method', 'model'), ('still', 'stay_still'))
        }
        found['milliseconds_per_step'] = summary['mean']['model']['milliseconds_per_step']
        found['preset'] = opened.model.simulator.config.preset
    return found


def modes(path: str) -> str:
    """The truncation error against the number of modes, as a table."""
    found = files.read_json(path)
    return markdown.table(
        ['modes', *(f'{split}, mm' for split in found['truncation_mm'])],
        [
            [count, *(float(np.mean(rows[count])) for rows in found['truncation_mm'].values())]
            for count in found['truncation_mm']['train']
        ],
    )


def methods(path: str, split: str) -> str:
    """Soil (mm, full space) by kind of path, force, and wins over staying still, as a table."""
    found = files.read_json(path)
    kinds = found['kinds'][split]
    names = sorted(set(kinds))
    still = next(iter(found['methods'].values()))[0][split]['still']
    rows = [_row(STILL, [still], still, kinds, names)]
    for name, seeds in found['methods'].items():
        title = name if len(seeds) == 1 else f'{name} ({len(seeds)} seeds)'
        rows.append(_row(title, [seed[split]['method'] for seed in seeds], still, kinds, names))
    counts = [f'{name} ({kinds.count(name)})' for name in names]
    return markdown.table(['soil, mm', *counts, 'all', 'better than still', 'force'], rows)


def trials(path: str, part: str) -> str:
    """What was tried on the valid runs, as a table; `part` is `first` or `trials`."""
    found = files.read_json(path)[part]
    if part == 'first':
        rows = [[t['what'], t['in_modes_mm'], t['full_mm']] for t in found]
        return markdown.table(['trial', 'within the modes, mm', 'full space, mm'], rows)
    rows = [
        [t['what'], t['modes'], 1e3 * t['soil_mse'] ** 0.5, t['force_l2'], t['cpu_s']]
        for t in found
    ]
    return markdown.table(['trial', 'modes', 'within the modes, mm', 'force', 'CPU s'], rows)


def _row(title, seeds, still, kinds, names):
    """Means over runs, of each seed; spans over seeds."""

    def span(values):
        return markdown.span([float(v) for v in values])

    soil = np.array([[run['soil_mm'] for run in seed] for seed in seeds])
    force = [np.mean([run['force_l2'] for run in seed]) for seed in seeds]
    by_kind = [span(soil[:, np.array(kinds) == name].mean(axis=1)) for name in names]
    better = span((soil < [run['soil_mm'] for run in still]).sum(axis=1))
    return [title, *by_kind, span(soil.mean(axis=1)), f'{better} of {len(still)}', span(force)]


def main(values, _) -> None:
    """Runs the command."""
    metadata = dataset.read_metadata(values.data_path)
    result = {
        **record.provenance(values.num_threads),
        'data': {
            'path': os.path.basename(os.path.normpath(values.data_path)),
            'version': record.data_version(metadata),
            'runs': {split: len(metadata['cases'][split]) for split in dataset.SPLITS},
            'subspace': metadata['pca']['digest'],
        },
        'kinds': {split: kinds_of(metadata, split) for split in SPLITS},
        'truncation_mm': {},
        'methods': {},
    }
    for split in dataset.SPLITS:
        errors = truncation_of(
            dataset.read_split(values.data_path, split),
            metadata['projection_mse'][split],
            metadata['n_soil'],
        )
        result['truncation_mm'][split] = {str(k): v.tolist() for k, v in errors.items()}
    for item in values.model:
        name, _, folder = item.partition('=')
        if not folder:
            raise ValueError(f'--model={item}: NAME=FOLDER was expected')
        seeds = result['methods'].setdefault(name, [])
        seeds.append(judge(folder, values.data_path))
    files.write_json(values.output_path, result)
    print(modes(values.output_path))
    for split in SPLITS if values.model else ():
        print(f'\n{split}\n{methods(values.output_path, split)}')


def define_flags() -> None:
    """Defines the flags."""
    flags.DEFINE_string('data_path', None, 'Dataset folder.', required=True)
    flags.DEFINE_multi_string('model', [], 'NAME=FOLDER; folders of one name are its seeds.')
    flags.DEFINE_string('output_path', None, 'JSON file to write.', required=True)
    flags.DEFINE_integer('num_threads', 1, 'Threads of TensorFlow.')


if __name__ == '__main__':
    command.start(define_flags, main)
