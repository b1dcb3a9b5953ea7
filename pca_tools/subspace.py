"""The soil subspace: r modes W [N, r] shared by the three axes, in float64.

Algorithm 1 of Usmani (thesis, Concordia 2023), after Haeri and Skonieczny: matrix X has one row per
(run, frame, axis) and one column per particle. Encode Z = (X - mean)^T W per frame, decode
X = Z W^T + mean. A mode is a node with three coordinates.

Two centerings: `scalar` subtracts one number (the published way; the first modes then hold the
static layout), `configuration` subtracts the mean position of every particle (N x 3), so that all
modes hold motion.
"""

import dataclasses
import functools
import hashlib
import warnings
from collections.abc import Sequence
from typing import Self

import numpy as np
from tqdm import tqdm

from pca_tools import files
from pca_tools.metadata import DIM, non_finite

CENTERINGS = ('configuration', 'scalar')
SUBSPACE_NAME = 'subspace.npz'
# Singular values kept beyond the modes, for the truncation error against r.
SPECTRUM_LENGTH = 64
# A cut between two singular values closer than this leaves the last mode free to turn from fit to
# fit.
CLUSTER_GAP = 0.05
# An SVD holds the matrix, its copy and both factors; a rank-k update and an eigenvalue solver in
# place hold the N x N matrix and one spare copy of it.
SVD_COPIES, COVARIANCE_COPIES = 4, 2
# Of a covariance on workers: the matrix that comes back is as large as ten runs.
RUNS_PER_TASK = 16
_MAGNITUDE_TIE = 1e-9
# Arrays of a stored subspace that hold one value.
_SCALARS = ('total_energy', 'n_rows', 'centering', 'digest')


