"""Statistics of the protocol against numbers worked out by hand."""

import math

import pytest

from reports.protocol import over_runs
from tests.reports.protocol import known


@pytest.mark.parametrize(
    'errors, others, median, mean, worst, wins, ratio',
    [
        ([1.0, 4.0, 10.0], [2.0, 2.0, 40.0], 4.0, 5.0, 10.0, 2, 0.25 ** (1 / 3)),
        # A tie is no win, and one huge run does not decide.
        ([1.0, 1.0, 100.0], [1.0, 10.0, 1000.0], 1.0, 34.0, 100.0, 2, 0.01 ** (1 / 3)),
        # A failed run loses and leaves no mean.
        ([1.0, math.nan, 3.0], [2.0, 2.0, 2.0], 3.0, None, None, 1, None),
    ],
)
def test_figures_of_one_seed(errors, others, median, mean, worst, wins, ratio):
    found = over_runs.figures(errors, {'b': others})
    assert (found['runs'], found['failed']) == (3, sum(map(math.isnan, errors)))
    assert (found['median'], found['mean'], found['worst']) == (median, mean, worst)
    assert found['wins'] == {'b': wins} and found['ratio'] == {'b': pytest.approx(ratio)}


def test_seeds_have_mean_and_range_and_valid_chooses_the_median():
    found = over_runs.over_seeds([3.0, 1.0, 2.0])
    assert found == {'mean': 2.0, 'low': 1.0, 'high': 3.0, 'seeds': [3.0, 1.0, 2.0]}
    assert over_runs.over_seeds([1.0, None]) is None
    errors = [[3.0, 3.0], [1.0, 1.0], [2.0, 9.0], [4.0, None]]
    seeds = [{'runs': {'valid': [{'soil_mm': e} for e in row]}} for row in errors]
    # Means 3, 1, 5.5, failed: the lower median of four is 3.
    assert over_runs.median_seed(seeds) == 0 == over_runs.median_seed(seeds[1:3])
    force = [{'runs': {'valid': [{'force_l2': e}]}} for e in (0.5, 0.1, 0.3)]
    assert over_runs.median_seed(force) == 2


def test_quiet_runs_are_apart_and_kinds_have_figures_of_their_own():
    """The field's soil is 2 and 4 (seed 0), 6 and 12 (seed 1); the ridge failed on the first."""
    summary = over_runs.summarise(known.document(7, 1.0))['test']
    assert set(summary) == {'all', *known.KINDS} and 'soil_mm' not in summary['stops']
    row = summary['all']['soil_mm']['field']
    assert row['runs'] == 2 and row['mean']['seeds'] == [3.0, 9.0]
    assert row['wins']['path ridge']['seeds'] == [1, 1] and row['ratio']['path ridge'] is None
    assert summary['all']['force_l2']['field']['runs'] == 3
    ratio = summary['lift']['soil_mm']['field']['ratio']['path ridge']
    assert ratio['seeds'] == pytest.approx([1.0, 3.0])


def test_a_baseline_of_several_seeds_stands_as_its_median_on_valid():
    document = known.document(7, 1.0)
    for method in document['methods']:
        method['baseline'] = not method['baseline']
    summary = over_runs.summarise(document)['test']['all']['force_l2']
    # The lower median of two: seed 0, whose soil is 35 in the mean, not 105.
    assert summary['path ridge']['ratio']['field']['mean'] == pytest.approx(1.0)


def test_means_are_of_the_runs_of_a_kind_and_seed():
    found = over_runs.condense(known.document(7, 1.0))
    assert found['grid'] == {
        'runs': 1,
        'soil_mm': {'field': [2.0, 6.0]},
        'force_l2': {'field': [0.1, pytest.approx(0.3)], 'path ridge': [0.1]},
    }
    driven = found['driven']
    assert driven['runs'] == 2 and driven['soil_mm'] == {'field': [4.0, 12.0], 'path ridge': [4.0]}
    assert driven['force_l2']['path ridge'] == [pytest.approx(0.3)]
