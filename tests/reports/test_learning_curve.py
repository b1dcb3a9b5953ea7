"""The curve's rows, its table and picture, on a protocol whose errors are known."""

import os
from types import SimpleNamespace

import pytest

from pca_tools import files
from reports import learning_curve
from reports.protocol import driven_runs

RUNS = [
    {'kind': 'grid', 'motion_mm': 9.0},
    {'kind': 'lift', 'motion_mm': 9.0},
    {'kind': 'stops', 'motion_mm': 0.1},  # hardly moves: only its force counts
]


def document(train_runs, scale):
    def seed(factor):
        soil, force = [2.0, 4.0, 99.0], [0.1, 0.2, 0.4]
        rows = [
            {'soil_mm': factor * s, 'force_l2': factor * f}
            for s, f in zip(soil, force, strict=True)
        ]
        return {'seed': 0, 'runs': {'test': rows}}

    ridge = seed(1.0)
    ridge['runs']['test'][0]['soil_mm'] = None  # a run that failed
    methods = [
        {'name': 'field', 'seeds': [seed(scale), seed(3 * scale)]},
        {'name': 'path ridge', 'seeds': [ridge]},
    ]
    return {'data': {'train_runs': train_runs}, 'runs': {'test': RUNS}, 'methods': methods}


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


@pytest.fixture
def made(tmp_path, monkeypatch):
    """(flags, sizes that were judged) of a command whose sets and trainings are left out."""
    judged = []

    def subset(data_path, folder, size, kinds, overwrite):
        assert kinds == {'lift': 2} and overwrite
        os.makedirs(folder)
        files.write_json(f'{folder}/manifest.json', {})

    def protocol(folder, values, models):
        assert [len(paths) for paths in models.values()] == [2]
        judged.append(folder)
        return document(28 if '/all/' in folder else 7, 0.5 if '/all/' in folder else 1.0)

    monkeypatch.setattr(learning_curve.subset, 'subset', subset)
    monkeypatch.setattr(learning_curve.document, 'protocol', protocol)
    values = SimpleNamespace(
        data_path='data', sizes=['7', '0'], kinds=['lift:2'], train=['mlp'], num_seeds=2,
        work_path=str(tmp_path / 'sizes'), output_path=str(tmp_path / 'curve'),
    )  # fmt: skip
    return values, judged


def test_a_curve_goes_on_where_it_stopped(made, tmp_path, monkeypatch, capsys):
    values, judged = made
    values.sizes = ['7']
    learning_curve.main(values, None)
    values.sizes = ['7', '0']
    learning_curve.main(values, None)
    assert judged == [f'{tmp_path}/sizes/7/data', f'{tmp_path}/sizes/all/data']
    path = f'{values.output_path}.json'
    assert files.read_json(path)['rows']['0']['train_runs'] == 28
    lines = learning_curve.table(path, 'driven').splitlines()
    columns = (
        'field: soil, mm',
        'path ridge: soil, mm',
        'field: force, rel. L2',
        'path ridge: force, rel. L2',
    )
    assert lines[0] == f'| training runs | {" | ".join(columns)} |'
    assert lines[2:] == [
        '| 7 | 8 (4 to 12) | 4 | 0.6 (0.3 to 0.9) | 0.3 |',
        '| 28 | 4 (2 to 6) | 4 | 0.3 (0.15 to 0.45) | 0.3 |',
    ]
    assert learning_curve.table(path, 'grid').splitlines()[2].startswith('| 7 | 4 (2 to 6) |')
    assert (tmp_path / 'curve.png').read_bytes().startswith(b'\x89PNG')
    assert 'driven' in capsys.readouterr().out


def test_sizes_that_are_no_numbers_are_refused(made):
    values, _ = made
    values.sizes = ['7', 'many']
    with pytest.raises(ValueError, match=r"--sizes are numbers of runs, got \['many'\]"):
        learning_curve.main(values, None)
