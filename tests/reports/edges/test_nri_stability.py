"""How far seeds of NRI agree: against hand counts, in miniature, and as it is shipped."""

import pathlib

import numpy as np
import pytest

from learning_to_simulate.subspace import edge_lists
from nri import data as nri_data
from nri import training
from nri.config import NriConfig
from nri.model import load_model
from pca_tools import files
from reports.edges import nri_stability
from tests.nri import small
from tests.pca_tools.commands import call_command


def row(matrix, seed=0):
    matrix = np.array(matrix, float)
    np.fill_diagonal(matrix, np.nan)
    rows = [[None if np.isnan(x) else x for x in r] for r in matrix.tolist()]
    names = list(edge_lists.mode_names(len(matrix)))
    return {'seed': seed, 'node_names': names, 'probabilities': rows}


def test_comparison_of_seeds_against_hand_counts():
    """Edges {01, 02} and {01, 12} of 6 pairs: one in both, three in either, four said alike."""
    a, b = np.zeros((3, 3)), np.zeros((3, 3))
    a[0, 1] = a[0, 2] = b[0, 1] = b[1, 2] = 1.0
    result = nri_stability.compare([row(a), row(b), row(a)])
    third = result['jaccard']
    assert third['min'] == pytest.approx(1 / 3) and third['max'] == 1.0
    assert third['mean'] == pytest.approx((1 / 3 + 1 + 1 / 3) / 3)
    assert result['agreement']['min'] == pytest.approx(4 / 6)
    assert (result['in_all_seeds'], result['in_any_seed']) == (1, 3)
    # Two unrelated graphs of density 1/3: (1/9) / (5/9) and 1/9 + 4/9.
    assert result['jaccard_by_chance'] == pytest.approx(1 / 5)
    assert result['agreement_by_chance'] == pytest.approx(5 / 9)
    empty = nri_stability.compare([row(np.zeros((3, 3)))] * 2)
    assert empty['jaccard'] is None and empty['correlation'] is None


def test_the_row_of_a_seed_is_what_its_model_says(tmp_path, monkeypatch):
    """The training itself is tested where it lies; here it leaves an untrained model."""
    data = small.write_springs(tmp_path / 'data')
    held = nri_data.load(data, 'train')
    config = NriConfig(**small.TINY, seed=1)

    def train(data_path, model_path, given):
        assert (data_path, given) == (data, config)
        small.model(held, seed=1).save(model_path)
        files.write_json(f'{model_path}/history.json', [{'loss': 2.0}, {'loss': 1.5}])
        return {'test': {'status': 'OK', 'loss': 1.75}, 'seconds': 3.0}

    monkeypatch.setattr(training, 'train', train)
    row = nri_stability.train_seed(data, str(tmp_path / 'seed_1'), config)
    assert (row['valid_losses'], row['test_loss'], row['status']) == ([2.0, 1.5], 1.75, 'OK')
    found = nri_stability.matrices([row])[0]
    edges = load_model(str(tmp_path / 'seed_1')).edge_probabilities(held.features)[..., 1]
    np.testing.assert_allclose(found[~np.eye(3, dtype=bool)], edges.mean(axis=0), atol=1e-5)
    assert row['edges'] == np.count_nonzero(edges.mean(axis=0) > 0.6)
    assert nri_stability.compare([row, row])['agreement']['mean'] == 1.0
    nri_stability.draw(str(tmp_path / 'a.png'), {'seeds': [row, row]})
    assert (tmp_path / 'a.png').stat().st_size > 1000


def test_settings_are_those_of_the_config(tmp_path):
    paths = [f'--{name}_path={tmp_path}/{name}' for name in ('data', 'work', 'output')]
    for item, words in (
        ('width=3', 'names are skip_first, symmetric'),
        ('window=2', 'a segment of'),
    ):
        done = call_command('reports', 'nri_stability', *paths, f'--set={item}')
        assert done.returncode == 1 and words in done.stderr
    assert not list(tmp_path.iterdir())


def test_shipped_list_is_that_of_the_seed_with_the_least_loss():
    """It is stored beside the posterior of all seeds, from which it follows."""
    folder = pathlib.Path(__file__).resolve().parents[3] / 'docs' / 'edges'
    held = files.read_json(str(folder / 'excavation_v2_nri.json'))
    best = min(held['seeds'], key=lambda seed: min(seed['valid_losses']))
    edges = edge_lists.read(str(folder / 'excavation_v2_nri' / 'edges.json'))
    probabilities = nri_stability.matrices([best])[0]
    np.testing.assert_array_equal(edges.probabilities, probabilities)
    np.testing.assert_array_equal(edges.mask, np.nan_to_num(probabilities) > edges.threshold)
    assert edges.digests['model'] == best['weights'] and edges.n_edge == best['edges']
