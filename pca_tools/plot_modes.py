"""Pictures and numbers of a dataset's subspace: energy and error against r, the modes, kernel PCA
beside PCA.

Writes `energy_and_error.png`, `modes.png` and `modes.json`. Kernel PCA needs particles, so its row
is measured only with --raw_path: RBF kernel, pre-image by kernel ridge regression (Usmani 2023,
2.4.2), fitted on thinned frames of the training runs and measured on thinned frames of the others,
as is a PCA of the same frames beside it.

Examples:
    lts modes datasets/excavation --output_path=plots
    lts modes datasets/excavation --output_path=plots --raw_path=raw/excavation
"""

import os
import time
from collections.abc import Sequence

import numpy as np
from absl import flags
from tqdm import tqdm

from pca_tools import command, dataset, files
from pca_tools.metadata import AXES
from pca_tools.raw_runs import RawRuns
from pca_tools.storage import markdown
from pca_tools.subspace import DIM, SUBSPACE_NAME, Subspace, centred_rows

# Of kernel PCA: gamma of the RBF kernel (1/m^2), ridges of the pre-image, a row each; rows (frame x
# axis) that it is fitted on.
GAMMA, ALPHAS, KERNEL_ROWS = 0.04, (1.0, 1e-3), 1500


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


def compare_reductions(space: Subspace, runs: RawRuns, max_rows: int) -> list[dict]:
    """Measures PCA and kernel PCA, fitted on at most about `max_rows` rows (frame x axis), evenly
    chosen. The subspace's runs train, all other raw runs are held out; ValueError if either are
    absent.

    Returns a row for the stored subspace, for a PCA of the thinned frames, and for each kernel PCA:
    `method`, `modes`, `train_mse` on the frames of the fit and `test_mse` on held-out runs (m^2),
    CPU `fit_seconds`, and CPU `decode_ms` to rebuild the particles of a frame."""
    from sklearn import decomposition  # seconds to load, and help does not wait for it

    training = [i for i, case in enumerate(runs.cases) if str(case) in space.runs]
    held_out = [i for i in range(len(runs)) if i not in training]
    if not training or not held_out:
        counts = f'{len(training)} training and {len(held_out)} held-out runs of this subspace'
        raise ValueError(f'{runs.folder}: has {counts}, both are needed')
    train, test = (_thinned_rows(space, runs, part, max_rows) for part in (training, held_out))
    components = space.components
    pca = decomposition.PCA(space.n_modes, svd_solver='arpack', random_state=0)
    # How each is fitted, encodes and decodes.
    methods = {
        'PCA, the stored subspace': (
            lambda rows: None, lambda rows: rows @ components, lambda scores: scores @ components.T,
        ),
        'PCA of the thinned frames': (pca.fit, pca.transform, pca.inverse_transform),
    }  # fmt: skip
    for alpha in ALPHAS:
        settings = {'kernel': 'rbf', 'gamma': GAMMA, 'fit_inverse_transform': True}
        kernel = decomposition.KernelPCA(space.n_modes, alpha=alpha, **settings)
        name = f'kernel PCA of the same (RBF {GAMMA:g}, ridge {alpha:g})'
        methods[name] = kernel.fit, kernel.transform, kernel.inverse_transform
    rows = []
    for name, (fit, encode, decode) in methods.items():
        start = time.process_time()
        fit(train)
        fit_seconds = time.process_time() - start
        scores = encode(test)
        start = time.process_time()
        decoded = decode(scores)
        decode_ms = 1e3 * (time.process_time() - start) * DIM / len(test)
        rows.append({
            'method': name, 'modes': space.n_modes,
            'train_mse': float(np.mean((decode(encode(train)) - train) ** 2)),
            'test_mse': float(np.mean((decoded - test) ** 2)),
            'fit_seconds': fit_seconds, 'decode_ms': decode_ms,
        })  # fmt: skip
    return rows


def _thinned_rows(space: Subspace, runs: RawRuns, indices: list[int], max_rows: int) -> np.ndarray:
    """Returns centred rows [rows, N] of evenly chosen frames of the given runs."""
    rows = []
    for index in tqdm(indices, desc='frames', unit='run'):
        positions = runs[index].positions
        frames = max(max_rows // (DIM * len(indices)), 2)
        chosen = np.unique(np.linspace(0, len(positions) - 1, frames).astype(int))
        rows.append(centred_rows(positions[chosen], space.mean))
    return np.concatenate(rows)


def table(space: Subspace, reductions: Sequence[dict]) -> str:
    floors, shares = space.projection_floors, space.explained_variance_ratio
    text = markdown.table(
        ('modes', 'energy of the mode [%]', 'energy left out [%]', 'RMS [mm]'),
        [
            (n, 100 * shares[n - 1], 100 * floors[n] / floors[0], 1e3 * floors[n] ** 0.5)
            for n in range(1, space.n_modes + 1)
        ],
        aligned=True,
    )
    if not reductions:
        return text
    header = ('reduction', 'r', 'train RMS [mm]', 'held-out RMS [mm]', 'fit [CPU s]',
              'decode [CPU ms]')  # fmt: skip
    rows = [
        (row['method'], row['modes'], 1e3 * row['train_mse'] ** 0.5, 1e3 * row['test_mse'] ** 0.5,
         row['fit_seconds'], row['decode_ms'])
        for row in reductions
    ]  # fmt: skip
    return text + '\n\n' + markdown.table(header, rows, aligned=True)


def define_flags() -> None:
    flags.DEFINE_string('output_path', None, 'Folder for pictures and numbers.', required=True)
    flags.DEFINE_string('raw_path', None, 'Raw runs of the dataset, for the kernel PCA row.')


def main(values, arguments: Sequence[str]) -> None:
    (folder,), out = arguments, values.output_path
    up_axis = dataset.read_metadata(folder).get('scene', {}).get('up_axis', 1)
    space = Subspace.load(os.path.join(folder, SUBSPACE_NAME))
    reductions: list[dict] = []
    if values.raw_path:
        reductions = compare_reductions(space, RawRuns(values.raw_path), KERNEL_ROWS)
    os.makedirs(out, exist_ok=True)
    plot_energy_and_error(space, os.path.join(out, 'energy_and_error.png'))
    plot_modes(space, os.path.join(out, 'modes.png'), up_axis)
    numbers = {
        'explained_variance_ratio': space.explained_variance_ratio.tolist(),
        'projection_floors': space.projection_floors.tolist(),
        'reductions': reductions,
    }
    files.write_json(os.path.join(out, 'modes.json'), numbers)
    print(table(space, reductions))
    print(f'\n{out}: energy_and_error.png, modes.png, modes.json')


if __name__ == '__main__':
    define_flags()
    command.start_quietly(main, 1, 'lts modes DATASET --output_path=PLOTS')
