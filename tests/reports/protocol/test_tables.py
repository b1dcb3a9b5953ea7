"""Tables of stored and of known documents."""

import json
import pathlib

import pytest

from pca_tools import files
from reports.protocol import tables
from tests.reports.protocol import known

STORED = sorted((pathlib.Path(__file__).parents[3] / 'docs' / 'protocol').glob('*.json'))


def assert_same(made, stored):
    """To the last bits, which another processor may round differently."""
    if isinstance(stored, dict):
        assert made.keys() == stored.keys()
        made, stored = ([value[key] for key in stored] for value in (made, stored))
    if isinstance(stored, list):
        assert len(made) == len(stored)
        for one, other in zip(made, stored):
            assert_same(one, other)
    else:
        assert made == (pytest.approx(stored, rel=1e-12) if isinstance(stored, float) else stored)


@pytest.mark.parametrize('path', STORED, ids=lambda path: path.name)
def test_figures_and_tables_of_stored_documents_follow_from_their_runs(path):
    document = json.loads(path.read_text(encoding='utf-8'))
    assert_same(tables.complete(document), document)
    assert {'command', 'commit', 'machine'} <= document['record'].keys()
    for method in document['methods']:
        for seed in method['seeds']:
            for split, runs in document['runs'].items():
                assert len(seed['runs'][split]) == len(runs)
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


def test_errors_stand_beside_those_of_the_baselines():
    lines = tables.quantity_table(tables.complete(known.document(7, 0.5)), 'test', 'force_l2')
    first, _, field, ridge = lines.splitlines()
    assert first == '| method | median | mean | worst | over path ridge |'
    assert field == (
        '| field (2 seeds) | 0.2 (0.1 to 0.3) | 0.233 (0.117 to 0.35) | 0.4 (0.2 to 0.6) '
        '| 1 (0.5 to 1.5); wins 1.5 (0 to 3) of 3 |'
    )
    assert ridge.startswith('| *path ridge* | 0.2 | 0.233 | 0.4 |')


def test_the_table_of_sizes_joins_the_documents(tmp_path):
    paths = [str(tmp_path / name) for name in ('a.json', 'b.json')]
    for path, size, scale in zip(paths, (28, 7), (0.5, 1.0), strict=True):
        files.write_json(path, known.document(size, scale))
    lines = tables.sizes(*paths).splitlines()
    columns = 'field: soil, mm | path ridge: soil, mm | field: force, rel. L2 | path ridge: force, '
    assert lines[0] == f'| training runs | {columns}rel. L2 |'
    assert lines[2:] == [
        '| 7 | 8 (4 to 12) | 4 | 0.6 (0.3 to 0.9) | 0.3 |',
        '| 28 | 4 (2 to 6) | 4 | 0.3 (0.15 to 0.45) | 0.3 |',
    ]


@pytest.mark.parametrize(
    'soil, flat',
    [
        ((90, 70, 50, 30, 10, 10, 4, 6), 0.5),  # the last two quarters are compared
        ((90, 70, 50, 30, 10, 10, 4), 0.4),  # quarters of one
        ((1, 1, 1), ''),  # too few looks say nothing
    ],
)
def test_every_training_that_was_watched_has_a_row(soil, flat):
    curve = [{'step': n, 'soil_mse': float(v), 'force_mse': None} for n, v in enumerate(soil, 1)]
    seeds = [{'seed': 0, 'curve': curve}, {'seed': 1, 'curve': []}, {'seed': 2}]
    document = {'methods': [{'name': 'pcg', 'seeds': seeds}]}
    assert tables.training_table(document).splitlines()[2:] == [
        f'| pcg | 0 | {len(soil)} | {flat} |  |'
    ]
    assert tables.training_table({'methods': [{'name': 'pcg', 'seeds': seeds[1:]}]}) == ''
