"""The trial of an installation: its table, the packages that no digest covers, the code it runs."""

import ast
import json

import pytest

import learning_to_simulate as lts
from run_scripts import try_install


def test_table_has_a_row_for_each_python(tmp_path):
    row = {'python': '3.13.0', 'packages': 51, 'size_mb': 1900, 'install_s': 70, 'smoke_s': 60}
    path = tmp_path / 'install.json'
    path.write_text(json.dumps({'rows': [row, row | {'python': '3.11.7'}]}))
    lines = try_install.table(str(path)).splitlines()
    assert lines[2] == '| 3.13.0 | 51 | 1900 | 70 | 60 |' and lines[3].startswith('| 3.11.7 |')


def test_rows_of_other_pythons_stay(tmp_path):
    path = str(tmp_path / 'install.json')
    for version, seconds in (('3.13.0', 1), ('3.9.2', 2), ('3.13.0', 3)):
        try_install.keep({'python': version, 'install_s': seconds}, path)
    document = json.loads((tmp_path / 'install.json').read_text())
    assert [(r['python'], r['install_s']) for r in document['rows']] == [
        ('3.9.2', 2),
        ('3.13.0', 3),
    ]
    assert 'try_install.py python3.9 python3.13 --output_path=docs' in document['command']


def test_a_package_without_a_digest_is_named(tmp_path):
    with pytest.raises(ValueError, match="not in hashes.txt: .'left-pad'"):
        try_install._hold_against_digests(['false'], {'numpy', 'left_pad'}, str(tmp_path))


def test_the_minute_of_use_is_python_and_uses_what_ships():
    tree = ast.parse(try_install.SMOKE)
    # All but the import from elsewhere and the training, on the sources.
    live = [
        line for line in tree.body if 'live' in ast.unparse(line) or 'pose' in ast.unparse(line)
    ]
    made = {'lts': lts, 'model': lts.load('excavation')}
    exec(compile(ast.Module(live, []), 'smoke', 'exec'), made)  # noqa: S102
    assert made['frame'].status == 'ok'
    assert (try_install.ROOT / 'models' / 'excavation' / 'pcg' / 'config.json').exists()
    assert (try_install.ROOT / 'examples' / 'your_own_data.py').exists()
