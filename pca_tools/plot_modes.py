"""Pictures and numbers of a dataset's subspace: energy and error against r, the modes.

Writes `energy_and_error.png`, `modes.png` and `modes.json`.

Examples:
    lts modes datasets/excavation --output_path=plots
"""

import os
from collections.abc import Sequence

import numpy as np
from absl import flags

from pca_tools import command, dataset, files
from pca_tools.metadata import AXES
from pca_tools.storage import markdown
from pca_tools.subspace import SUBSPACE_NAME, Subspace


def plot_energy_and_error(space: Subspace, path: str) -> None:
    """Draws energy left out and RMS error against the number of modes."""
    counts = np.arange(1, len(space.singular_values) + 1)
    from matplotlib.figure import Figure  # slow to load, and help does not wait for it

    figure = Figure(figsize=(10, 4), layout='constrained')  # no pyplot: no display is needed
    left, right = figure.subplots(1, 2)
    left.semilogy(counts, space.explained_variance_ratio, 'o-', markersize=3, label='of the mode')
    rest = space.projection_floors[1:] / space.projection_floors[0]
    left.semilogy(counts, rest, 's-', markersize=3, label='left out after it')
    left.set(xlabel='mode', ylabel='share of the energy', title='Energy')
    left.legend()
    right.semilogy(counts, 1e3 * np.sqrt(space.projection_floors[1:]), 'o-', markersize=3)
    title = f'Projection error of the {len(space.runs)} training runs'
    right.set(xlabel='modes kept r', ylabel='RMS per coordinate [mm]', title=title)
    for axes in (left, right):
        axes.axvline(space.n_modes, color='0.5', linestyle='--', linewidth=1)
        axes.grid(True, which='both', alpha=0.3)
    _save(figure, path)


def plot_modes(space: Subspace, path: str, up_axis: int = 1) -> None:
    """Draws each mode as particles coloured by their weight, from the side and from above; of the
    two level axes the longer is drawn along the page."""
    level = [axis for axis in range(3) if axis != up_axis]
    along, depth = sorted(level, key=lambda axis: -np.ptp(space.initial[:, axis]))
    x, y, z = space.initial[:, [along, up_axis, depth]].T
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 2.1 * space.n_modes), layout='constrained')
    figure.suptitle(f'Modes on the particles as they lie at the start of run {space.runs[0]}')
    grid = figure.subplots(space.n_modes, 2, squeeze=False)
    for mode, row in enumerate(grid):
        weights = space.components[:, mode]
        limit = np.abs(weights).max()
        order = np.argsort(np.abs(weights))  # the strongest on top, else others hide them
        for axes, across, name in (
            (row[0], y, f'{AXES[up_axis]} up [m]'),
            (row[1], z, f'{AXES[depth]} [m]'),
        ):
            points = axes.scatter(
                x[order], across[order], c=weights[order], s=3, cmap='RdBu_r', vmin=-limit,
                vmax=limit,
            )  # fmt: skip
            axes.set(aspect='equal', ylabel=name)
        share = 100 * space.explained_variance_ratio[mode]
        row[0].set_title(f'mode {mode + 1}: {share:.3g} % of the energy, side', fontsize=9)
        row[1].set_title('from above', fontsize=9)
        figure.colorbar(points, ax=row.tolist(), shrink=0.8)
    for axes in grid[-1]:
        axes.set_xlabel(f'{AXES[along]} [m]')
    _save(figure, path)


def _save(figure, path: str) -> None:
    files.write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=110, format='png'))


def table(space: Subspace) -> str:
    floors, shares = space.projection_floors, space.explained_variance_ratio
    return markdown.table(
        ('modes', 'energy of the mode [%]', 'energy left out [%]', 'RMS [mm]'),
        [
            (n, 100 * shares[n - 1], 100 * floors[n] / floors[0], 1e3 * floors[n] ** 0.5)
            for n in range(1, space.n_modes + 1)
        ],
        aligned=True,
    )


def define_flags() -> None:
    flags.DEFINE_string('output_path', None, 'Folder for pictures and numbers.', required=True)


def main(values, arguments: Sequence[str]) -> None:
    (folder,), out = arguments, values.output_path
    up_axis = dataset.read_metadata(folder).get('scene', {}).get('up_axis', 1)
    space = Subspace.load(os.path.join(folder, SUBSPACE_NAME))
    os.makedirs(out, exist_ok=True)
    plot_energy_and_error(space, os.path.join(out, 'energy_and_error.png'))
    plot_modes(space, os.path.join(out, 'modes.png'), up_axis)
    numbers = {
        'explained_variance_ratio': space.explained_variance_ratio.tolist(),
        'projection_floors': space.projection_floors.tolist(),
    }
    files.write_json(os.path.join(out, 'modes.json'), numbers)
    print(table(space))
    print(f'\n{out}: energy_and_error.png, modes.png, modes.json')


if __name__ == '__main__':
    define_flags()
    command.start_quietly(main, 1, 'lts modes DATASET --output_path=PLOTS')
