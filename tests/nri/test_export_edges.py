"""Export of what an NRI model found, with tiny models and with posteriors made by hand."""

import pathlib
import shutil
import subprocess
import sys

import numpy as np
import pytest

from learning_to_simulate import connectivity_utils
from learning_to_simulate.subspace import edge_lists
from nri import data as nri_data
from nri import experiment, export_edges
from nri.config import NriConfig
from nri.model import NriModel, load_model
from tests.learning_to_simulate import synthetic

ROOT = pathlib.Path(__file__).resolve().parents[2]
R = synthetic.N_MODES
TINY = {'hidden': 4, 'window': 8, 'segment': 3, 'batch_size': 8, 'epochs': 1}


@pytest.fixture(scope='module')
def data(tmp_path_factory):
    return synthetic.write_dataset(tmp_path_factory.mktemp('data'))


@pytest.fixture(scope='module')
def model_path(data, tmp_path_factory):
    """A model trained for one epoch. Not to be changed."""
    path = str(tmp_path_factory.mktemp('nri') / 'model')
    experiment.train(data, path, NriConfig(**TINY))
    return path


def with_posterior(monkeypatch, matrix, spread=0.0):
    """Makes every model say `matrix` ([V, V], [receiver, sender]), +- spread in every other run."""
    matrix = np.array(matrix)

    def probabilities(self, features):
        sign = np.where(np.arange(len(features)) % 2, 1.0, -1.0)[:, None]
        p = matrix[~np.eye(len(matrix), dtype=bool)] + spread * sign
        return np.stack([1 - p, p], axis=-1).astype(np.float32)

    monkeypatch.setattr(NriModel, 'edge_probabilities', probabilities)


FOUND = np.array([[0.0, 0.9, 0.3], [0.2, 0.0, 0.7], [0.5, 0.1, 0.0]])


def test_edges_are_those_of_the_posterior_in_kipfs_order(data, model_path, monkeypatch):
    """Receiver is the row: 1 -> 0 with 0.9, 2 -> 1 with 0.7."""
    with_posterior(monkeypatch, FOUND, spread=0.05)
    edges = export_edges.find_edges(model_path, data)
    assert list(zip(*np.nonzero(edges.mask))) == [(0, 1), (1, 2)]
    assert edges.node_names == edge_lists.mode_names(R) and edges.threshold == 0.6
    off = ~np.eye(R, dtype=bool)
    np.testing.assert_allclose(edges.probabilities[off], FOUND[off], atol=1e-6)
    assert np.isnan(edges.probabilities.diagonal()).all()
    report = edges.report
    assert report['runs'] == 4 and report['std_over_runs'] == pytest.approx(0.05, rel=1e-4)
    assert report['run_agreement'] == 1.0
    p = FOUND[off][None] + np.array([[0.05], [-0.05]])
    entropy = -(p * np.log2(p) + (1 - p) * np.log2(1 - p)).mean()
    assert report['entropy_bits'] == pytest.approx(entropy, rel=1e-5)
    edges.check_data(data)
    kept = export_edges.find_edges(model_path, data, keep=6, self_edges=True)
    assert list(zip(*np.nonzero(kept.mask & off))) == [(0, 1), (1, 2), (2, 0)]
    assert kept.mask.diagonal().all() and kept.threshold is None


def test_degenerate_graphs_are_refused_unless_told(data, model_path, monkeypatch):
    for value, name in ((0.01, 'empty'), (0.99, 'saturated')):
        with_posterior(monkeypatch, np.full((R, R), value))
        with pytest.raises(ValueError, match=f'graph is {name}.*--allow_degenerate'):
            export_edges.find_edges(model_path, data)
        edges = export_edges.find_edges(model_path, data, allow_degenerate=True)
        assert edges.degenerate == name


def test_foreign_data_and_types_without_meaning_are_refused(data, model_path, tmp_path):
    other = synthetic.write_dataset(tmp_path / 'other', n_run=3)
    with pytest.raises(ValueError, match='trained on other data'):
        export_edges.find_edges(model_path, other)
    with pytest.raises(ValueError, match='types 0 to 1'):
        export_edges.find_edges(model_path, data, no_edge_type=2)
    config = NriConfig(**TINY, skip_first=False)
    loaded = nri_data.load(data, 'train')
    offset, scale = nri_data.normalization(loaded)
    model = NriModel(config, loaded.node_names, offset, scale, loaded.digest)
    (tmp_path / 'plain').mkdir()
    model.save(str(tmp_path / 'plain'))
    with pytest.raises(ValueError, match='--no_edge_type'):
        export_edges.find_edges(str(tmp_path / 'plain'), data)


