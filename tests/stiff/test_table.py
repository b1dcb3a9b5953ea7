"""The tables of tests/stiff and tests/faults: every test of their folder, and only what exists."""

import pathlib
import re

import pytest

ROOT = pathlib.Path(__file__).parents[2]


def named_in(path):
    return set(re.findall(r'^def (test_\w+)\(', path.read_text(), re.M))


@pytest.mark.parametrize('folder', ['stiff', 'faults'])
def test_the_table_names_every_test_of_its_folder_and_no_other(folder):
    here, named, file = ROOT / 'tests' / folder, {}, None
    for row in (here / 'README.md').read_text().splitlines():
        for path, name in re.findall(r'`([\w/]*\.py)?(?:::(\w+))?`', row) * row.startswith('| '):
            if path:
                file = ROOT / path if '/' in path else here / path
            names = named.setdefault(file, set())
            names |= {name} if name else named_in(file)
    for path, names in named.items():
        assert names <= named_in(path), f'{path} has no {sorted(names - named_in(path))}'
    for path in set(here.glob('test_*.py')) - {pathlib.Path(__file__)}:
        assert named.get(path) == named_in(path), f'{path} has tests that no row names'
