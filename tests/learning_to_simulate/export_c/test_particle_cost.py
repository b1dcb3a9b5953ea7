"""The table of what particles cost."""

from learning_to_simulate.export_c import particle_cost
from pca_tools import files


def test_the_table_tells_products_and_rate(tmp_path):
    path = str(tmp_path / 'cost.json')
    row = {
        'name': 'm', 'members': 5, 'width': 96, 'products': 1000, 'runs': 3, 'soil_mm': 3.2,
        'moving': 1600.0, 'mflop': 16.0, 'median_us': 400.0, 'calm_us': 200.0,
    }  # fmt: skip
    files.write_json(path, [row])
    line = particle_cost.table(path).splitlines()[-1]
    # 16e6 operations in 200e-6 s.
    assert line == '| 5 x 96 wide | 3.20 | 5000 | 16 | 400 | 200 | 80 |'
