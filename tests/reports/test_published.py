"""The table of longer trainings beside the published figures, against means taken here."""

import json
import pathlib
import statistics

from reports import published

RECORD = pathlib.Path(__file__).resolve().parents[2] / 'docs' / 'longer_trainings.json'


def cells(path):
    """(runs, method) -> the other cells of a row."""
    rows = [line[2:-2].split(' | ') for line in published.table(str(path)).splitlines()[2:]]
    return {(row[0], row[1]): [cell.strip() for cell in row[2:]] for row in rows}


def test_a_row_in_closed_form(tmp_path):
    looks = {'step': [10, 20], 'soil_mse': [5e-4, 4e-4], 'force_mse': [400.0, 900.0]}
    row = {'scene': 'wheel', 'runs': 'two runs', 'method': 'pcg_thesis',
           'soil_mse': [1e-4, 3e-4], 'force_mpe': [-10.0, 30.0], 'validation': looks}  # fmt: skip
    path = tmp_path / 'rows.json'
    path.write_text(json.dumps({'rows': [row]}))
    found = cells(path)
    assert found['wheel, two runs (2)', 'partial graph'] == ['20', '2', '4 to 5', '20', '20 to 30']
    # Nine runs whose errors are 6.5 % on the average, by hand.
    assert found['blade, published (9)', 'full graph'] == ['', '0.6', '', '6.53', '']
    assert len(found) == 5


def test_the_record_is_in_the_table():
    found = cells(RECORD)
    rows = json.loads(RECORD.read_text())['rows']
    assert len(found) == len(rows) + 4 == 17
    for row in rows:
        name = {'fcg_original': 'full graph', 'pcg_thesis': 'partial graph', 'pcg': '`pcg`'}
        key = f'{row["scene"]}, {row["runs"]} ({len(row["force_mpe"])})'
        steps, soil, _, force, _ = found[key, name.get(row['method'], row['method'])]
        assert float(soil) == float(f'{1e4 * statistics.fmean(row["soil_mse"]):.3g}')
        assert float(force) == float(f'{statistics.fmean(map(abs, row["force_mpe"])):.3g}')
        if row['method'] == 'persistence':
            assert steps == '' and 'validation' not in row
        else:
            assert f'--num_steps={steps} ' in row['command'] or row['method'] == 'pcg'
            of_judged = row['validation']['soil_mse'][-1]
            if row['runs'] == "the authors' records":  # which validation runs judge
                assert abs(of_judged - statistics.fmean(row['soil_mse'])) < 1e-4 * of_judged
