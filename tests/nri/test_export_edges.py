"""Export of what an NRI model found, with tiny models and with posteriors made by hand."""

import numpy as np
import pytest

from learning_to_simulate.subspace import edge_lists
from nri import data as nri_data
from nri import export_edges
from nri.model import NriModel
from tests.learning_to_simulate import synthetic
from tests.nri import small
from tests.pca_tools.commands import call_command

R = synthetic.N_MODES
TINY = {'hidden': 4, 'window': 8, 'segment': 3}


@pytest.fixture(scope='module')
def data(tmp_path_factory):
    return synthetic.write_dataset(tmp_path_factory.mktemp('data'))


def write_model(path, data, **settings):
    """An untrained model of a dataset, whose layers know its range."""
    held = nri_data.load(data, 'train', settings.get('nodes', 'modes'), settings.get('modes', 0))
    model = small.model(held, **TINY, **settings)
    model.encode(model.normalized(held.features[:, :, : TINY['window']]), is_training=True)
    model.save(path)
    return path


@pytest.fixture(scope='module')
def model_path(data, tmp_path_factory):
    """Not to be changed."""
    return write_model(str(tmp_path_factory.mktemp('nri')), data)


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
    kept = export_edges.find_edges(model_path, data, keep=3)
    assert list(zip(*np.nonzero(kept.mask))) == [(0, 1), (1, 2), (2, 0)]
    assert kept.threshold is None


def test_graphs_without_a_meaning_are_refused(data, model_path, tmp_path, monkeypatch):
    other = synthetic.write_dataset(tmp_path / 'other', n_run=3)
    with pytest.raises(ValueError, match='trained on other data'):
        export_edges.find_edges(model_path, other)
    plain = write_model(str(tmp_path / 'plain'), data, skip_first=False)
    with pytest.raises(ValueError, match='without skip_first'):
        export_edges.find_edges(plain, data)
    for value, name in ((0.01, 'empty'), (0.99, 'saturated')):
        with_posterior(monkeypatch, np.full((R, R), value))
        with pytest.raises(ValueError, match=f'graph is {name}.*--allow_degenerate'):
            export_edges.find_edges(model_path, data)
        edges = export_edges.find_edges(model_path, data, allow_degenerate=True)
        assert edges.degenerate == name


def test_command_writes_a_list_that_the_simulator_reads(data, model_path, tmp_path):
    command = [
        'nri.export_edges', f'--model_path={model_path}', f'--data_path={data}',
        f'--output_path={tmp_path / "out"}',
    ]  # fmt: skip
    done = call_command(*command, '--keep=4')
    assert done.returncode == 0, done.stderr
    assert '4 of 6 edges' in done.stdout and 'bits' in done.stdout
    edges = edge_lists.read(str(tmp_path / 'out' / 'edges.json'))
    assert edges.n_edge == 4
    assert (tmp_path / 'out' / 'edges.png').read_bytes()[:4] == b'\x89PNG'


@pytest.mark.parametrize(
    'settings, n_node, n_mode', [({'nodes': 'modes_and_rigid'}, 4 + R, R), ({'modes': 2}, 2, 2)]
)
def test_lists_over_other_nodes_give_the_block_of_their_modes(
    data, tmp_path, monkeypatch, settings, n_node, n_mode
):
    path = write_model(str(tmp_path / 'model'), data, **settings)
    found = np.full((n_node, n_node), 0.8)
    found[-n_mode:, -n_mode:] = FOUND[:n_mode, :n_mode]
    with_posterior(monkeypatch, found)
    edges = export_edges.find_edges(path, data)
    modes = edge_lists.mode_names(n_mode)
    assert edges.node_names[-n_mode:] == modes
    block = edges.mask_for(modes)
    assert list(zip(*np.nonzero(block))) == [(0, 1), (1, 2)][: n_mode - 1]
    export_edges.export(edges, str(tmp_path / 'out'))
    edge_lists.read(str(tmp_path / 'out' / 'edges.json')).check_data(data)
