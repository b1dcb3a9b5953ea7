"""The tables of tests/stiff and tests/faults: every named test exists, no file is left out."""

import pathlib
import re

import pytest

ROOT = pathlib.Path(__file__).parents[2]


@pytest.mark.parametrize('folder', ['stiff', 'faults'])
def test_named_tests_exist_and_each_file_is_named(folder):
    here, files, missing = ROOT / 'tests' / folder, set(), []
    text = (here / 'README.md').read_text()
    file = None
    for path, name in re.findall(r'`([\w/]*\.py)?(?:::(\w+))?`', text):
        if path:
            file = ROOT / path if '/' in path else here / path
            files.add(file)
        if file and not (file.is_file() and (not name or f'def {name}(' in file.read_text())):
            missing.append(f'{file}::{name}')
    assert not missing
    assert set(here.glob('test_*.py')) - {pathlib.Path(__file__)} <= files
