"""The stability report in miniature, and what it is made of."""

import json
import math

import numpy as np
import pytest

from reports.stability import __main__ as stability_report
from reports.stability import cases, subspace_cases


def test_outcome_follows_figure_and_threshold():
    outcomes = [cases.judged('p', 'n', figure, 'm', 1.0).outcome for figure in (0.5, 1.5, math.nan)]
    assert outcomes == [cases.HOLDS, cases.FAILS, cases.FAILS]
    assert cases.judged('p', 'n', 7.0, 'm').outcome == cases.MEASURED
    assert cases.to_json({'a': np.array([1.0, np.nan]), 'b': (1, 'x')}) == {
        'a': [1.0, None], 'b': [1, 'x'],
    }  # fmt: skip


def test_to_and_fro_turns_at_both_ends():
    assert cases.to_and_fro(4, 9).tolist() == [0, 1, 2, 3, 2, 1, 0, 1, 2]
    assert cases.hold(3, 5).tolist() == [0, 1, 2, 2, 2]


@pytest.mark.slow
def test_report_in_miniature(tmp_path, monkeypatch):
    """All parts on the smallest cases: every promise holds, and table, JSON and pictures agree."""
    monkeypatch.setattr(subspace_cases, 'PRECISIONS', ('float64',))  # each is compiled for seconds
    parts = list(stability_report.PARTS)
    rows = stability_report.report(parts, True, str(tmp_path))
    assert {row.outcome for row in rows} >= {cases.HOLDS, cases.MEASURED, cases.FLAGGED}
    assert not [row.name for row in rows if row.outcome == cases.FAILS]
    values = json.loads((tmp_path / stability_report.DATA).read_text())
    assert [row['name'] for row in values['rows']] == [row.name for row in rows]
    text = (tmp_path / stability_report.REPORT).read_text()
    assert all(row.name in text for row in rows)
    for picture in tmp_path.glob('*.png'):
        assert f']({picture.name})' in text
    assert len(list(tmp_path.glob('*.png'))) == 3


def test_unknown_part_is_refused(tmp_path):
    with pytest.raises(ValueError, match="unknown parts \\['weather'\\]"):
        stability_report.report(['weather'], True, str(tmp_path))
