"""Subspace against numpy's SVD, and its refusals."""

import dataclasses

import numpy as np
import pytest
from scipy import linalg

from pca_tools import files
from pca_tools.subspace import CENTERINGS, Subspace, fit

# small enough that the matrix does not fit but the covariance of 140 particles does
COVARIANCE_MB = 0.5


def make_runs(count=4, frames=20, particles=140, rank=12, seed=0, offset=0.0):
    """Runs whose motion has exactly `rank` columns of falling size."""
    rng = np.random.default_rng(seed)
    start = rng.random((particles, 3)) + offset
    shapes = np.linalg.qr(rng.standard_normal((particles, rank)))[0] * 0.6 ** np.arange(rank)
    return [start + shapes @ rng.standard_normal((frames, rank, 3)) for _ in range(count)]


def twin(runs, centering):
    """Singular values, right vectors and centred rows by numpy, straight from the definition."""
    stacked = np.concatenate(runs)
    mean = stacked.mean(axis=0) if centering == 'configuration' else stacked.mean()
    rows = np.concatenate([frame.T for frame in stacked - mean])
    _, values, vectors = np.linalg.svd(rows, full_matrices=False)
    return values, vectors.T, rows


@pytest.mark.parametrize('centering', CENTERINGS)
@pytest.mark.parametrize('memory', [1024, COVARIANCE_MB], ids=['matrix', 'covariance'])
def test_agrees_with_numpy(centering, memory):
    runs = make_runs()
    space = fit(runs, 8, centering, memory)
    values, vectors, rows = twin(runs, centering)
    # measured: 1e-15 from the matrix, 8e-15 from the covariance; angles 8e-14, floor 4e-12
    tolerance = 2e-14 if memory > 1 else 1e-13
    np.testing.assert_allclose(space.singular_values[:8], values[:8], rtol=tolerance)
    angles = linalg.subspace_angles(space.components, vectors[:, :8])
    assert angles.max() < 1e-12
    assert space.total_energy == pytest.approx(np.sum(rows**2), rel=1e-12)
    left = np.mean((rows - rows @ vectors[:, :8] @ vectors[:, :8].T) ** 2)
    assert space.projection_floor() == pytest.approx(left, rel=1e-10)
    assert np.abs(space.components.T @ space.components - np.eye(8)).max() < 1e-14


@pytest.mark.parametrize('centering', CENTERINGS)
def test_projection_is_idempotent_and_splits_the_energy(centering):
    runs = make_runs()
    space, x = fit(runs, 5, centering), runs[1]
    once = space.decode(space.encode(x))
    assert once.dtype == np.float64
    np.testing.assert_allclose(space.decode(space.encode(once)), once, atol=1e-13)
    total, kept, left = (np.sum(y**2) for y in (x - space.mean, once - space.mean, x - once))
    assert total == pytest.approx(kept + left, rel=1e-12)
    assert np.sum(space.encode(x) ** 2) == pytest.approx(kept, rel=1e-12)


def test_signs_and_order_of_rows_do_not_matter():
    runs = make_runs()
    space = fit(runs, 8)
    largest = np.abs(space.components).argmax(axis=0)
    assert np.all(space.components[largest, np.arange(8)] > 0)
    shuffled = np.random.default_rng(1).permutation(np.concatenate(runs))
    again = fit([shuffled[:30], shuffled[30:]], 8)
    # measured 3e-15; the smallest of 8 singular values is 3 % of the largest
    np.testing.assert_allclose(again.components, space.components, atol=1e-13)
    assert fit(runs, 8).digest == space.digest


@pytest.mark.parametrize('memory', [1024, COVARIANCE_MB])
def test_refusals(memory):
    runs = make_runs(3)
    still = [np.full((40, 140, 3), 0.3, np.float32)] * 2
    for arguments, text in (
        (([runs[0][:1]], 1), 'at least 2 frames'),
        (([], 1), 'at least 2 frames'),
        (([*runs, *make_runs(1, particles=120)], 3), r'run 3: .* 120, 3\), not \[T, 140, 3\]'),
        (([runs[0], runs[0] * np.nan], 3), 'run 1 holds .* NaN'),
        ((runs, 3, 'median'), 'centering'),
        ((runs, 0), '0 modes'),
        ((runs, 13), 'asked for 13 modes, data rank is 12'),
        ((make_runs(1, 2), 18), '18 modes.*6 rows.*140 particles have at most 6'),
        ((still, 2, 'configuration'), 'constant'),
        ((still, 2, 'scalar'), 'constant'),
        (([np.tile(runs[0][:1], (30, 1, 1))] * 2, 2), 'constant'),
    ):
        with pytest.raises(ValueError, match=text):
            fit(*arguments, max_memory_mb=memory)
    with pytest.raises(ValueError, match=r'needs 0 MiB.*raise --max_memory_mb'):
        fit(runs, 3, max_memory_mb=0.01)


def test_positions_and_scores_that_do_not_fit():
    runs = make_runs(3)
    space = fit(runs, 3)
    runs[2][4, 17, 1] = np.nan
    with pytest.raises(ValueError, match='1 NaN .*frame 4, particle 17, axis 1'):
        space.encode(runs[2])
    with pytest.raises(ValueError, match=r'\(139, 3\), not \[\.\.\., 140, 3\]'):
        space.encode(np.zeros((139, 3)))
    with pytest.raises(ValueError, match=r'\(4, 3\), not \[\.\.\., 3, 3\]'):
        space.decode(np.zeros((4, 3)))


def test_save_and_load(tmp_path):
    path = str(tmp_path / 'subspace.npz')
    space = fit(make_runs(), 4, 'scalar', names=['1', '2', '3', '4'])
    space.save(path)
    loaded = Subspace.load(path)
    for field in dataclasses.fields(Subspace):
        np.testing.assert_array_equal(getattr(loaded, field.name), getattr(space, field.name))
    assert loaded.digest == space.digest
    arrays = files.read_npz(path)
    arrays['components'] = arrays['components'] * 1.001
    files.write_npz(path, **arrays)
    with pytest.raises(ValueError, match='the digest does not fit'):
        Subspace.load(path)
    del arrays['mean']
    files.write_npz(path, **arrays)
    with pytest.raises(ValueError, match=r"lacks \['mean'\]"):
        Subspace.load(path)
