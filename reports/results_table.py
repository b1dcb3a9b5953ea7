"""Prints the errors of trained models as a Markdown table, from the metrics.json beside them.

Examples:
    # the shipped models on the test splits of the shipped datasets
    python -m reports results_table

    # other models: any folders that hold a metrics.json
    python -m reports results_table /tmp/training/wheel/pcg_rollouts
"""

import glob
import os
import sys

from absl import app

from pca_tools import files

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
HEADER = (
    'model', 'edges', 'soil MSE 1e-4 m²', 'soil RMS mm', 'of best trivial', 'rigid MSE 1e-4 m²',
    'force rel. L2', '\\|MPE\\| %',
)  # fmt: skip


def rows(folder: str, with_trivial: bool):
    """Yields the cells of a model and, if asked, of its trivial predictors and the floor."""
    summary = files.read_json(os.path.join(folder, 'metrics.json'))
    mean = summary['mean']
    best = min(mean[name]['soil_mse'] for name in ('stay_still', 'constant_velocity'))

    def cells(name, values, edges=''):
        def number(key, factor=1.0):
            return f'{factor * values[key]:.3g}' if values.get(key) is not None else ''

        return (
            name, edges, number('soil_mse', 1e4), number('soil_rms_mm'),
            f'{values["soil_mse"] / best:.3g}', number('rigid_mse', 1e4),
            number('force_relative_l2'), number('force_abs_mpe'),
        )  # fmt: skip

    if with_trivial:
        if summary['projection_mse'] is not None:
            floor = summary['projection_mse']
            yield ('*cut off by the modes*', '', f'{1e4 * floor:.3g}', f'{1e3 * floor**0.5:.3g}',
                   f'{floor / best:.3g}', '', '', '')  # fmt: skip
        for name in ('stay_still', 'constant_velocity'):
            yield cells(f'*{name.replace("_", " ")}*', mean[name])
    edges = sorted({row['edges'] for row in summary['runs']['model']})
    name = os.path.basename(folder.rstrip('/')).removesuffix('_rollouts')
    yield cells(name, mean['model'], ' / '.join(map(str, edges)))


def main(argv) -> None:
    """Runs the command."""
    folders = argv[1:] or sorted(glob.glob(os.path.join(ROOT, 'models', '*', '*')))
    parent = None
    try:
        for folder in folders:
            first = os.path.dirname(folder.rstrip('/')) != parent
            parent = os.path.dirname(folder.rstrip('/'))
            if first:
                print(f'\n**{os.path.basename(parent)}**\n')
                print('| ' + ' | '.join(HEADER) + ' |')
                print('|---' * len(HEADER) + '|')
            for cells in rows(folder, first):
                print('| ' + ' | '.join(cells) + ' |')
    except (ValueError, OSError) as error:
        sys.exit(f'error: {error}')


if __name__ == '__main__':
    app.run(main)