@dataclasses.dataclass(frozen=True, eq=False)
class Subspace:
    """Mean and modes of the soil, with what is needed to judge them."""

    mean: np.ndarray  # float64, [N, 3] for centering `configuration`, [] for `scalar`; metres
    components: np.ndarray  # float64 [N, r], orthonormal columns
    # float64 [S], S >= r leading singular values of X - mean, descending; metres
    singular_values: np.ndarray
    total_energy: float  # sum of squares of all entries of X - mean; m^2
    n_rows: int  # rows of X = runs * frames * 3
    centering: str  # `configuration` or `scalar`
    runs: tuple[str, ...]  # names of the runs it was fitted on (training runs only)
    # float64 [N, 3], frame 0 of the first of them, metres; says which particle a column is
    initial: np.ndarray

    @property
    def n_soil(self) -> int:
        return self.components.shape[0]

    @property
    def n_modes(self) -> int:
        return self.components.shape[1]

    @functools.cached_property
    def digest(self) -> str:
        """sha256 of centering and arrays."""
        digest = hashlib.sha256(self.centering.encode())
        for array in (self.mean, self.components, self.singular_values, self.initial):
            digest.update(repr(array.shape).encode())
            digest.update(np.ascontiguousarray(array, '<f8').tobytes())
        return digest.hexdigest()

    @property
    def explained_variance_ratio(self) -> np.ndarray:
        """[S] share of each singular value in the total energy."""
        return self.singular_values**2 / self.total_energy

    @property
    def gaps(self) -> np.ndarray:
        """[S - 1] relative distance of each singular value to the next; small = a cluster."""
        values = self.singular_values
        return -np.diff(values) / np.maximum(values[:-1], np.finfo(np.float64).tiny)

    @property
    def projection_floors(self) -> np.ndarray:
        """[S + 1] mean squared error in m^2 that 0..S modes leave on the runs of the fit, over
        runs, frames, particles and axes."""
        kept = np.concatenate([[0.0], np.cumsum(self.singular_values**2)])
        return np.maximum(self.total_energy - kept, 0.0) / (self.n_rows * self.n_soil)

    def projection_floor(self) -> float:
        """Mean squared error in m^2 that the r modes leave; see the plural."""
        return float(self.projection_floors[self.n_modes])

    def truncated(self, n_modes: int) -> Self:
        """Returns the subspace of the first `n_modes` of its r modes, of all if it has fewer."""
        return dataclasses.replace(
            self, components=np.ascontiguousarray(self.components[:, :n_modes])
        )

    def encode(self, x: np.ndarray) -> np.ndarray:
        """Projects particle positions [..., N, 3] (m) to scores, float64 [..., r, 3] (m);
        ValueError for a wrong shape, or NaN (with its place)."""
        x = np.asarray(x)
        if x.ndim < 2 or x.shape[-2:] != (self.n_soil, DIM):
            raise ValueError(f'positions have shape {x.shape}, not [..., {self.n_soil}, {DIM}]')
        if fault := non_finite(x, 'frame', 'particle', 'axis'):
            raise ValueError(f'positions: {fault}')
        return np.einsum('...nk,nr->...rk', x - self.mean, self.components, optimize=True)

    def decode(self, z: np.ndarray) -> np.ndarray:
        """Rebuilds particle positions, float64 [..., N, 3] (m), from scores [..., r, 3] (m);
        ValueError for a wrong shape."""
        z = np.asarray(z, np.float64)
        if z.ndim < 2 or z.shape[-2:] != (self.n_modes, DIM):
            raise ValueError(f'scores have shape {z.shape}, not [..., {self.n_modes}, {DIM}]')
        return self.components @ z + self.mean

    def save(self, path: str) -> None:
        """Writes the subspace as `.npz`, whole or not at all."""
        names = (
            'mean', 'components', 'singular_values', 'explained_variance_ratio', 'total_energy',
            'n_rows', 'centering', 'runs', 'initial', 'digest',
        )  # fmt: skip
        files.write_npz(path, **{name: getattr(self, name) for name in names})

    @classmethod
    def load(cls, path: str) -> Self:
        """Reads a subspace written by `save`. FileNotFoundError: there is no such file. ValueError:
        damaged or foreign file, arrays that do not fit, or a digest that disagrees."""
        arrays = files.read_npz(path)
        names = {field.name for field in dataclasses.fields(cls)}
        if missing := (names | {'digest'}) - arrays.keys():
            raise ValueError(f'{path}: is not a subspace, it lacks {sorted(missing)}')
        kinds = {'runs': 'U', 'centering': 'U', 'digest': 'U', 'n_rows': 'i'}
        for name, array in arrays.items():
            kind = kinds.get(name, 'f')
            if array.dtype.kind != kind or (name in _SCALARS and array.ndim):
                found = f'{name} of type {array.dtype} and shape {array.shape}'
                raise ValueError(f'{path}: {found} is not that of a subspace')
            if kind == 'f' and not np.all(np.isfinite(array)):
                raise ValueError(f'{path}: {name} holds NaN or infinite values')
        digest = str(arrays.pop('digest'))
        # What the digest leaves out: kept consistent by the ratios, which are stored as well.
        ratio = arrays.pop('explained_variance_ratio', np.empty(0))
        values = {name: a.item() if name in _SCALARS else a for name, a in arrays.items()}
        space = cls(**{n: values[n] for n in names} | {'runs': tuple(arrays['runs'].tolist())})
        shapes = {'configuration': (len(space.initial), DIM), 'scalar': ()}
        if not (
            space.components.ndim == 2
            and shapes.get(space.centering) == space.mean.shape
            and space.singular_values.ndim == 1
            and len(space.singular_values) >= space.n_modes
            and space.initial.shape == (space.n_soil, DIM)
            and space.n_rows >= 2
            and space.total_energy > 0
            and ratio.shape == space.singular_values.shape
            and np.allclose(ratio, space.explained_variance_ratio, rtol=1e-9, atol=0)
        ):
            raise ValueError(f'{path}: its arrays do not fit each other')
        if space.digest != digest:
            raise ValueError(f'{path}: the digest does not fit the arrays; the file was changed')
        return space


