"""Adjacency: published edge counts, file formats, refusals."""

import json

import numpy as np
import pytest

from learning_to_simulate import connectivity_utils as cu
from learning_to_simulate.scene import RigidMotion, Scene


def scene(motion='prescribed', n_modes=8, rigid_edges=()):
    return Scene('s', n_modes, RigidMotion(motion), tuple(rigid_edges), True, (), 100, 1 / 60)


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
    assert cu.fully_connected(28).n_edge == 784
    assert cu.fully_connected(24).n_edge == 576
    velocities = np.random.default_rng(0).normal(size=(2, 50, 8, 3))
    blade = cu.algorithm2(scene(), 20, cu.rank_mode_edges(velocities, 28))
    assert blade.n_edge == 188
    # 2 * 16 * 8 rigid <-> mode edges, 32 on the rings, the rest of their 80 between modes.
    wheel = cu.algorithm2(
        scene('predicted', rigid_edges=ring_edges()), 16, cu.rank_mode_edges(velocities, 48)
    )
    assert wheel.n_edge == 336


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
    ).mask()
    assert mask[n_rigid:, :n_rigid].all()
    assert mask[:n_rigid, n_rigid:].any() == to_rigid
    assert mask[:n_rigid, :n_rigid].any() == among_rigid
    assert (mask[n_rigid:, n_rigid:] == np.eye(3)).all()


def test_all_edges_kept_equals_the_dense_graph():
    velocities = np.random.default_rng(1).normal(size=(1, 20, 5, 3))
    assert cu.rank_mode_edges(velocities, 25).all()


def test_ranked_edges_find_the_mode_that_leads():
    """Mode 1 repeats mode 0 one frame later; modes 2 and 3 are noise."""
    v = np.random.default_rng(2).normal(size=(1, 400, 4, 3))
    v[:, 1:, 1] = v[:, :-1, 0]
    mask = cu.rank_mode_edges(v, 5)
    assert mask.diagonal().all()
    assert mask[1, 0] and mask.sum() == 5


def test_nearest_neighbours_on_a_ring_are_the_ring_neighbours():
    angle = np.arange(8) * np.pi / 4
    rings = [np.stack([np.cos(angle), np.sin(angle), np.full(8, z)], -1) for z in (0.0, 2.0)]
    edges = cu.nearest_neighbour_edges(np.concatenate(rings))
    assert sorted(edges) == sorted(ring_edges())


@pytest.mark.parametrize('suffix', ['json', 'npy'])
def test_files_round_trip(tmp_path, suffix):
    mask = np.random.default_rng(3).random((6, 6)) < 0.4
    adjacency = cu.Adjacency.from_mask(mask)
    path = tmp_path / f'edges.{suffix}'
    if suffix == 'npy':
        np.save(path, mask)
    else:
        ends = {'senders': adjacency.senders.tolist(), 'receivers': adjacency.receivers.tolist()}
        path.write_text(json.dumps(ends | {'node_names': [f'mode_{i}' for i in range(6)]}))
    np.testing.assert_array_equal(cu.load_mask(str(path)), mask)


def test_mask_of_modes_is_completed_and_other_sizes_are_refused():
    mask = np.eye(8, dtype=bool)
    assert cu.build('file', scene(), 4, loaded_mask=mask).n_edge == 4 * 8 + 8
    assert cu.build('file', scene(), 4, loaded_mask=np.eye(12, dtype=bool)).n_edge == 12
    with pytest.raises(ValueError, match=r'11 x 11.*12 nodes'):
        cu.build('file', scene(), 4, loaded_mask=np.eye(11, dtype=bool))


@pytest.mark.parametrize(
    ('name', 'content', 'message'),
    [
        ('a.npy', b'not an array', 'plain .npy'),
        ('a.json', b'{"senders": [0]}', 'receivers'),
        ('a.json', b'{"senders": [9], "receivers": [0], "node_names": ["a"]}', 'only 1|1 nodes'),
        ('a.json', b'[1, 2', 'not a JSON file'),
        ('a.npy', b'version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n', 'git-lfs'),
    ],
)
def test_foreign_edge_files_are_refused(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=message):
        cu.load_mask(str(tmp_path / name))


def test_missing_file_and_ragged_mask_are_refused(tmp_path):
    with pytest.raises(ValueError, match='no such edge file'):
        cu.load_mask(str(tmp_path / 'gone.json'))
    np.save(tmp_path / 'wide.npy', np.zeros((3, 4)))
    with pytest.raises(ValueError, match='square'):
        cu.load_mask(str(tmp_path / 'wide.npy'))


def test_bad_edges_are_refused():
    one = np.array([0], np.int32)
    with pytest.raises(ValueError, match='2 nodes'):
        cu.Adjacency(one, np.array([2], np.int32), 2)
    with pytest.raises(ValueError, match='twice'):
        cu.Adjacency(np.array([0, 0], np.int32), np.array([1, 1], np.int32), 2)
    with pytest.raises(ValueError, match='two equal lists'):
        cu.Adjacency(one, np.array([0, 1], np.int32), 2)
