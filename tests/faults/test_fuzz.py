"""A bounded part of `python -m reports fuzz`: the same inputs in every run."""

import os
import random

import pytest

from reports.fuzz import bench, mutations, targets
from reports.fuzz import report as fuzz

NAMES = [target.name for target in targets.TARGETS]


@pytest.mark.parametrize('name', NAMES)
def test_reader_refuses_or_returns_what_can_be(name, tmp_path):
    """100 inputs a reader; docs/fuzz.md has those of the long run."""
    with bench.benches([name]) as made:
        result = bench.run_block(made, 20, 0, 100, str(tmp_path / 'note'))
    assert result['failures'] == []
    counts = result['counts'][name]
    assert sum(counts.values()) == 100
    assert counts['refused'] + counts['possible'] > 20  # else the files would not have changed


class Broken:
    """Readers with the faults that the fuzzing is to find."""

    @staticmethod
    def write(folder):
        with open(os.path.join(folder, 'a.json'), 'w', encoding='utf-8') as file:
            file.write('{"a": 1, "b": [1, 2, 3], "c": "text"}')

    @staticmethod
    def read_anything(folder):
        with open(os.path.join(folder, 'a.json'), 'rb') as file:
            return file.read()

    @staticmethod
    def crash(folder):
        raise KeyError(folder)

    @staticmethod
    def hide(folder):
        raise ValueError('something is wrong somewhere')


@pytest.mark.parametrize(
    ('read', 'reason'),
    [
        (Broken.read_anything, 'was read as if it were whole'),
        (Broken.crash, 'KeyError'),
        (Broken.hide, 'no file in the message'),
    ],
)
def test_faulty_readers_are_found(monkeypatch, tmp_path, read, reason):
    calls = []

    def after_the_first(folder):  # the valid file must be readable
        calls.append(folder)
        return Broken.read_anything(folder) if len(calls) == 1 else read(folder)

    target = targets.Target(
        'broken', targets.Promise.SEALED, Broken.write, ('a.json',), after_the_first
    )
    monkeypatch.setattr(bench, 'TARGETS', (target,))
    with bench.benches(['broken']) as made:
        result = bench.run_block(made, 0, 0, 20, str(tmp_path / 'note'))
    assert result['counts']['broken']['failed'] >= 15
    assert any(reason in failure['why'] for failure in result['failures'])


def test_inputs_are_functions_of_seed_and_number():
    first, other = (bench.make_input(NAMES, seed, 40) for seed in (1, 2))
    assert first != other
    # Whatever was made in between.
    for number in range(0, 40 * len(NAMES), len(NAMES)):
        bench.make_input(NAMES, 1, number + NAMES.index('edges.json'))
    assert bench.make_input(NAMES, 1, 40) == first


def test_forged_json_does_not_depend_on_the_forgeries_before():
    valid = b'{"a": [1, 2], "b": {"c": "x"}, "d": [[1, 2], [3]]}'

    def forgeries():
        return [mutations.forge('a.json', valid, random.Random(i)) for i in range(3000)]

    assert forgeries() == forgeries()


def test_damage_and_forgery_change_files():
    valid = b'{"a": [1, 2], "b": {"c": "x"}}'
    rng = random.Random(0)
    for change in (mutations.damage, lambda d, r: mutations.forge('a.json', d, r)):
        assert sum(change(valid, rng) != valid for _ in range(100)) > 80


def test_table_counts_everything():
    counts = {'edges.json': {'refused': 3, 'equal': 2, 'possible': 1, 'failed': 0}}
    assert '| edges.json | open | 6 | 3 | 2 | 1 | 0 |' in fuzz.table(counts)
