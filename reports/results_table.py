"""Prints the errors of trained models as a Markdown table, from the metrics.json beside them.

Examples:
    # the shipped models on the test splits of the shipped datasets
    python -m reports results_table

    # other models: any folders that hold a metrics.json
    python -m reports results_table /tmp/training/wheel/pcg_rollouts
"""

import glob
import itertools
import os
from collections.abc import Iterator, Sequence

from pca_tools import files
from reports import command, markdown
from reports.record import ROOT

HEADER = (
    'model', 'edges', 'soil MSE 1e-4 m²', 'soil RMS mm', 'of best trivial', 'rigid MSE 1e-4 m²',
    'force rel. L2', '|MPE| %',
)  # fmt: skip


def rows(folder: str, with_trivial: bool) -> Iterator[tuple]:
    """Yields the cells of a model and, if asked, of its trivial predictors and the floor.

    Raises:
      FileNotFoundError, ValueError: no metrics.json there, or one that is damaged.
    """
    summary = files.read_json(os.path.join(folder, 'metrics.json'))
    mean, floor = summary['mean'], summary['projection_mse']
    best = min(mean[name]['soil_mse'] for name in markdown.TRIVIAL)

    def cells(name, values, edges=None):
        def scaled(key):
            return None if values.get(key) is None else 1e4 * values[key]

        return (
            name, edges, scaled('soil_mse'), values['soil_rms_mm'], values['soil_mse'] / best,
            scaled('rigid_mse'), values.get('force_relative_l2'), values.get('force_abs_mpe'),
        )  # fmt: skip

    if with_trivial:
        if floor is not None:
            yield cells(f'*{markdown.FLOOR}*', {'soil_mse': floor, 'soil_rms_mm': 1e3 * floor**0.5})
        for key, name in markdown.TRIVIAL.items():
            yield cells(f'*{name}*', mean[key])
    edges = sorted({row['edges'] for row in summary['runs']['model']})
    name = os.path.basename(folder).removesuffix('_rollouts')
    yield cells(name, mean['model'], ' / '.join(map(str, edges)))


def tables(folders: Sequence[str], aligned: bool = False) -> str:
    """A table for every parent of the folders, under its name."""
    parts = []
    for parent, models in itertools.groupby(folders, os.path.dirname):
        cells = [c for i, folder in enumerate(models) for c in rows(folder, i == 0)]
        table = markdown.table(HEADER, cells, aligned)
        parts.append(f'**{os.path.basename(parent)}**\n\n{table}')
    return '\n\n'.join(parts)


def scene_table(parent: str) -> str:
    """The table of all models below a folder, without its name."""
    folders = sorted(glob.glob(os.path.join(parent, '*')))
    return markdown.table(HEADER, [c for i, f in enumerate(folders) for c in rows(f, i == 0)])


def per_run(folder: str) -> str:
    """Every test run of a model: soil error in full space, RMS mm, beside what knows nothing."""
    summary = files.read_json(os.path.join(folder, 'metrics.json'))
    runs = summary['runs']
    scene, split = os.path.basename(os.path.dirname(folder)), 'test'
    metadata = files.read_json(os.path.join(ROOT, 'datasets', scene, 'metadata.json'))
    cases, floors = metadata['dataset_split'][split], metadata['projection_mse'][split]
    lines = []
    for i, row in enumerate(runs['model']):
        lines.append(
            (cases[i], row['soil_rms_mm_full'],
             *(runs[key][i]['soil_rms_mm_full'] for key in markdown.TRIVIAL),
             1e3 * floors[i] ** 0.5, row['force_relative_l2'],
             runs['stay_still'][i]['force_relative_l2'])
        )  # fmt: skip
    wins = [sum(line[1] < line[k] for line in lines) for k in (2, 3)]
    n_force = sum(line[5] < line[6] for line in lines)
    lines.append(('wins of the model', '', *(f'{w} of {len(lines)}' for w in wins), '',
                  f'{n_force} of {len(lines)}'))  # fmt: skip
    header = ('test case', os.path.basename(folder), *markdown.TRIVIAL.values(), markdown.FLOOR,
              'force rel. L2', 'held force')  # fmt: skip
    return markdown.table(header, lines)


def main(_, arguments) -> None:
    """Runs the command."""
    folders = [os.path.normpath(folder) for folder in arguments]
    found = folders or sorted(glob.glob(os.path.join(ROOT, 'models', '*', '*')))
    if not found:
        raise FileNotFoundError(
            f'{os.path.join(ROOT, "models")}: no models there (installed without the checkout?); '
            'name folders that hold a metrics.json'
        )
    print(tables(found, aligned=True))


if __name__ == '__main__':
    command.start(lambda: None, main, n_argument=1000)
