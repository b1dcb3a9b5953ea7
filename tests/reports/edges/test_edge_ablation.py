"""The comparison of edge lists in miniature, and its report from the JSON alone."""

import json
import pathlib
import types

import numpy as np
import pytest

from learning_to_simulate import presets
from learning_to_simulate.subspace import edge_lists
from reports.edges import edge_ablation, edge_ablation_report
from tests.learning_to_simulate import synthetic

R = synthetic.N_MODES
SMALL = {'latent_size': 8, 'num_steps': 6, 'unroll_steps': 0, 'gate_weight': 0.5, 'gate_steps': 4}


def nri_rows(rng, seeds=1):
    p = rng.random((R, R)).tolist()
    for k in range(R):
        p[k][k] = None
    names = list(edge_lists.mode_names(R))
    return [{'seed': s, 'node_names': names, 'probabilities': p} for s in range(seeds)]


def test_lists_of_a_number_have_that_number_and_no_self_edges():
    rng = np.random.default_rng(0)
    lists = edge_ablation.edge_lists_of(rng.normal(size=(2, 30, R, 3)), 4, 0, nri_rows(rng))
    masks = {name: mask for name, (mask, _) in lists.items()}
    listed = {
        k: m for k, m in masks.items() if k.startswith(('random', 'NRI')) or k == 'correlation'
    }
    assert len(listed) == edge_ablation.RANDOM_DRAWS + 2
    for mask in listed.values():
        assert mask.sum() == 4 and not mask.diagonal().any()
    draws = {m.tobytes() for k, m in listed.items() if k.startswith('random')}
    assert len(draws) > 1
    assert masks['all modes'].all() and not masks['none'].any()
    assert masks['correlation and self-edges'].sum() == 4 + R
    later = edge_ablation.edge_lists_of(rng.normal(size=(2, 30, R, 3)), 4, 1, None)
    assert not any(name.startswith(('random', 'NRI')) for name in later)
    with pytest.raises(ValueError, match='no training over 3 modes from seed 1'):
        edge_ablation.edge_lists_of(rng.normal(size=(2, 30, R, 3)), 4, 1, nri_rows(rng))


def test_rows_do_not_depend_on_the_rows_before(tmp_path):
    """A list after others gives the bits that it gives alone, and those of the pruned graph."""
    folder = synthetic.write_dataset(tmp_path / 'data')
    config = presets.make_config('pcg', **SMALL)
    mask = np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0]], bool)
    bench = edge_ablation.Bench(folder, config)
    first, learned, again = bench.train(mask), bench.train(None), bench.train(mask)
    assert first['valid'] == again['valid'] and first['test'] == again['test']
    assert (first['edges'], first['mode_edges'], first['self_edges']) == (4 * R + 2, 2, 0)
    assert 0 <= learned['mode_edges'] <= R * R
    np.save(tmp_path / 'mask.npy', mask)
    plain = presets.make_config(
        'pcg', **SMALL | {'gate_weight': 0.0, 'adjacency': str(tmp_path / 'mask.npy')}
    )
    pruned = edge_ablation.Bench(folder, plain).train(None)
    for split in ('valid', 'test'):  # float32 sums in another order, six steps of Adam: 1e-5 seen
        for name, value in pruned[split].items():
            assert first[split][name] == pytest.approx(value, rel=1e-3), name


