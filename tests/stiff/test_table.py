"""Every test that the tables of README.md name exists, and none of this folder is left out."""

import pathlib
import re

FOLDER = pathlib.Path(__file__).parent
ROOT = FOLDER.parents[1]


def named_tests():
    """(file, function) of each reference in README.md; a bare `::name` repeats the file."""
    file = None
    for path, name in re.findall(r'`([\w/]*\.py)?::(\w+)`', (FOLDER / 'README.md').read_text()):
        file = path or file
        yield (ROOT / file if '/' in file else FOLDER / file), name


def test_all_named_tests_exist():
    missing = [
        f'{path}::{name}'
        for path, name in named_tests()
        if not path.is_file() or f'def {name}(' not in path.read_text()
    ]
    assert not missing


def test_all_tests_of_this_folder_are_named():
    named = set(named_tests())
    files = [path for path in FOLDER.glob('test_*.py') if path.name != pathlib.Path(__file__).name]
    tests = {
        (path, name)
        for path in files
        for name in re.findall(r'^def (test_\w+)', path.read_text(), re.M)
    }
    assert not tests - named
