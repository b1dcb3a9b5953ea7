"""Whether runs list the same particles in one order: beds that are sunk, cut, shuffled."""

import numpy as np
import pytest

from pca_tools import matching


def lattice(axes):
    """Points of a regular lattice of spacing 0.05 m, [N, 3]."""
    points = np.stack(np.meshgrid(*(0.05 * np.arange(n) for n in axes), indexing='ij'), -1)
    return points.reshape(-1, 3)


def beds():
    """Name and points [N, 3] of beds of several kinds."""
    rng = np.random.default_rng(0)
    yield 'lattice', lattice((20, 8, 10))
    yield 'plane', lattice((40, 40, 1))
    yield 'random', rng.uniform(0, [1.0, 0.4, 0.5], (1600, 3))
    yield 'jittered', lattice((20, 8, 10)) + rng.uniform(-0.02, 0.02, (1600, 3))


@pytest.mark.parametrize(('name', 'bed'), list(beds()))
def test_another_order_is_found(name, bed):
    last = 55 * len(bed) // 100
    partly = np.concatenate([bed[:last], np.roll(bed[last:], -1, axis=0)])
    for points in (np.roll(bed, -1, axis=0), partly, bed[::-1]):
        fault = matching.order_fault(points, bed, 'case 1')
        assert 'case 1' in fault and 'not the same order (then give --match_particles)' in fault
        order = matching.match_particles(points, bed)
        assert not matching.order_fault(points[order], bed, 'case 1')


@pytest.mark.parametrize(('name', 'bed'), list(beds()))
@pytest.mark.parametrize('share', [0.1, 0.45])
def test_beds_that_sank_or_were_cut_are_the_same(name, bed, share):
    """Particles that flowed lie anywhere in the bed, the others sank by a tenth of a spacing."""
    rng = np.random.default_rng(1)
    sunk = bed + rng.normal(scale=0.005, size=bed.shape) * (np.ptp(bed, axis=0) > 0)
    for _ in range(5):
        moved = rng.random(len(bed)) < share
        anywhere = rng.uniform(bed.min(axis=0), bed.max(axis=0), bed.shape)
        points = np.where(moved[:, None], anywhere, sunk)
        assert not matching.order_fault(points, bed, 'case 1')


def test_matching_is_one_to_one_and_refuses_other_packings():
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 1, (800, 3))
    order = rng.permutation(800)
    moved = points + rng.normal(0, 0.01, points.shape)
    np.testing.assert_array_equal(matching.match_particles(moved[order], moved), np.argsort(order))
    near = matching.match_particles(moved[order], points)
    assert sorted(near.tolist()) == list(range(800))
    assert np.mean(order[near] == np.arange(800)) > 0.95
    with pytest.raises(ValueError, match='no one-to-one matching'):
        matching.match_particles([[0, 0, 1e-9]] * np.arange(800)[:, None], points)
    with pytest.raises(ValueError, match='7 particles cannot be matched with 800'):
        matching.match_particles(points[:7], points)
