"""Rows are kept, made once, and judged."""

import json
import pathlib

import numpy as np
import pytest

from mpm import verify, versions
from mpm.verification import rows
from mpm.verification.rows import Check, Table, reported

ROOT = pathlib.Path(__file__).resolve().parents[3]


def test_rows_are_written_when_made_and_not_made_again(tmp_path):
    path, made = str(tmp_path / 'verify.json'), []

    def make():
        made.append(1)
        return [Check('a', np.float64(1.02), 1.0, 0.05, 'note'), reported('b', 7.0, '')]

    Table(path).add('first', make)
    table = Table(path)
    table.add('first', make)
    assert len(made) == 1
    with pytest.raises(ZeroDivisionError):
        table.add('second', lambda: [1 / 0])
    table.add('third', lambda: [Check('c', 2.0, 1.0, 0.05, '')])
    again = Table(path)
    assert list(again.entries) == ['first', 'third'] and again.failed == ['c']
    lines = again.text().splitlines()
    assert len(lines) == 5 and '| a (note) | 1.02 | 1 | 0.05 | pass |' in lines[2]
    assert '| b | 7 |  |  | reported |' in lines[3] and '**FAIL**' in lines[4]


@pytest.mark.parametrize('figure', [0.94, 1.06, float('nan')])
def test_figure_outside_its_bounds_fails(figure):
    assert not Check('a', figure, 1.0, 0.05, '').passed


@pytest.mark.parametrize('content', ['{', '[]', '{"solver_version": "2"}'])
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / 'verify.json'
    path.write_text(content)
    with pytest.raises(ValueError, match='not a table of checks'):
        Table(str(path))


def test_rows_of_another_solver_are_refused(tmp_path):
    path = tmp_path / 'verify.json'
    path.write_text(json.dumps({'solver_version': '1', 'entries': {}}))
    with pytest.raises(ValueError, match='solver version 1'):
        Table(str(path))


def test_unknown_rows_are_refused_before_any_is_made(tmp_path):
    path = tmp_path / 'verify.json'
    with pytest.raises(ValueError, match="unknown rows \\['nonsense'\\]; there are free_fall"):
        verify.run_rows_of(str(tmp_path), str(path), ['free_fall', 'nonsense'])
    assert not path.exists()


def test_cheap_rows_pass(tmp_path):
    table = verify.run_rows_of(str(tmp_path), str(tmp_path / 'v.json'), ['free_fall', 'momentum'])
    assert len(table.entries) == 2 and not table.failed


def test_record_holds_rows_that_the_command_makes():
    """The README shows the record as it is (`tests/test_documents.py`)."""
    made = list(verify.rows_of('raw'))
    kept = Table(str(ROOT / 'mpm' / 'verification' / 'verify.json')).entries
    assert kept and set(kept) <= set(made)


def test_reports_of_another_solver_are_refused(tmp_path):
    path = tmp_path / 'ladder.json'
    assert rows.read_kept(str(path)) == {'solver_version': versions.SOLVER_VERSION}
    for text in ('{"solver_version": "4", "cases": {}}', '[]'):
        path.write_text(text)
        with pytest.raises(ValueError, match='is not of solver version'):
            rows.read_kept(str(path))
