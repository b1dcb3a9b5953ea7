"""Edge lists: the file format, its refusals, and what a config makes of a dataset."""

import dataclasses
import json
import os
import shutil

import numpy as np
import pytest

from learning_to_simulate import checkpoints, presets, registry
from learning_to_simulate.subspace import edge_lists
from tests.learning_to_simulate import models, synthetic

R = synthetic.N_MODES
GONE = object()  # of a field that the file lacks


def edge_list(mask=None, n=4, digests=None, **changes):
    """A valid list of n modes."""
    rng = np.random.default_rng(0)
    probabilities = np.round(rng.random((n, n)), 3)
    np.fill_diagonal(probabilities, np.nan)
    if mask is None:
        mask = edge_lists.select(probabilities, threshold=0.4)
    values = {
        'mask': mask,
        'node_names': edge_lists.mode_names(n),
        'probabilities': probabilities,
        'method': 'nri',
        'threshold': 0.4,
        'digests': digests or {'model': 'a' * 64, 'subspace.npz': 'b' * 64},
        'report': {'runs': 3},
    }
    return edge_lists.EdgeList(**values | changes)


@pytest.fixture(scope='module')
def data(tmp_path_factory):
    return synthetic.write_dataset(tmp_path_factory.mktemp('data'))


def test_file_round_trip(tmp_path):
    path = str(tmp_path / 'edges.json')
    written = edge_list()
    edge_lists.write(path, written)
    read = edge_lists.read(path)
    for field in dataclasses.fields(written):
        np.testing.assert_array_equal(getattr(read, field.name), getattr(written, field.name))


def test_names_and_not_positions_decide():
    """Permuted nodes are the same graph; rigid nodes of an NRI result stay outside the block."""
    edges = edge_list()
    order = [2, 0, 3, 1]
    block = np.ix_(order, order)
    names = tuple(edges.node_names[k] for k in order)
    permuted = edge_list(
        edges.mask[block], node_names=names, probabilities=edges.probabilities[block]
    )
    np.testing.assert_array_equal(permuted.mask_for(edges.node_names), edges.mask)
    whole = np.ones((6, 6), bool)
    whole[0, 1] = False
    whole[2:, 2:] = edges.mask
    with_rigid = edge_list(
        whole, node_names=('rigid_0', 'rigid_1', *edges.node_names), probabilities=np.zeros((6, 6))
    )
    np.testing.assert_array_equal(with_rigid.mask_for(edges.node_names), edges.mask)
    for wrong in (edge_lists.mode_names(5), edge_lists.mode_names(3), ('a', 'b', 'c', 'd')):
        with pytest.raises(ValueError, match='the edges join 4 nodes'):
            edges.mask_for(wrong)


def test_selection_by_threshold_and_by_number():
    p = np.array([[np.nan, 0.6, 0.61], [0.9, np.nan, 0.1], [0.1, 0.7, np.nan]])
    best = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    np.testing.assert_array_equal(edge_lists.select(p, threshold=0.6), best)
    np.testing.assert_array_equal(edge_lists.select(p, keep=3), best)
    np.testing.assert_array_equal(edge_lists.select(p, keep=6), 1 - np.eye(3))
    ties = edge_lists.select(np.full((2, 2), 0.5), keep=3)
    np.testing.assert_array_equal(ties, [[1, 1], [1, 0]])
    gates = np.array([[0.2, 0.6], [0.9, 0.8]])  # self-edges with probabilities of their own
    np.testing.assert_array_equal(edge_lists.select(gates, keep=2), [[0, 0], [1, 1]])
    for wish in ({'keep': -1}, {'keep': 7}, {}, {'keep': 5, 'threshold': 0.5}):
        with pytest.raises(ValueError, match='keep'):
            edge_lists.select(p, **wish)


def test_degenerate_graphs_must_say_so(tmp_path):
    for mask, name in ((np.eye(4, dtype=bool), 'empty'), (np.ones((4, 4), bool), 'saturated')):
        with pytest.raises(ValueError, match=f'the graph is {name}'):
            edge_list(mask)
        path = str(tmp_path / 'edges.json')
        edge_lists.write(path, edge_list(mask, degenerate=name))
        assert edge_lists.read(path).degenerate == name


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'schema_version': 2}, 'schema version 1'),
        ({'receivers': None}, 'lists of whole numbers'),
        ({'senders': [0.5] * 3}, 'whole numbers'),
        ({'senders': [0, 0], 'receivers': [1, 1]}, 'listed twice'),
        ({'senders': [0, 4], 'receivers': [1, 1]}, 'there are 4 nodes'),
        ({'senders': [0, -1], 'receivers': [1, 1]}, 'there are 4 nodes'),
        ({'senders': [0], 'receivers': [1, 1]}, 'two equal lists'),
        ({'senders': [2**40], 'receivers': [1]}, 'edges.json'),
        ({'senders': [], 'receivers': []}, 'the graph is empty'),
        ({'node_names': ['mode_0'] * 4}, 'different names'),
        ({'node_names': []}, 'there are 0 nodes'),
        ({'node_names': ['mode_0', 'mode_1']}, 'there are 2 nodes'),
        ({'probabilities': [[0.1]]}, 'for 4 nodes'),
        ({'probabilities': [[1.5] * 4] * 4}, r'must lie in \[0, 1\]'),
        ({'probabilities': [[1.0], []]}, 'edges.json'),
        ({'method': 'guessed'}, 'must be one of'),
        ({'threshold': 60}, 'threshold is 60'),
        ({'threshold': 'high'}, 'edges.json'),
        ({'convention': 'row is sender'}, 'convention'),
        ({'digests': {'model': 7}}, 'digests'),
        ({'digests': None}, 'edges.json'),
        *(
            ({key: GONE}, f"'{key}' is missing")
            for key in ('convention', 'node_names', 'senders', 'digests', 'degenerate')
        ),
    ],
)
def test_damaged_files_are_refused(tmp_path, change, message):
    path = tmp_path / 'edges.json'
    edge_lists.write(str(path), edge_list())
    values = json.loads(path.read_text()) | change
    path.write_text(json.dumps({k: v for k, v in values.items() if v is not GONE}))
    with pytest.raises(ValueError, match=message):
        edge_lists.read(str(path))


