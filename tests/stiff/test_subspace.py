"""The subspace on ill-conditioned data."""

import warnings

import numpy as np
import pytest
from scipy import linalg

from pca_tools import subspace

FRAMES, PARTICLES = 60, 140
# Large enough for the covariance of 140 particles, too small for the matrix.
MEMORY = pytest.mark.parametrize('memory', [1024, 0.5], ids=['matrix', 'covariance'])


def run_with_spectrum(values, offset=0.0, seed=0):
    """One run [T, N, 3] about `offset` with exactly these singular values of motion."""
    rng = np.random.default_rng(seed)
    shapes = np.linalg.qr(rng.standard_normal((PARTICLES, len(values))))[0]
    # Rows whose columns sum to zero, so that the mean configuration takes nothing away.
    rows = rng.standard_normal((3 * FRAMES, len(values)))
    rows -= rows.reshape(FRAMES, 3, -1).mean(axis=0)[None].repeat(FRAMES, 0).reshape(rows.shape)
    rows = np.linalg.qr(rows)[0] * values
    motion = (rows @ shapes.T).reshape(FRAMES, 3, PARTICLES).transpose(0, 2, 1)
    return rng.random((PARTICLES, 3)) + offset + motion, shapes


def angle(first, second):
    """Largest principal angle, rad; from projectors, exact for small angles."""
    return linalg.subspace_angles(first, second).max()


@MEMORY
@pytest.mark.parametrize('offset', [0.0, 1e3], ids=['mean 1', 'mean 1000'])
def test_spectrum_of_eight_decades(memory, offset):
    """Energies 1 to 1e-8 about a mean of 1000: centred in float64 before anything is squared."""
    values = 10.0 ** -np.arange(0.0, 4.5, 0.5)
    run, shapes = run_with_spectrum(values, offset)
    space = subspace.fit([run], 8, max_memory_mb=memory)
    # Measured 5e-10: round-off of positions near 1000, 1e-13, over the smallest value kept, 3e-4.
    tolerance = 1e-9 if offset == 0.0 else 5e-9
    np.testing.assert_allclose(space.singular_values[:8] ** 2, values[:8] ** 2, rtol=tolerance)
    assert angle(space.components, shapes[:, :8]) < 1e-7  # measured 1.3e-9
    eps = np.finfo(float).eps
    assert np.abs(space.components.T @ space.components - np.eye(8)).max() <= 50 * eps
    assert (space.singular_values >= 0).all() and space.components.dtype == np.float64


def test_cluster_is_compared_as_a_subspace():
    """Two modes 0.01 % apart: single vectors turn with the noise, their plane does not."""
    values = np.array([1.0, 0.5, 0.49995, 0.1, 0.01])
    run, shapes = run_with_spectrum(values)
    noise = 1e-7 * np.random.default_rng(1).standard_normal(run.shape)
    with warnings.catch_warnings():
        warnings.simplefilter('error')  # the cut after mode 3 lies in a wide gap
        spaces = [subspace.fit([x], 3) for x in (run, run + noise)]
    assert all(space.gaps[1] < subspace.CLUSTER_GAP < space.gaps[2] for space in spaces)
    # Measured 2.4e-6 rad for the plane and 1.7e-3 rad for the vector with noise of 1e-7 m.
    plane = angle(*(space.components for space in spaces))
    vector = angle(*(space.components[:, 1:2] for space in spaces))
    assert plane < 2e-5 and plane < 0.1 * vector
    assert angle(spaces[0].components, shapes[:, :3]) < 1e-6
    with pytest.warns(UserWarning, match='cut after mode 2 lies inside a cluster'):
        subspace.fit([run], 2)
