"""The curve of an error over training runs: its exponent in closed form, and its table."""

import json

import pytest

from reports import learning_curve


def test_the_runs_that_a_power_law_needs():
    runs = [25, 50, 100]
    errors = [0.4 * n**-0.5 for n in runs]
    assert learning_curve.exponent(runs, errors) == pytest.approx(0.5)
    assert learning_curve.runs_for(0.02, runs, errors) == pytest.approx(400.0)
    assert learning_curve.exponent(runs, [0.3, 0.2, 0.25]) == 0.0
    assert learning_curve.runs_for(0.1, runs, [0.3, 0.2, 0.2]) is None


def test_the_table_has_means_over_seeds(tmp_path):
    found = [
        {'every': every, 'runs': n, 'seed': s, 'force': 2.0 / n + 0.01 * s, 'drawbar_median': 0.3}
        for every, n in ((4, 2), (2, 5), (1, 10))
        for s in (0, 2)
    ]
    path = tmp_path / 'curve.json'
    path.write_text(json.dumps({'curves': {'wheel': found}}))
    lines = learning_curve.table(str(path)).splitlines()
    assert lines[3] == '| wheel, 5 training runs | 0.41 | 0.3 |'
    assert lines[4] == '| wheel, 10 training runs | 0.21 | 0.3 |'
    needed = 10 * (0.21 / 0.12) ** (0.6931 / 0.669)
    assert lines[5] == f'| wheel, runs for 0.12 | {needed:.0f} |  |'
