"""The table of methods where one was refused, which no document holds."""

from pca_tools import files
from reports.protocol import tables
from tests.reports.protocol.known import document


def test_methods_stand_on_the_runs_that_all_know_beside_the_truth(tmp_path):
    path = str(tmp_path / 'known.json')
    files.write_json(path, document())
    header, _, field, mlp, *_, own = (
        [cell.strip() for cell in line.strip('|').split('|')]
        for line in tables.methods(path).splitlines()
    )
    keys = 'soil_mm', 'near_mm', 'force_relative_l2'
    soil, near, force = (header.index(tables.TITLES[key]) for key in keys)
    assert field[0] == 'soil field (2 trainings, 1 refused)' and field[soil] == 'median 1.5'
    assert (mlp[0], mlp[soil], mlp[force]) == ('mlp_driven', '2.5', '1')
    assert own[0] == "*truth's own error* (2 cases)" and (own[soil], own[near]) == ('', 'over 2')
    assert own[force] == '0.2' and own[header.index('drawbar, rel. L2 (median)')] == '0.6'
