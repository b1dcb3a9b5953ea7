"""What more training runs bring: the protocol's errors, trained on fewer and fewer of them.

Each size is a dataset of its own in the same subspace (`pca_tools.subset`, runs spread over all),
on which models and baselines are trained as by `reports.protocol`; valid chooses, and the test runs
that judge are the same for all sizes.

Examples:
    python -m reports learning_curve --train=swept_field,pcg --data_path=datasets/excavation_v2 \\
        --work_path=/tmp/curve --output_path=docs/learning_curve     # goes on where it stopped
"""

import os

import numpy as np
from absl import flags

from pca_tools import files, subset
from reports import command, markdown, record
from reports.protocol import document, driven_runs

SCHEMA_VERSION = 1


def measure(data_path: str, size: int, values) -> dict:
    """Trains and judges on `size` runs, 0 for all; returns a row of the JSON.

    Args:
      data_path: dataset with a particle sample.
      size: number of training runs.
      values: flags of the command.

    Raises:
      ValueError: fewer training runs than asked for, or a training that failed; what is made stays.
    """
    work = os.path.join(values.work_path, f'{size or "all"}')
    folder = os.path.join(work, 'data')
    if not os.path.exists(os.path.join(folder, 'manifest.json')):
        subset.subset(data_path, folder, size, subset.kinds_of(values.kinds), overwrite=True)
    judged = document.protocol(folder, values, document.trained_here(values, work))
    return {'train_runs': judged['data']['train_runs'], 'test': driven_runs.condense(judged)}


def table(path: str, kind: str) -> str:
    """Mean errors of the test runs of a kind by number of training runs; (low to high) over seeds
    where there are several."""
    rows = sorted(files.read_json(path)['rows'].values(), key=lambda row: row['train_runs'])
    columns = [
        (quantity, name)
        for quantity in driven_runs.QUANTITIES
        for name in rows[-1]['test'][kind][quantity]
    ]
    lines = []
    for row in rows:
        seeds = (row['test'][kind][quantity].get(name) for quantity, name in columns)
        lines.append((row['train_runs'], *(markdown.span(s) if s else '' for s in seeds)))
    header = (
        'training runs',
        *(f'{name}: {driven_runs.QUANTITIES[quantity]}' for quantity, name in columns),
    )
    return markdown.table(header, lines)


def draw(path: str, picture: str) -> None:
    """Draws soil and force against the number of training runs; dashed: runs of constant speed."""
    from matplotlib import figure, lines

    rows = sorted(files.read_json(path)['rows'].values(), key=lambda row: row['train_runs'])
    last = rows[-1]['test']
    # One colour for a method, in both panels.
    names = list(
        dict.fromkeys(n for kind in last.values() for q in driven_runs.QUANTITIES for n in kind[q])
    )
    drawn = figure.Figure(figsize=(9, 4.4), layout='constrained')
    panels = drawn.subplots(1, 2)
    for axes, (quantity, title) in zip(panels, driven_runs.QUANTITIES.items(), strict=True):
        for kind, style in ((driven_runs.DRIVEN, '-'), (driven_runs.GRID, '--')):
            for number, name in enumerate(names):
                seeds = [row['test'].get(kind, {}).get(quantity, {}).get(name) for row in rows]
                points = [
                    (row['train_runs'], np.mean(s)) for row, s in zip(rows, seeds, strict=True) if s
                ]
                if points:
                    axes.plot(*zip(*points, strict=True), f'o{style}', color=f'C{number}')
        axes.set(xscale='log', xlabel='training runs', ylabel=title)
        axes.set_ylim(bottom=0.0)
        axes.set_xticks(*(2 * [[row['train_runs'] for row in rows]]))
        axes.minorticks_off()
        axes.grid(alpha=0.3)
    handles = [lines.Line2D([], [], marker='o', color=f'C{n}') for n in range(len(names))]
    drawn.legend(
        handles, names, loc='outside lower center', ncols=4, frameon=False, fontsize='small'
    )
    drawn.suptitle('test; solid: driven freely, dashed: constant speed', fontsize='small')
    files.write_atomically(picture, lambda name: drawn.savefig(name, format='png', dpi=130))


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('data_path', None, 'Dataset with a particle sample.', required=True)
    flags.DEFINE_list('sizes', ['7', '14', '28', '56', '112', '0'], 'Training runs; 0: all.')
    flags.DEFINE_list('kinds', [], 'Kinds of training runs, or grid:20; default: all.')
    flags.DEFINE_list(
        'train', ['swept_field'], 'Presets that are trained on each size, as of `reports.protocol`.'
    )
    flags.DEFINE_integer('num_seeds', 1, 'Seeds of each.', 1)
    command.define_workers('Models trained and rolled out at a time.')
    flags.DEFINE_string('work_path', None, 'Folder for trainings; calls resume.', required=True)
    flags.DEFINE_string('output_path', None, 'Path of .json and .png, without it.', required=True)


def main(values, _) -> None:
    """Runs the command."""
    if bad := [size for size in values.sizes if not size.isdecimal()]:
        raise ValueError(f'--sizes are numbers of runs, got {bad}')
    path = f'{values.output_path}.json'
    held = files.read_json(path) if os.path.exists(path) else {'rows': {}}
    for size in values.sizes:
        if size not in held['rows']:
            held['rows'][size] = measure(values.data_path, int(size), values)
            head = {'schema_version': SCHEMA_VERSION, 'record': record.provenance()}
            files.write_json(path, head | {'rows': held['rows']})
    draw(path, f'{values.output_path}.png')
    for kind in held['rows'][values.sizes[-1]]['test']:
        print(f'\n{kind}\n{table(path, kind)}')


if __name__ == '__main__':
    command.start(define_flags, main)