def fit(
    runs: Sequence[np.ndarray],
    n_modes: int,
    centering: str = 'configuration',
    max_memory_mb: float = 1024.0,
    names: Sequence[str] | None = None,
    spare_modes: int = 0,
    crew=None,
) -> Subspace:
    """Fits a subspace of r to r + `spare_modes` modes to training runs.

    The matrix is decomposed by scikit-learn while it fits the memory; above that its N x N
    covariance is summed up run by run and decomposed (float64: relative error of a leading
    eigenvalue ~1e-14 of the largest).

    Args:
        runs: float [T, N, 3] arrays in metres with the same N; any sequence that can be gone
            through twice, loading one run at a time.
        n_modes: r.
        centering: `configuration` (mean position of each particle) or `scalar` (one number).
        max_memory_mb: largest memory of the fit in MiB, beside one run.
        names: names of the runs, for the record; default 0, 1, ...
        spare_modes: further modes to keep where the data have them, to measure what they would
            bring; `Subspace.truncated` drops them.
        crew: `pca_tools.workers.Workers` that sum up the covariance, in parts; runs must then have
            `part` (as `pca_tools.raw_runs.SoilPositions` has). The same subspace to round-off.

    Raises:
        ValueError: no runs, one frame, other shapes, NaN, no motion at all, more modes than the
            data has rank, or an N too large for the memory.
    """
    if centering not in CENTERINGS:
        raise ValueError(f'centering {centering!r} is not one of {CENTERINGS}')
    if n_modes < 1:
        raise ValueError(f'{n_modes} modes: at least 1 is needed')
    mean, n_rows, largest = _mean_configuration(runs, centering)
    n_soil = runs[0].shape[1]
    limit = min(n_rows, n_soil)
    if n_modes > limit:
        rows = f'{n_rows} rows (run x frame x axis) of {n_soil} particles'
        raise ValueError(f'{n_modes} modes are too many: {rows} have at most {limit}')
    length = min(max(SPECTRUM_LENGTH, n_modes + spare_modes + 1), limit)
    budget = max_memory_mb * 2**20
    if SVD_COPIES * 8 * n_rows * n_soil <= budget:
        values, vectors, energy = _decompose_matrix(runs, mean, length)
        noise = max(n_rows, n_soil) * np.finfo(np.float64).eps
    elif COVARIANCE_COPIES * 8 * n_soil**2 <= budget:
        values, vectors, energy = _decompose_covariance(runs, mean, n_soil, length, crew)
        noise = np.sqrt(n_soil * np.finfo(np.float64).eps)
    else:
        needed = COVARIANCE_COPIES * 8 * n_soil**2 / 2**20
        limits = f'needs {needed:.0f} MiB, the limit is {max_memory_mb:.0f}'
        raise ValueError(f'the covariance of {n_soil} particles {limits}: raise --max_memory_mb')
    if values[0] <= noise * np.sqrt(n_rows * n_soil) * largest:
        raise ValueError('all runs are constant: there is nothing to fit')
    rank = int(np.count_nonzero(values > noise * values[0]))
    if n_modes > rank:
        raise ValueError(f'asked for {n_modes} modes, data rank is {rank}')
    subspace = Subspace(
        mean=mean,
        components=_fix_signs(vectors[:, : min(n_modes + spare_modes, rank, length)]),
        singular_values=values,
        total_energy=energy,
        n_rows=n_rows,
        centering=centering,
        runs=tuple(map(str, range(len(runs)) if names is None else names)),
        initial=np.asarray(runs[0][0], np.float64),
    )
    if n_modes < rank and (gap := subspace.gaps[n_modes - 1]) < CLUSTER_GAP:
        text = (
            f'(the next singular value differs by {100 * gap:.1f} %): it may turn from fit to fit'
        )
        warnings.warn(f'the cut after mode {n_modes} lies inside a cluster {text}', stacklevel=2)
    return subspace


def _mean_configuration(runs, centering) -> tuple[np.ndarray, int, float]:
    """Returns the mean ([N, 3] or []), the number of rows and the largest coordinate in magnitude;
    ValueError for other shapes, NaN, or fewer than two frames."""
    total, frames, largest, n_soil = 0.0, 0, 0.0, None
    for index, run in enumerate(tqdm(runs, 'mean', unit='run')):
        n_soil = run.shape[1] if n_soil is None and run.ndim == 3 else n_soil
        if run.ndim != 3 or run.shape[1:] != (n_soil, DIM):
            expected = f'[T, {n_soil or "N"}, {DIM}]'
            raise ValueError(f'run {index}: positions have shape {run.shape}, not {expected}')
        if fault := non_finite(run, 'frame', 'particle', 'axis'):
            raise ValueError(f'run {index} holds {fault}')
        total = total + run.sum(axis=0, dtype=np.float64)
        frames += len(run)
        largest = max(largest, float(np.abs(run).max()))
    if frames < 2:
        raise ValueError(f'{len(runs)} runs with {frames} frames in all: need at least 2 frames')
    configuration = total / frames
    mean = configuration if centering == 'configuration' else np.asarray(configuration.mean())  # type: ignore[attr-defined]
    return mean, frames * DIM, largest  # type: ignore[return-value]