@pytest.mark.parametrize(
    ('name', 'content', 'message'),
    [('a.npy', b'not an array', 'plain .npy'), ('a.json', b'[1, 2]', 'schema version')],
)
def test_foreign_files_are_refused(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    read = edge_lists.read_mask if name.endswith('npy') else edge_lists.read
    with pytest.raises(ValueError, match=message):
        read(str(tmp_path / name))
    with pytest.raises(ValueError, match='no such edge file'):
        read(str(tmp_path / 'gone'))


def test_edges_of_another_dataset_are_refused(data, tmp_path):
    other = synthetic.write_dataset(tmp_path / 'other', n_run=3)
    edges = edge_list(n=R, digests={'model': None} | edge_lists.data_digests(other))
    edges.check_data(other)
    with pytest.raises(ValueError, match='another dataset: train.tfrecord'):
        edges.check_data(data)
    with pytest.raises(ValueError, match='nothing says'):
        edge_list(n=R, digests={'model': None}).check_data(data)
    # The same subspace, other runs: the same nodes.
    for folder in (data, other):
        shutil.copytree(folder, tmp_path / 'copy', dirs_exist_ok=True)
        (tmp_path / 'copy' / 'subspace.npz').write_bytes(b'one and the same')
        digests = edge_lists.data_digests(str(tmp_path / 'copy'))
        edge_list(n=R, digests=digests | {'train.tfrecord': 'c' * 64}).check_data(
            str(tmp_path / 'copy')
        )


def make_model(folder, **overrides):
    config = presets.make_config('pcg', latent_size=8, **overrides)
    return models.of_dataset(folder, config)[0]


def test_default_preset_takes_the_list_of_the_dataset(data, tmp_path):
    ranked = make_model(data, mode_edges=5)
    assert ranked.edge_source == '5 ranked by lagged correlation' and ranked.mode_mask.sum() == 5
    folder = str(tmp_path / 'data')
    shutil.copytree(data, folder)
    mask = np.eye(R, dtype=bool)
    mask[0, 2] = True
    edges = edge_list(mask, R, edge_lists.data_digests(folder))
    edge_lists.write(f'{folder}/edges.json', edges)
    model = make_model(folder)
    np.testing.assert_array_equal(model.mode_mask, mask)
    assert model.edge_source.startswith('edges.json of the dataset (method nri, sha256 ')
    assert model.layout(4).n_edge == 4 * R + R + 1
    checkpoints.save_config(str(tmp_path), model, 4, {})
    stored = checkpoints.read_config(str(tmp_path))
    assert stored['edge_source'] == model.edge_source and stored['mode_mask'] == mask.tolist()
    assert make_model(folder, adjacency='correlation', mode_edges=5).mode_mask.sum() == 5
    with pytest.raises(ValueError, match='--adjacency=correlation'):
        make_model(folder, mode_edges=5)
    drawn = make_model(folder, adjacency='random', mode_edges=5, seed=3)
    assert drawn.mode_mask.sum() == 5 and drawn.edge_source == '5 by lot, seed 3'
    with pytest.raises(ValueError, match='another dataset'):
        other = synthetic.write_dataset(tmp_path / 'other', n_run=3)
        shutil.copy(f'{folder}/edges.json', other)
        make_model(other)


def test_edge_files_given_by_hand(data, tmp_path):
    np.save(tmp_path / 'modes.npy', np.eye(R, dtype=bool))
    np.save(tmp_path / 'all.npy', np.eye(4 + R, dtype=bool))
    assert make_model(data, adjacency=str(tmp_path / 'modes.npy')).layout(4).n_edge == 4 * R + R
    assert make_model(data, adjacency=str(tmp_path / 'all.npy')).layout(4).n_edge == 4 + R
    edges = edge_list(n=R + 1, digests=edge_lists.data_digests(data))
    edge_lists.write(str(tmp_path / 'more.json'), edges)
    with pytest.raises(ValueError, match='more.json: the edges join 4 nodes'):
        make_model(data, adjacency=str(tmp_path / 'more.json'))


def test_other_edges_do_not_resume_a_model(data, tmp_path):
    """The config is the same, the file beside the data is not."""
    folder, path = str(tmp_path / 'data'), str(tmp_path / 'model')
    shutil.copytree(data, folder)
    os.remove(f'{folder}/valid.tfrecord')  # no validation rollout, which would have to be compiled
    config = presets.make_config('pcg', latent_size=8, num_steps=2, unroll_steps=0)
    for k in (0, 1):
        mask = np.eye(R, dtype=bool)
        mask[k, 2] = True
        edges = edge_list(mask, R, edge_lists.data_digests(folder))
        edge_lists.write(f'{folder}/edges.json', edges)
        if k == 0:
            with models.eagerly():
                registry.train(folder, path, config)
    with pytest.raises(ValueError, match='other edges'):
        registry.train(folder, path, config)