def test_whole_comparison_resumes_and_reports(tmp_path, monkeypatch):
    folder = synthetic.write_dataset(tmp_path / 'data', n_run=2)
    trained = []

    def train(self, mask, scores=None, progress=iter):
        trained.append(mask)
        if len(trained) == 5:
            raise KeyboardInterrupt
        mask = np.eye(R, dtype=bool) if mask is None else mask
        errors = {'soil_mse': 1e-6, 'of_best_trivial': 0.1, 'force_relative_l2': 0.2}
        counts = {'edges': 17, 'mode_edges': int(mask.sum()), 'self_edges': 0, 'cpu_seconds': 1.0}
        return counts | {
            'mask': mask.astype(int).tolist(),
            'scores': None if scores is None else np.nan_to_num(scores).tolist(),
            'valid': errors,
            'test': errors,
        }

    monkeypatch.setattr(edge_ablation.Bench, 'train', train)
    monkeypatch.setattr(
        edge_ablation, 'time_steps',
        lambda data, masks, rounds: {m: {'ms_median': 0.5, 'edges': 1} for m in masks},
    )  # fmt: skip
    nri = tmp_path / 'nri.json'
    digests = edge_lists.data_digests(folder)
    rows = nri_rows(np.random.default_rng(0), seeds=2)
    nri.write_text(json.dumps({'digests': digests, 'seeds': rows}))
    out = str(tmp_path / 'out.json')
    v = types.SimpleNamespace(
        data_path=folder, nri_path=str(nri), output_path=out, seeds=2, keep=4, gate_weight=1.0,
        gate_steps=3, num_steps=6, unroll_steps=0, unroll_length=3, unroll_batch_size=2, rounds=1,
        variants=None, num_threads=1,
    )  # fmt: skip
    with pytest.raises(KeyboardInterrupt):
        edge_ablation.run(v)
    assert len(json.loads(pathlib.Path(out).read_text())['rows']) == 4
    result = edge_ablation.run(v)
    assert len(result['rows']) == 2 * 8 + edge_ablation.RANDOM_DRAWS
    assert len(trained) == 1 + len(result['rows'])
    text = edge_ablation_report.write(result, str(tmp_path / 'out'))
    assert text == (tmp_path / 'out.md').read_text().strip()
    assert [line.split('|')[1].strip() for line in text.splitlines()[4:]] == list(
        edge_ablation_report.ORDER
    )
    assert (tmp_path / 'out.png').stat().st_size > 1000
    edges = edge_ablation_report.edges_of(result, 'NRI')
    edge_lists.write(str(tmp_path / 'edges.json'), edges)
    edge_lists.read(str(tmp_path / 'edges.json')).check_data(folder)
    assert edges.method == 'nri' and edges.n_edge == 4
    assert edge_ablation_report.edges_of(result, 'none').degenerate == 'empty'
    with pytest.raises(ValueError, match="no list of 'random 1'"):
        edge_ablation_report.edges_of(result, 'random 1')
    v.output_path, v.variants = str(tmp_path / 'two.json'), ['none', 'NRI']
    assert len(edge_ablation.run(v)['rows']) == 2 * 2
    v.output_path, v.num_steps = out, 7
    with pytest.raises(ValueError, match='another budget'):
        edge_ablation.run(v)
    nri.write_text(json.dumps({'digests': {}, 'seeds': rows}))
    with pytest.raises(ValueError, match='another dataset'):
        edge_ablation.run(v)


def test_report_of_another_json_is_refused(tmp_path):
    for values in ({}, [], {'rows': [{}], 'budget': {}}):
        with pytest.raises(ValueError, match='not the result'):
            edge_ablation_report.write(values, str(tmp_path / 'a'))


def test_times_are_of_the_graphs_without_the_edges(tmp_path):
    folder = synthetic.write_dataset(tmp_path)
    masks = {'none': np.zeros((R, R)).tolist(), 'fully connected': None}
    timing = edge_ablation.time_steps(folder, masks, rounds=2)
    assert [timing[name]['edges'] for name in masks] == [4 * R, (4 + R) ** 2]
    assert all(0 < t['ms_min'] <= t['ms_median'] <= t['ms_p95'] for t in timing.values())


def test_lists_show_their_pairs_and_what_they_share(tmp_path):
    names, none = edge_lists.mode_names(3), np.full((3, 3), np.nan)
    paths = []
    for number, pairs in enumerate(([(0, 1), (2, 2)], [(0, 1), (1, 0)])):
        mask = np.zeros((3, 3), bool)
        for receiver, sender in pairs:
            mask[receiver, sender] = True
        paths.append(str(tmp_path / f'seed_{number}.json'))
        edge_lists.write(paths[-1], edge_lists.EdgeList(mask, names, none, 'gates', None, {}))
    rows = edge_ablation_report.lists(*paths).splitlines()[2:]
    # One pair of three is in both: from mode 2, as texts count, to mode 1.
    assert rows == [
        '| seed 0 | 1 | 1 | 2 to 1, 3 to 3 | 0.333 |',
        '| seed 1 | 2 | 0 | 2 to 1, 1 to 2 | 0.333 |',
    ]