def centred_rows(run: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Returns float64 [T * 3, N], row k + 3 i = axis k of frame i, centred."""
    rows = (np.asarray(run, np.float64) - mean).transpose(0, 2, 1)
    return np.ascontiguousarray(rows).reshape(-1, run.shape[1])


def _decompose_matrix(runs, mean, length):
    """Returns singular values [S], vectors [N, S] and total energy from the whole matrix."""
    matrix = np.concatenate([centred_rows(run, mean) for run in tqdm(runs, 'matrix', unit='run')])
    energy = float(np.sum(matrix**2))
    if energy == 0.0:
        return np.zeros(length), np.zeros((matrix.shape[1], length)), energy
    if mean.ndim:
        from sklearn import decomposition  # slow to load, and only fits need it

        # Columns sum to zero already, so the mean that PCA subtracts itself is round-off.
        model = decomposition.PCA(n_components=length, svd_solver='full').fit(matrix)
        return model.singular_values_, model.components_.T, energy
    from scipy import linalg

    # The scalar mean leaves the columns uncentered, and PCA would centre them.
    _, values, vectors = linalg.svd(matrix, full_matrices=False, overwrite_a=True)
    return values[:length], vectors[:length].T, energy


def _decompose_covariance(runs, mean, n_soil, length, crew=None):
    """Returns singular values [S], vectors [N, S] and total energy from the summed covariance."""
    from scipy import linalg  # as slow to load as numpy, and whoever only reads modes needs it not

    if crew is None:
        covariance = sum_covariance((tqdm(runs, 'covariance', unit='run'), mean, n_soil))
    else:
        covariance = _sum_in_parts(crew, runs, mean, n_soil)
    energy = float(np.trace(covariance))
    values, vectors = linalg.eigh(
        covariance, lower=False, overwrite_a=True, check_finite=False,
        subset_by_index=[n_soil - length, n_soil - 1],
    )  # fmt: skip
    return np.sqrt(np.maximum(values[::-1], 0.0)), vectors[:, ::-1], energy


def sum_covariance(part: tuple) -> np.ndarray:
    """Returns the covariance [N, N] (upper triangle) of some runs, (runs, mean, N)."""
    from scipy import linalg

    runs, mean, n_soil = part
    covariance = np.zeros((n_soil, n_soil), order='F')
    for run in runs:
        matrix = centred_rows(run, mean)
        covariance = linalg.blas.dsyrk(1.0, matrix.T, beta=1.0, c=covariance, overwrite_c=True)
    return covariance


def _sum_in_parts(crew, runs, mean, n_soil) -> np.ndarray:
    """Sums covariances on workers, each a part of the runs. The parts do not depend on the number
    of workers and are added in their order, so neither does the sum."""
    starts = range(0, len(runs), RUNS_PER_TASK)
    parts = [(runs.part(start, start + RUNS_PER_TASK), mean, n_soil) for start in starts]
    total, early = np.zeros((n_soil, n_soil), order='F'), {}
    added = 0
    for outcome in tqdm(crew.run(sum_covariance, parts), 'covariance, parts', len(parts)):
        if outcome.error is not None:
            raise ValueError(f'covariance of part {outcome.index}: {outcome.error}')
        early[outcome.index] = outcome.value
        while added in early:
            total += early.pop(added)
            added += 1
    return total


def _fix_signs(vectors: np.ndarray) -> np.ndarray:
    """Turns each column so that its largest entry (lowest index on a tie) is positive."""
    magnitudes = np.abs(vectors)
    largest = np.argmax(magnitudes >= (1.0 - _MAGNITUDE_TIE) * magnitudes.max(axis=0), axis=0)
    signs = np.sign(vectors[largest, np.arange(vectors.shape[1])])
    return np.ascontiguousarray(vectors * signs)
