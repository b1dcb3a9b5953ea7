"""Lists of edges that are compared, and how the protocol is asked to compare them."""

import contextlib
import json
import os
from types import SimpleNamespace

import numpy as np
import pytest

from learning_to_simulate.subspace import edge_lists
from pca_tools import workers
from reports.edges import edge_ablation
from reports.protocol import rollouts
from tests.learning_to_simulate import synthetic

R = synthetic.N_MODES


def nri_rows(rng, seeds=1):
    p = rng.random((R, R)).tolist()
    for k in range(R):
        p[k][k] = None
    names = list(edge_lists.mode_names(R))
    return [{'seed': s, 'node_names': names, 'probabilities': p} for s in range(seeds)]


def test_lists_of_a_number_have_that_number_and_no_self_edges():
    rng = np.random.default_rng(0)
    velocities, rows = rng.normal(size=(2, 30, R, 3)), nri_rows(rng, seeds=2)
    first, second = (edge_ablation.masks_of(velocities, 4, s, rows) for s in (0, 1))
    masks = {name: mask for name, (mask, *_) in first.items()}
    for name in ('random', 'NRI', 'correlation'):
        assert masks[name].sum() == 4 and not masks[name].diagonal().any()
    assert not np.array_equal(masks['random'], second['random'][0])
    np.testing.assert_array_equal(masks['correlation'], second['correlation'][0])
    assert masks['all'].all() and not masks['none'].any() and masks['self'].sum() == R
    assert masks['correlation_and_self'].sum() == 4 + R
    assert 'NRI' not in edge_ablation.masks_of(velocities, 4, 0)
    with pytest.raises(ValueError, match=f'no training over {R} modes from seed 2'):
        edge_ablation.masks_of(velocities, 4, 2, rows)


def test_the_protocol_is_given_a_list_for_every_row_and_seed(tmp_path, monkeypatch):
    data, work = synthetic.write_dataset(tmp_path / 'data'), tmp_path / 'work'
    nri = tmp_path / 'nri.json'
    digests = edge_lists.data_digests(data)
    rows = nri_rows(np.random.default_rng(0), seeds=2)
    nri.write_text(json.dumps({'digests': digests, 'seeds': rows}))
    started = []
    monkeypatch.setattr(os, 'execv', lambda program, arguments: started.append(arguments))
    jobs = []
    monkeypatch.setattr(rollouts, 'make', jobs.append)
    here = SimpleNamespace(run=lambda f, given: [SimpleNamespace(error=f(x)) for x in given])
    monkeypatch.setattr(workers, 'start', lambda *_: contextlib.nullcontext(here))

    class Flags:
        data_path, work_path, nri_path, output_path = data, str(work), str(nri), 'out'
        preset, modes, variants, num_seeds, keep, num_processes = 'pcg', 0, None, 2, 4, 1

    edge_ablation.main(Flags, [])
    judged = [a.removeprefix('--model=') for a in started[0] if a.startswith('--model=')]
    lists = ['none', 'self', 'all', 'correlation', 'correlation_and_self', 'random', 'NRI']
    assert [row.partition('=')[0] for row in judged] == ['fully_connected', 'gates', *lists]
    models = [path for row in judged for path in row.partition('=')[2].split(',')]
    assert models == [path for _, path, *_ in jobs] and len(set(models)) == 2 * len(judged)
    given = [next(f for f in flags if 'adjacency' in f) for _, _, flags, *_ in jobs[4:]]
    ends = [f'{name}_{seed * (name in ("random", "NRI"))}' for name in lists for seed in (0, 1)]
    assert given == [f'--adjacency={work}/lists/{end}.json' for end in ends]
    for seed in range(2):
        held = edge_lists.read(str(work / 'lists' / f'NRI_{seed}.json'))
        held.check_data(data)
        assert held.method == 'nri' and held.n_edge == 4
    assert edge_lists.read(str(work / 'lists' / 'none_0.json')).degenerate == 'empty'
    Flags.variants = ['none', 'other']
    with pytest.raises(ValueError, match="unknown variants ['other']".replace('[', r'\[')):
        edge_ablation.main(Flags, [])
    nri.write_text(json.dumps({'digests': {}, 'seeds': rows}))
    with pytest.raises(ValueError, match='another dataset'):
        edge_ablation.main(Flags, [])
