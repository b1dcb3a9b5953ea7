"""The truth's own errors, from a ladder whose figures are known."""

import json

import numpy as np
import pytest

from reports.protocol import truth


def variant(cell, draft, surface=0):
    return {
        'force': [[draft, 0.0, 0.0]] * 3, 'surface': [[surface, surface]] * 2, 'cell_m': [cell] * 3
    }  # fmt: skip


def test_errors_are_against_cubic_cells_and_the_limit_of_fine_ones(tmp_path):
    # A draft of 100 N that grows with the 1.5th power of the cell.
    of = {cell: 100.0 * (1.0 + cell**1.5) for cell in (1.0, 1.5, 2.0)}
    runs = {
        'base': variant(1.0, of[1.0], 300),
        'cubic': variant(1.0, 160.0),
        'cells_1.5': variant(1.5, of[1.5]),
        'cells_2': variant(2.0, of[2.0]),
    }
    path = tmp_path / 'ladder.json'
    path.write_text(json.dumps({'cases': {'excavation:22': runs, 'wheel:122': {}}}))
    found = truth.errors('blade', str(path))
    assert found['cases'] == ['excavation:22'] and found['surface_mm'] == [3.0]
    assert found['force_relative_l2'] == [0.25]  # 200 N where cubic cells have 160
    np.testing.assert_allclose(found['drawbar_relative_l2'], [1.0], rtol=1e-3)
    with pytest.raises(KeyError):
        truth.errors('spoon', str(path))
