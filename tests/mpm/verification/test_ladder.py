"""What the report of finer and coarser grids says of runs whose limit is known."""

import json

import numpy as np
import pytest

from mpm import SOLVER_VERSION
from mpm.verification import ladder

# Cubic cells act as half of the size does.
SIZES = {'cells_0.75': 0.75, 'base': 1.0, 'cubic': 0.5, 'cells_1.5': 1.5, 'cells_2': 2.0}


def run(cell, along, across=1.0, surface=0):
    return {
        'force': [[along, 0.0, 0.0]] * 2, 'surface': [[surface] * 3] * 2, 'density': None,
        'cell_m': [cell, cell, across], 'cpu_s': 1.0,
    }  # fmt: skip


@pytest.fixture
def path(tmp_path):
    """Drafts of 100 N (1 + h^p), a bucket whose force grows with the cells across."""
    cases = {
        name: {of: run(h, 100.0 * (1.0 + h**power)) for of, h in SIZES.items()}
        for name, power in (('excavation:186', 1.5), ('excavation:22', 1.0), ('wheel:122', 2.0))
    }
    of_bucket = zip(ladder.ACROSS, (20.0, 10.0, 6.7, 3.3), strict=True)
    cases |= {
        name: {of: run(1.0, 50.0 + mm, 1e-3 * mm, mm) for of, mm in of_bucket}
        for name in ladder.BUCKET
    }
    file = tmp_path / 'ladder.json'
    file.write_text(json.dumps({'solver_version': SOLVER_VERSION, 'cases': cases}))
    return str(file)


def test_order_and_limit_are_those_of_the_law():
    cells = np.array([0.75, 1.0, 1.5, 2.0])
    for power in (0.7, 1.5, 2.5):
        assert ladder.order_of(cells, 3.0 + 2.0 * cells**power) == pytest.approx(power, abs=0.026)
    value, error = ladder.limit(cells, 3.0 + 2.0 * cells**1.5)
    assert value == pytest.approx(3.0) and 0.5 < error < 2.0


def test_tables_tell_how_far_the_truth_is_from_finer_grids(path):
    # 200 N on the cells of record; 100 N (1 + 0.75^1.5) = 165 N on smaller ones, 100 N in the end.
    row = next(line for line in ladder.limits(path).splitlines() if 'excavation:186' in line)
    assert row.split(' | ')[2:5] == ['200', '+21%', '1.5'] and row.endswith('| +100% |')
    # Of order 1: 200 N for 175 N. The bucket has one size in the plane and no limit.
    text = ladder.in_short(path)
    assert "a blade's force differs by 14 to 21 %, a wheel's drawbar by 28 to 28 %" in text
    assert 'tools' not in ladder.limits(path) and 'blade, base | 2 |' in ladder.summary(path)
    # 200 N for the 125 N of cubic cells.
    over_cubic = 'wheel, base | 1 | +60.0% (+60.0%) | +0.0% (+0.0%) | 0.600 (0.600) |'
    assert over_cubic in ladder.summary(path)
    first = ladder.side_plates(path).splitlines()[2]
    assert first == f'| 20 | 70 | 0 | {16.7 / 53.3:.3f} | 0.17 |'
