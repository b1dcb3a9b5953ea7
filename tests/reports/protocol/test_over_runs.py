"""Statistics of the protocol against numbers worked out by hand."""

import math

import pytest

from reports.protocol import over_runs


def document(soil, motion=(10.0, 10.0, 0.2), kinds=('grid', 'lift', 'grid')):
    """One split named test and valid alike; `soil`: method -> (is a baseline, errors per seed)."""
    runs = [
        {'record': i, 'case': i, 'kind': k, 'motion_mm': m, 'truncation_mm': 1.0}
        for i, (k, m) in enumerate(zip(kinds, motion, strict=True))
    ]
    methods = []
    for name, (baseline, seeds) in soil.items():
        rows = [[{'soil_mm': e} for e in errors] for errors in seeds]
        methods.append(
            {
                'name': name,
                'baseline': baseline,
                'seeds': [{'seed': i, 'runs': {'valid': r, 'test': r}} for i, r in enumerate(rows)],
            }
        )
    return {'runs': {'valid': runs, 'test': runs}, 'methods': methods}


def test_figures_of_one_seed():
    found = over_runs.figures([1.0, 4.0, 10.0], {'still': [2.0, 2.0, 40.0]})
    assert (found['runs'], found['failed']) == (3, 0)
    assert (found['median'], found['mean'], found['worst']) == (4.0, 5.0, 10.0)
    assert found['wins'] == {'still': 2}
    # Ratios 1/2, 2, 1/4.
    assert found['ratio']['still'] == pytest.approx(0.25 ** (1 / 3))


def test_a_tie_is_no_win_and_one_huge_run_does_not_decide():
    found = over_runs.figures([1.0, 1.0, 100.0], {'b': [1.0, 10.0, 1000.0]})
    assert found['wins']['b'] == 2
    assert found['ratio']['b'] == pytest.approx((1 * 0.1 * 0.1) ** (1 / 3))


def test_a_failed_run_loses_and_leaves_no_mean():
    found = over_runs.figures([1.0, math.nan, 3.0], {'b': [2.0, 2.0, 2.0]})
    assert (found['failed'], found['mean'], found['worst']) == (1, None, None)
    assert found['median'] == 3.0
    assert found['wins']['b'] == 1
    assert found['ratio']['b'] is None


def test_seeds_have_mean_and_range():
    found = over_runs.over_seeds([3.0, 1.0, 2.0])
    assert found == {'mean': 2.0, 'low': 1.0, 'high': 3.0, 'seeds': [3.0, 1.0, 2.0]}
    assert over_runs.over_seeds([1.0, None]) is None


def test_valid_chooses_the_median_seed():
    errors = [[3.0, 3.0], [1.0, 1.0], [2.0, 9.0], [4.0, None]]
    seeds = [{'runs': {'valid': [{'soil_mm': e} for e in row]}} for row in errors]
    # Means 3, 1, 5.5, failed: the lower median of four is 3.
    assert over_runs.median_seed(seeds) == 0
    assert over_runs.median_seed(seeds[1:3]) == 0
    force = [{'runs': {'valid': [{'force_l2': e}]}} for e in (0.5, 0.1, 0.3)]
    assert over_runs.median_seed(force) == 2


def test_quiet_runs_are_apart_and_kinds_have_figures_of_their_own():
    summary = over_runs.summarise(
        document({'still': (True, [[8.0, 6.0, 0.1]]), 'model': (False, [[4.0, 12.0, 5.0]])})
    )['test']
    assert set(summary) == {'all', 'grid', 'lift'}
    row = summary['all']['soil_mm']['model']
    assert row['runs'] == 2
    assert row['mean']['mean'] == 8.0 and row['wins']['still']['mean'] == 1
    assert row['ratio']['still']['mean'] == pytest.approx(1.0)
    assert summary['grid']['soil_mm']['model']['runs'] == 1
    assert summary['lift']['soil_mm']['model']['ratio']['still']['mean'] == pytest.approx(2.0)


def test_several_seeds_of_a_method_and_of_a_baseline():
    """A baseline stands as its median seed on valid: here the one of means 4.5."""
    summary = over_runs.summarise(
        document(
            {
                'ridge': (True, [[4.0, 5.0, 1.0], [1.0, 1.0, 1.0], [9.0, 9.0, 1.0]]),
                'model': (False, [[4.5, 4.5, 1.0], [2.0, 2.0, 1.0]]),
            }
        )
    )['test']['all']['soil_mm']
    wins = summary['model']['wins']['ridge']
    assert wins['seeds'] == [1, 2] and (wins['low'], wins['high']) == (1, 2)
    assert summary['model']['median'] == over_runs.over_seeds([4.5, 2.0])
