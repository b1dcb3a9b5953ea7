"""Edges: published counts, Algorithm 2, rankings."""

import numpy as np
import pytest

from learning_to_simulate import connectivity_utils as cu
from learning_to_simulate import presets
from learning_to_simulate.scene import RigidMotion, Scene
from learning_to_simulate.subspace import edge_lists


def scene(motion='prescribed', n_modes=8, rigid_edges=()):
    return Scene('s', n_modes, RigidMotion(motion), tuple(rigid_edges), True, (), 100, 1 / 60)


def chosen(adjacency, keep, velocities=None, n_modes=8, seed=0):
    """The mode -> mode edges that a config asks for."""
    config = presets.make_config('pcg', adjacency=adjacency, mode_edges=keep, seed=seed)
    return edge_lists.choose(config, '', n_modes, velocities).mode_mask


def ring_edges(n_ring=2, n_point=8):
    """Both neighbours of every particle on its ring."""
    return [
        (ring * n_point + (p + step) % n_point, ring * n_point + p)
        for ring in range(n_ring)
        for p in range(n_point)
        for step in (-1, 1)
    ]


def test_edge_counts_of_the_thesis():
    """Usmani & Skonieczny 2023: excavation 784 -> 188, wheel 576 -> 336 (Algorithm 2)."""
    assert cu.build('fully_connected', scene(), 20).sum() == 784
    assert cu.build('fully_connected', scene(), 16).sum() == 576
    velocities = np.random.default_rng(0).normal(size=(2, 50, 8, 3))
    blade = cu.algorithm2(scene(), 20, chosen('correlation', 28, velocities))
    assert blade.sum() == 188
    # 2 * 16 * 8 rigid <-> mode edges, 32 on the rings, the rest of their 80 between modes.
    wheel = cu.algorithm2(
        scene('predicted', rigid_edges=ring_edges()), 16, chosen('correlation', 48, velocities)
    )
    assert wheel.sum() == 336


@pytest.mark.parametrize(
    ('motion', 'to_rigid', 'among_rigid'),
    [
        ('prescribed', False, False),
        ('driven', True, False),
        ('predicted', True, True),
        ('none', False, False),
    ],
)
def test_rigid_nodes_receive_only_where_they_are_predicted(motion, to_rigid, among_rigid):
    n_rigid = 0 if motion == 'none' else 4
    mask = cu.algorithm2(
        scene(motion, 3, [(0, 1)] if n_rigid else []), n_rigid, np.eye(3, dtype=bool)
    )
    assert mask[n_rigid:, :n_rigid].all()
    assert mask[:n_rigid, n_rigid:].any() == to_rigid
    assert mask[:n_rigid, :n_rigid].any() == among_rigid
    assert (mask[n_rigid:, n_rigid:] == np.eye(3)).all()


def test_ranked_edges_find_the_mode_that_leads():
    """Mode 1 repeats mode 0 one frame later; modes 2 and 3 are noise."""
    v = np.random.default_rng(2).normal(size=(1, 400, 4, 3))
    v[:, 1:, 1] = v[:, :-1, 0]
    mask = chosen('correlation', 5, v, n_modes=4)
    assert mask.diagonal().all()
    assert mask[1, 0] and mask.sum() == 5


def test_drawn_edges_are_of_their_seed_and_as_likely_as_any():
    drawn = [chosen('random', 28, seed=seed) for seed in range(200)]
    assert all(mask.sum() == 28 and mask.diagonal().all() for mask in drawn)
    np.testing.assert_array_equal(drawn[3], chosen('random', 28, seed=3))
    share = np.mean(drawn, axis=0)[~np.eye(8, dtype=bool)]
    # 20 of 56; a share of 200 draws has a deviation of 0.034.
    assert np.abs(share - 20 / 56).max() < 4 * 0.034 and share.std() > 0.02
    with pytest.raises(ValueError, match='65 edges to keep'):
        chosen('random', 65)


def test_nearest_neighbours_on_a_ring_are_the_ring_neighbours():
    angle = np.arange(8) * np.pi / 4
    rings = [np.stack([np.cos(angle), np.sin(angle), np.full(8, z)], -1) for z in (0.0, 2.0)]
    edges = cu.nearest_neighbour_edges(np.concatenate(rings))
    assert sorted(edges) == sorted(ring_edges())


def test_mask_of_modes_is_completed_and_other_sizes_are_refused():
    mask = np.eye(8, dtype=bool)
    assert cu.build('file', scene(), 4, mode_mask=mask).sum() == 4 * 8 + 8
    assert cu.build('file', scene(), 4, loaded_mask=np.eye(12, dtype=bool)).sum() == 12
    with pytest.raises(ValueError, match=r'11 x 11.*12 nodes'):
        cu.build('file', scene(), 4, loaded_mask=np.eye(11, dtype=bool))


def test_correlations_of_runs_of_different_lengths():
    """Each run lags within itself; held to the mean over all lagged pairs."""
    v = np.random.default_rng(8).normal(size=(2, 60, 3, 3)).cumsum(axis=1)
    whole = cu.mode_correlations(v)
    np.testing.assert_allclose(cu.mode_correlations([v[:1], v[1:]]), whole, rtol=1e-12)
    np.testing.assert_allclose(cu.mode_correlations([v, v]), whole, rtol=1e-12)
    longer = np.random.default_rng(9).normal(size=(3, 45, 3, 3))
    mixed = cu.mode_correlations([v, longer])
    frames = np.concatenate([v.reshape(-1, 3, 3), longer.reshape(-1, 3, 3)])
    lagged = [(x[:, 1:] - frames.mean(0), x[:, :-1] - frames.mean(0)) for x in (v, longer)]
    pairs = [np.concatenate([part[k].reshape(-1, 3, 3) for part in lagged]) for k in (0, 1)]
    now, before = (pair / frames.std(0) for pair in pairs)
    for i, j in np.ndindex(3, 3):
        assert mixed[i, j] == pytest.approx(abs((now[:, i] * before[:, j]).mean()))
