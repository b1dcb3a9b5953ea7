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
