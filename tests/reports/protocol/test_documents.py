"""Figures of the stored protocol follow from the errors of its runs."""

import json
import pathlib

import pytest

from reports.protocol import tables

ROOT = pathlib.Path(__file__).resolve().parents[3]
STORED = sorted((ROOT / 'docs' / 'protocol').glob('*.json'))


def assert_same(made, stored):
    """To the last bits, which another processor may round differently."""
    if isinstance(stored, dict):
        assert made.keys() == stored.keys()
        for key in stored:
            assert_same(made[key], stored[key])
    elif isinstance(stored, list):
        assert len(made) == len(stored)
        for one, other in zip(made, stored):
            assert_same(one, other)
    elif isinstance(stored, float):
        assert made == pytest.approx(stored, rel=1e-12)
    else:
        assert made == stored


@pytest.mark.parametrize('path', STORED, ids=lambda path: path.name)
def test_figures_follow_from_the_errors_of_the_runs(path):
    document = json.loads(path.read_text(encoding='utf-8'))
    assert_same(tables.complete(document), document)
    assert {'command', 'commit', 'machine'} <= document['record'].keys()
    for method in document['methods']:
        for seed in method['seeds']:
            for split, runs in document['runs'].items():
                assert len(seed['runs'][split]) == len(runs)


@pytest.mark.parametrize('path', STORED, ids=lambda path: path.name)
def test_tables_of_the_pages_hold_the_means_over_runs(path):
    document = json.loads(path.read_text(encoding='utf-8'))
    (method,) = (m for m in document['methods'] if m['name'] == 'swept_field')
    runs, errors = document['runs']['test'], method['seeds'][0]['runs']['test']
    soil = [e['soil_mm'] for run, e in zip(runs, errors, strict=True) if run['motion_mm'] >= 1]
    force = [e['force_l2'] for e in errors]
    means = f'| {sum(soil) / len(soil):.3g} | {sum(force) / len(force):.3g} |'
    assert f'swept_field {means}' in tables.means(str(path), 'test', 'soil_mm', 'force_l2')
    assert f'| recommended {means}' in tables.shipped(str(path))
    by_kind = tables.of_method(str(path), 'test', 'swept_field', 'force_l2', 'soil_mm')
    assert {line.split(' | ')[0][2:] for line in by_kind.splitlines()[2:]} == {
        'all', *(run['kind'] for run in runs)
    }  # fmt: skip
