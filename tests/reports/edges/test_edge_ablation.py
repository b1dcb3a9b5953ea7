"""Lists of edges that are compared, and how the protocol is asked to compare them."""

from types import SimpleNamespace

import numpy as np
import pytest

from learning_to_simulate.subspace import edge_lists
from reports.edges import edge_ablation
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


def test_every_row_is_trained_from_every_seed_on_its_list(tmp_path, monkeypatch):
    jobs, methods = [], {}
    monkeypatch.setattr(edge_ablation.judge, 'make_all', lambda made, _: jobs.extend(made))
    monkeypatch.setattr(edge_ablation.report, 'write', lambda made, _: methods.update(made))
    values = SimpleNamespace(
        data_path=synthetic.write_dataset(tmp_path / 'data'), work_path=str(tmp_path), nri_path='',
        modes=0, keep=4, num_seeds=2, num_processes=1,
    )  # fmt: skip
    edge_ablation.main(values)
    assert {'gates', 'none', 'random', 'correlation'} <= methods.keys()
    configs = {path: config for _, path, config, _ in jobs}
    for name, (first, second) in methods.items():
        one, other = configs[first], configs[second]
        assert (one.preset, one.seed, other.seed) == ('pcg', 0, 1)
        assert (one.adjacency != other.adjacency) == (name == 'random')
        if name not in edge_ablation.NO_LIST:
            edge_lists.read(one.adjacency).check_data(values.data_path)
