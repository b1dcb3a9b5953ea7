"""Means over runs of constant speed, and over runs that are driven freely."""

import pytest

from reports.protocol import driven_runs
from tests.reports.protocol.known import document


def test_means_are_of_the_runs_of_a_kind_and_seed():
    found = driven_runs.condense(document(7, 1.0))
    assert found['grid'] == {
        'runs': 1,
        'soil_mm': {'field': [2.0, 6.0]},
        'force_l2': {'field': [0.1, pytest.approx(0.3)], 'path ridge': [0.1]},
    }
    driven = found['driven']
    assert driven['runs'] == 2 and driven['soil_mm'] == {'field': [4.0, 12.0], 'path ridge': [4.0]}
    assert driven['force_l2']['path ridge'] == [pytest.approx(0.3)]
