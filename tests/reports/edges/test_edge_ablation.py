"""Lists of edges that are compared, and how the protocol is asked to compare them."""

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
