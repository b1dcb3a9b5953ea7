"""Tables of a document whose figures are known."""

import json

import pytest

from reports.protocol import tables
from tests.reports.protocol.known import document


@pytest.fixture
def path(tmp_path):
    (tmp_path / 'known.json').write_text(json.dumps(document()))
    return str(tmp_path / 'known.json')


def rows(table):
    lines = [line.strip('|').split('|') for line in table.splitlines()]
    return {line[0].strip(): [cell.strip() for cell in line[1:]] for line in lines}


def test_methods_stand_on_the_runs_that_all_know_beside_the_truth(path):
    found = rows(tables.methods(path))
    header = found['method']
    soil, force = header.index('soil, mm'), header.index('force, rel. L2')
    assert found['soil field (2 trainings, 1 refused)'][soil] == 'median 1.5'
    assert found['mlp_driven'][soil] == '2.5' and found['mlp_driven'][force] == '1'
    own = found["*truth's own error* (2 cases)"]
    assert own[force] == '0.2' and own[header.index('drawbar, rel. L2 (median)')] == '0.6'
    assert own[header.index('surface near the tool, mm')] == 'over 2' and own[soil] == ''


def test_bounds_count_the_runs_that_keep_them(path):
    (row,) = (r for name, r in rows(tables.bounds(path)).items() if name.startswith('blade'))
    assert row == ['50', '66.7', '25', '3']
