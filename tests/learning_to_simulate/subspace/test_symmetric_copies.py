"""Shifted and mirrored runs: what they must be of fields that are known."""

import numpy as np
import pytest

from learning_to_simulate.reading_utils import RunGroup
from learning_to_simulate.subspace import symmetric_copies
from pca_tools.subspace import Subspace

# A bed of 30 x 6 x 10 particles, 2 cm apart.
AXES = [0.02 * np.arange(n) for n in (30, 6, 10)]
POINTS = np.stack(np.meshgrid(*AXES, indexing='ij'), axis=-1).reshape(-1, 3)


def _bump(centre, skew=0.0):
    """A smooth hump of soil about x = centre [N], wider than the particles are apart."""
    across = (POINTS[:, 2] - POINTS[:, 2].mean()) / 0.1
    return np.exp(-(((POINTS[:, 0] - centre) / 0.06) ** 2)) * (1 + skew * across)


def _space(fields):
    modes, _ = np.linalg.qr(np.stack(fields, axis=1))
    r = modes.shape[1]
    return Subspace(POINTS, modes, np.ones(r), float(r), 3, 'configuration', ('a',), POINTS)


@pytest.mark.parametrize('mirrored', [False, True])
def test_a_shifted_hump_is_the_hump_elsewhere(mirrored):
    """Soil that rises about x = 0.3 by up to 10 mm, shifted by 0.11 m: rises about 0.41."""
    here, there = _bump(0.3, 0.5), _bump(0.41, -0.5 if mirrored else 0.5)
    space = _space([here, there])
    shift = symmetric_copies.shift_of(space, 0, 2, 0.11, mirrored)
    moved = np.zeros((len(POINTS), 3))
    moved[:, 1] = 0.01 * here
    expected = np.zeros_like(moved)
    expected[:, 1] = 0.01 * there
    got = space.components @ (shift.matrix @ (space.components.T @ moved))
    error = np.sqrt(((got - expected) ** 2).mean() / (expected**2).mean())
    assert error < 0.05  # interpolation between particles 2 cm apart; a wrong sign gives 1.4


def _group(space, x, seed):
    rng = np.random.default_rng(seed)
    body = np.zeros((len(x), 7, 2, 3))
    body[..., 0] = x[:, :, None]
    body[:, :, :, 2] = [0.05, 0.13]
    scores = space.encode(space.initial) + 0.01 * rng.normal(size=(len(x), 7, 2, 3))
    force = rng.normal(size=(len(x), 7, 3))
    return RunGroup(2, np.zeros(4, int), np.concatenate([body, scores], axis=2), force, None,
                    np.arange(len(x)))  # fmt: skip


def test_copies_follow_the_runs_stay_in_their_range_and_mirror_loads():
    space = _space([_bump(0.3), _bump(0.3, 0.5)])
    x = np.linspace(0, 1, 7) * np.array([[0.1], [0.3]]) + 0.1
    group = _group(space, x, 0)
    (more,) = symmetric_copies.with_copies([group], space, up=1, copies=2, seed=3)
    np.testing.assert_array_equal(more.position[:2], group.position)
    # The second run spans all of the range: no shift has room. The first one has its two copies.
    assert more.record.tolist() == [0, 1, 0, 0]
    (again,) = symmetric_copies.with_copies([group], space, up=1, copies=2, seed=3)
    np.testing.assert_array_equal(again.position, more.position)
    for copy in range(2, 4):
        body, force = more.position[copy, :, :2], more.force[copy]
        distance = body[0, 0, 0] - 0.1
        assert 0 < abs(distance) <= symmetric_copies.LARGEST_SHIFT
        np.testing.assert_allclose(body[:, 0, 0], x[0] + distance)
        assert body[..., 0].min() >= x.min() and body[..., 0].max() <= x.max()
        mirrored = body[0, 0, 2] > body[0, 1, 2]
        sign = np.array([1, 1, -1 if mirrored else 1])
        np.testing.assert_allclose(force, group.force[0] * sign)
        # The scores are the shift of the run's own, counted from the resting bed.
        shift = symmetric_copies.shift_of(space, 0, 2, distance, mirrored)
        rest = space.encode(space.initial)
        expected = shift.matrix @ (group.position[0, :, 2:] - rest)
        expected[..., 2] *= -1 if mirrored else 1
        np.testing.assert_allclose(more.position[copy, :, 2:], expected + rest, atol=1e-12)
