"""Shipped swept fields in C against Python over whole test runs, and the table of that."""

import pytest

from learning_to_simulate.native import agreement_field, library
from pca_tools import files


@pytest.mark.slow
@pytest.mark.skipif(
    not any(map(library.shutil.which, ('cc', 'gcc', 'clang'))), reason='no C compiler'
)
@pytest.mark.parametrize('scene', ['excavation_v2', 'wheel_v2'])
def test_shipped_fields_over_whole_test_runs(scene):
    rows = agreement_field.measure(f'models/{scene}/swept_field', f'datasets/{scene}', limit=2)
    assert len(rows) == 2
    for row in rows:
        assert row['frames'] > 40 and row['same_status'] == row['frames']
        # Over all runs: docs/c/agreement_field.json.
        assert row['force'] <= 1e-5 and row['height_m'] <= 1e-6
        assert row['particles_m'] <= 4e-6 and row['motion_m'] > 1e-3
        # The same networks in float64: the float32 of C is no farther from them than TensorFlow's.
        assert 0 < row['c_to_twin_m'] <= 2e-6 and 0 < row['python_to_twin_m'] <= 4e-6


def test_the_table_has_the_largest_of_all_runs(tmp_path):
    row = {
        'frames': 10, 'force': 3e-6, 'torque': 1e-6, 'height_m': 1e-8, 'particles_m': 1e-7,
        'c_to_twin_m': 2e-7, 'python_to_twin_m': 3e-7, 'motion_m': 0.01, 'same_status': 9,
    }  # fmt: skip
    path = str(tmp_path / 'agreement.json')
    files.write_json(path, {'m': [row, row | {'frames': 5, 'force': 4e-6, 'same_status': 5}]})
    line = agreement_field.table(path).splitlines()[-1]
    assert line == '| m | 2 | 15 | 4.0e-6 | 1.0e-6 | 1.0e-8 | 1.0e-7 | 2.0e-7 | 3.0e-7 | 14 of 15 |'
