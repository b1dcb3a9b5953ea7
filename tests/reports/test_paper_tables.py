"""The thesis' tables: published figures as published, ours from what lies on disk."""

import pathlib

import numpy as np
import pytest

from pca_tools import files
from reports import paper_tables

ROOT = pathlib.Path(__file__).resolve().parents[2]


def cells(line):
    return [cell.strip() for cell in line.strip('|').split('|')]


def test_published_force_errors_have_the_size_that_the_text_compares():
    """Table 3.3: 9 runs each; FCG excavation stays below 20 %, PCG does not."""
    sizes = {key: np.abs(mpe).mean() for key, (_, mpe) in paper_tables.PUBLISHED_ERRORS.items()}
    assert all(len(mpe) == 9 for _, mpe in paper_tables.PUBLISHED_ERRORS.values())
    assert sizes['excavation', 'FCG'] == pytest.approx(6.53, abs=0.01)
    assert sizes['excavation', 'PCG'] > 10 * sizes['excavation', 'FCG']


def test_times_and_errors_of_the_shipped_models_stand_beside_the_published():
    lines = paper_tables.times(str(ROOT / 'models')).splitlines()
    assert len({line.count('|') for line in lines}) == 1
    wheel = cells(lines[-1])
    assert wheel[0] == 'wheel, ours' and wheel[1] == '' and float(wheel[3]) > float(wheel[7])
    lines = paper_tables.errors(str(ROOT / 'models'), paper_tables.LONGER).splitlines()
    assert len({line.count('|') for line in lines}) == 1
    rows = {cells(line)[0]: cells(line)[1:] for line in lines}
    assert rows['excavation, PCG, published'][0] == '0.025'
    ours = rows['excavation, `pcg`, our records, test']
    trivial = rows['excavation, constant velocity, our records, test']
    assert float(ours[0]) < float(trivial[0]) and len(ours[1].split()) == 4


def test_longer_trainings_stand_beside_the_predictors_that_know_nothing(tmp_path):
    def run(soil, mpe):
        return {'soil_mse': soil, 'force_mpe': mpe}

    few, many = [run(2e-4, -10.0), run(4e-4, 30.0)], [run(1e-4, float(i)) for i in range(13)]
    trivial = {'stay_still': [run(8e-4, 50.0)], 'constant_velocity': [run(None, None)]}
    rows = [
        {'data': data, 'method': method, 'steps': steps, 'runs': trivial | {'model': model}}
        for data, method, steps, model in (
            ('other', 'pcg', None, few),
            ('wheel_grid_v2', 'fcg_original --x=1', 7, few),
            ('wheel_grid_v2', 'path_ridge', None, many),
        )
    ]
    path = str(tmp_path / 'longer.json')
    files.write_json(path, {'rows': dict(enumerate(rows))})
    lines = paper_tables.errors(str(tmp_path), path).splitlines()
    rows = {cells(line)[0]: cells(line)[1:] for line in lines}
    assert rows['wheel, FCG, grid of record, 7 steps'] == ['3', '-10.0 30.0', '20']
    assert rows['wheel, path_ridge, grid of record'] == ['1', 'median 6.0, 0.0 to 12.0', '6']
    assert rows['wheel, persistence, grid of record'] == ['8', '50.0', '50']
    assert rows['wheel, constant velocity, grid of record'] == ['not finite', '-', '']
    assert not any('`pcg`' in name for name in rows)
    with pytest.raises(ValueError, match="'models/wheel': MODEL:DATA was expected"):
        paper_tables.correction(['models/wheel'])
