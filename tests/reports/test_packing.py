"""Runs with another packing beside those of the record."""

import json

import numpy as np
import pytest

from learning_to_simulate.soil_field import runs as runs_lib
from reports import packing


@pytest.fixture(scope='module')
def brief():
    return next(r for r in runs_lib.read('datasets/wheel_more', 'test') if r.kind == 'brief')


def test_a_run_beside_itself_and_beside_one_of_twice_the_load(brief):
    (row,) = packing.judged('wheel', [brief])
    assert row['case'] == brief.case and row['usual'] == row['other']
    assert set(row['packings'].values()) == {0.0} and 0 < row['usual']['force_relative_l2'] < 1
    twice = brief._replace(force=2 * brief.force, heights=brief.heights + 1e-3)
    (row,) = packing.judged('wheel', [twice])
    apart = row['packings']
    assert apart['force_relative_l2'] == apart['drawbar_relative_l2'] == 1.0
    assert apart['near_mm'] == pytest.approx(1.0, abs=1e-3)


def test_a_run_that_the_record_lacks_is_refused(brief):
    with pytest.raises(ValueError, match='brief_9999: no such run in datasets wheel, wheel_more'):
        packing.judged('wheel', [brief._replace(case='brief_9999')])


def test_table_of_means_and_medians(tmp_path):
    def row(value):
        return {who: dict.fromkeys(packing.QUANTITIES, value) for who in packing.WHO}

    path = tmp_path / 'packing.json'
    path.write_text(json.dumps({'tools': {'wheel': [row(v) for v in (0.1, 0.2, 0.6)]}}))
    first = packing.table(str(path)).splitlines()[2]
    cells = [cell.strip() for cell in first.strip('|').split('|')]
    assert cells[0] == 'wheel (3 runs): one packing from the other'
    np.testing.assert_allclose([float(c) for c in cells[1:]], [0.3, 0.3, 0.2, 0.2])
