"""Results are kept, made once, chosen by name, and judged."""

import pathlib

import numpy as np
import pytest

from mpm import verify
from mpm.verification import anchors, ladder, rows
from mpm.verification.rows import Check
from tests.pca_tools.commands import call_command

ROOT = pathlib.Path(__file__).resolve().parents[3]


def test_results_are_written_when_made_and_not_made_again(tmp_path):
    path, made = str(tmp_path / 'new' / 'verify.json'), []

    def first():
        made.append(1)
        return [Check('a', np.float64(1.02), 1.0, 0.05, 'note'), Check('b', 7.0)]

    jobs = {('entries', 'first'): first, ('entries', 'second'): lambda: 1 / 0}
    with pytest.raises(ZeroDivisionError):
        rows.make(path, jobs)
    third = {('entries', 'third'): lambda: [Check('c', 2.0, 1.0, 0.05)]}
    rows.make(path, jobs | third | {('cases', 'x', 'y'): dict}, ['first', 'i'])
    content = rows.read_kept(path)
    assert list(content['entries']) == ['first', 'third'] and len(made) == 1
    assert set(content['entries']['first']) == {'cpu_s', 'checks'} and 'cases' not in content
    assert verify.show(path).endswith('2 of 3 checks pass; 0 s of CPU\n\nfailed: c, 2')
    # A line for each result.
    rows.make(path, {('cases', 'x', 'y'): lambda: {'many': [1, 2, 3]}})
    assert pathlib.Path(path).read_text().count('\n') == 12


def test_checks_of_the_same_share_a_row_of_the_summary(tmp_path):
    path = str(tmp_path / 'verify.json')
    assert not any(Check('a', x, 1.0, 0.05).passed for x in (0.94, 1.06, float('nan')))
    made = [Check('blade 7: draft', 0.9, 1.0, 0.2), Check('blade 8: draft', 1.3, 1.0, 0.2)]
    made += [Check('blade 9: draft', 0.5), Check('blade 7: lift', 2.0, 2.0, 1.0)]
    rows.make(path, {('entries', 'all'): lambda: made})
    assert rows.summary(path).splitlines()[2:] == [
        '| blade: draft | 2 | 0.9 to 1.3 | 1 +- 0.2 | **1 fail** |',
        '| blade: draft | 1 | 0.5 |  |  |',
        '| blade: lift | 1 | 2 | 2 +- 1 |  |',
    ]


@pytest.mark.parametrize('content', ['{', '[]', '{"solver_version": "4"}'])
def test_files_of_others_are_refused(tmp_path, content):
    path = tmp_path / 'verify.json'
    path.write_text(content)
    with pytest.raises(
        ValueError, match='verify.json(: is not a JSON file| is not of solver version)'
    ):
        rows.make(str(path), {})


def test_unknown_names_are_refused_before_anything_is_made(tmp_path):
    path = tmp_path / 'verify.json'
    with pytest.raises(ValueError, match="no row 'nonsense'; there are free_fall, shear"):
        rows.make(str(path), verify.jobs('raw'), ['free_fall', 'nonsense'])
    assert not path.exists()


@pytest.mark.parametrize(
    ('report', 'made'),
    [
        ('verify', verify.jobs('raw')), ('ladder', ladder.jobs()), ('anchors', anchors.jobs()),
    ],
)  # fmt: skip
def test_kept_results_are_those_that_a_report_makes(report, made):
    """The README shows them as they are (`tests/test_documents.py`)."""
    content = rows.read_kept(str(ROOT / 'mpm' / 'verification' / f'{report}.json'))
    depths = {place[0]: len(place) for place in made}

    def places(inner, depth):
        return {()} if not depth else {
            (name, *rest) for name, kept in inner.items() for rest in places(kept, depth - 1)
        }  # fmt: skip

    for top in content.keys() - {'solver_version'}:
        assert {(top, *rest) for rest in places(content[top], depths[top] - 1)} <= made.keys()
    assert len(content) > 1


def test_command_keeps_rows_and_tells_of_a_failure(tmp_path):
    path = str(tmp_path / 'v.json')
    rows.make(path, {('entries', 'free_fall'): lambda: [Check('a', 2.0, 1.0)]})
    done = call_command('mpm.verify', f'--json={path}', '--rows=free_fall')
    assert done.returncode == 1 and '0 of 1 checks pass' in done.stdout
    assert done.stdout.endswith('failed: a, 2\n')
