"""What a fit of the subspace computes, in float64: mean, singular values and vectors of the row
matrix X, from the matrix itself or from its covariance, summed up run by run.
"""

from __future__ import annotations

import numpy as np

DIM = 3
# An SVD holds the matrix, its copy and both factors.
SVD_COPIES = 4
# A rank-k update and an eigenvalue solver in place hold the N x N matrix and one spare copy of it.
COVARIANCE_COPIES = 2
_MAGNITUDE_TIE = 1e-9
# Of a covariance on workers: the matrix that comes back is as large as ten runs.
RUNS_PER_TASK = 16


def mean_configuration(runs, names, centering, progress) -> tuple[np.ndarray, int, float]:
    """Returns the mean ([N, 3] or []), the number of rows and the largest coordinate in magnitude;
    refuses runs that cannot be fitted."""
    total, frames, n_soil, largest = 0.0, 0, None, 0.0
    for name, run in zip(names, progress(runs, 'mean')):
        if run.ndim != 3 or run.shape[2] != DIM or run.shape[1] == 0:
            raise ValueError(
                f'run {name}: positions have shape {run.shape}, [T, N, 3] was expected'
            )
        if n_soil not in (None, run.shape[1]):
            raise ValueError(
                f'run {name} has {run.shape[1]} particles, the runs before it {n_soil}; a column '
                'must be the same particle in all runs'
            )
        n_soil = run.shape[1]
        refuse_non_finite(run, f'run {name}')
        total = total + run.sum(axis=0, dtype=np.float64)
        frames += len(run)
        largest = max(largest, float(np.abs(run).max()))
    if frames < 2:
        raise ValueError(f'{len(runs)} runs with {frames} frames in all: need at least 2 frames')
    configuration = total / frames
    mean = configuration if centering == 'configuration' else np.asarray(configuration.mean())  # type: ignore[attr-defined]
    return mean, frames * DIM, largest  # type: ignore[return-value]


def rows(run: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Returns float64 [T * 3, N], row k + 3 i = axis k of frame i, centred."""
    return np.ascontiguousarray((np.asarray(run, np.float64) - mean).transpose(0, 2, 1)).reshape(
        -1, run.shape[1]
    )


def decompose_matrix(runs, mean, length, progress):
    """Returns singular values [S], vectors [N, S] and total energy from the whole matrix."""
    matrix = np.concatenate([rows(run, mean) for run in progress(runs, 'matrix')])
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


def decompose_covariance(runs, mean, n_soil, length, progress, crew=None):
    """Returns singular values [S], vectors [N, S] and total energy from the summed covariance."""
    from scipy import linalg  # as slow to load as numpy, and whoever only reads modes needs it not

    if crew is None:
        covariance = sum_covariance((progress(runs, 'covariance'), mean, n_soil))
    else:
        covariance = _sum_in_parts(crew, runs, mean, n_soil, progress)
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
        matrix = rows(run, mean)
        covariance = linalg.blas.dsyrk(1.0, matrix.T, beta=1.0, c=covariance, overwrite_c=True)
    return covariance


def _sum_in_parts(crew, runs, mean, n_soil, progress) -> np.ndarray:
    """Sums covariances on workers, each a part of the runs. The parts do not depend on the number
    of workers and are added in their order, so neither does the sum."""
    starts = range(0, len(runs), RUNS_PER_TASK)
    parts = [(runs.part(start, start + RUNS_PER_TASK), mean, n_soil) for start in starts]
    total, early = np.zeros((n_soil, n_soil), order='F'), {}
    added = 0
    for outcome in progress(crew.run(sum_covariance, parts), 'covariance, parts'):
        if outcome.error is not None:
            raise ValueError(f'covariance of part {outcome.index}: {outcome.error}')
        early[outcome.index] = outcome.value
        while added in early:
            total += early.pop(added)
            added += 1
    return total


def fix_signs(vectors: np.ndarray) -> np.ndarray:
    """Turns each column so that its largest entry (lowest index on a tie) is positive."""
    magnitudes = np.abs(vectors)
    largest = np.argmax(magnitudes >= (1.0 - _MAGNITUDE_TIE) * magnitudes.max(axis=0), axis=0)
    signs = np.sign(vectors[largest, np.arange(vectors.shape[1])])
    return np.ascontiguousarray(vectors * signs)


def refuse_non_finite(x: np.ndarray, what: str) -> None:
    if np.all(np.isfinite(x)):
        return
    bad = np.argwhere(~np.isfinite(x))
    *frame, particle, axis = bad[0].tolist()
    place = f'frame {frame[-1]}, ' if frame else ''
    raise ValueError(
        f'{what}: {len(bad)} NaN or infinite values, the first at {place}particle {particle}, '
        f'axis {axis}'
    )