def test_command_writes_a_list_that_the_simulator_reads(data, model_path, tmp_path):
    """The three files agree with each other, and Algorithm 2 completes the mode block."""
    command = [
        sys.executable, '-m', 'nri.export_edges', f'--model_path={model_path}',
        f'--data_path={data}', f'--output_path={tmp_path / "out"}',
    ]  # fmt: skip
    done = subprocess.run([*command, '--keep=4'], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert '4 of 9 edges' in done.stdout and 'bits' in done.stdout
    edges = edge_lists.read(str(tmp_path / 'out' / 'edges.json'))
    mask = edge_lists.read_mask(str(tmp_path / 'out' / 'edges.npy'))
    np.testing.assert_array_equal(mask, edges.mask)
    assert (tmp_path / 'out' / 'edges.png').read_bytes()[:4] == b'\x89PNG'
    adjacency, names = export_edges.completed(edges, data)
    assert names == ('rigid_0', 'rigid_1', 'rigid_2', 'rigid_3', *edge_lists.mode_names(R))
    assert adjacency.n_edge == 4 * R + 4
    np.testing.assert_array_equal(adjacency.mask()[4:, 4:], mask)
    done = subprocess.run([*command, '--threshold=1'], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode != 0 and 'the graph is empty' in done.stderr
    assert 'Traceback' not in done.stderr


def test_list_over_rigid_nodes_gives_its_mode_block(data, tmp_path, monkeypatch):
    path = str(tmp_path / 'model')
    experiment.train(data, path, NriConfig(**TINY, nodes='modes_and_rigid'))
    found = np.full((4 + R, 4 + R), 0.8)
    found[4:, 4:] = FOUND
    with_posterior(monkeypatch, found)
    edges = export_edges.find_edges(path, data)
    assert edges.node_names[:4] == ('rigid_0', 'rigid_1', 'rigid_2', 'rigid_3')
    block = edges.mask_for(edge_lists.mode_names(R))
    assert list(zip(*np.nonzero(block))) == [(0, 1), (1, 2)]
    adjacency, _ = export_edges.completed(edges, data)
    assert adjacency.n_edge == 4 * R + 2
    export_edges.export(edges, data, str(tmp_path / 'out'))


def test_list_of_the_first_modes_is_theirs(data, tmp_path):
    """A model of two of the three modes: a list that a simulator of two modes takes."""
    path = str(tmp_path / 'model')
    experiment.train(data, path, NriConfig(**TINY, modes=2))
    edges = export_edges.find_edges(path, data, keep=1)
    assert edges.node_names == edge_lists.mode_names(2) and edges.n_edge == 1
    adjacency, names = export_edges.completed(edges, data)
    assert names[4:] == edge_lists.mode_names(2) and adjacency.n_edge == 4 * 2 + 1
    export_edges.export(edges, data, str(tmp_path / 'out'))
    edge_lists.read(str(tmp_path / 'out' / 'edges.json')).check_data(data)


def test_renumbered_nodes_have_renumbered_edges(data, model_path):
    """The encoder sees no numbers: features in another order give the same edges in that order."""
    features = nri_data.load(data, 'train').features
    order = np.array([2, 0, 1])
    straight = export_edges.edge_posterior(load_model(model_path), features, 0)
    model = load_model(model_path)
    model.offset, model.scale = model.offset[order], model.scale[order]
    renumbered = export_edges.edge_posterior(model, features[:, order], 0)
    assert np.nanstd(straight) > 1e-3
    expected = straight[:, order][:, :, order]
    np.testing.assert_allclose(renumbered, expected, atol=1e-5)  # float32: 1e-7 seen


def test_kipfs_data_have_no_body_to_complete(model_path, tmp_path):
    shutil.copytree(model_path, tmp_path / 'm')
    edges = edge_lists.EdgeList(
        mask=np.array([[0, 1], [0, 0]], bool), node_names=('node_0', 'node_1'),
        probabilities=np.full((2, 2), 0.5), method='nri', threshold=0.6, digests={},
    )  # fmt: skip
    assert export_edges.completed(edges, str(tmp_path)) is None
    assert connectivity_utils.fully_connected(2).n_edge == 4
