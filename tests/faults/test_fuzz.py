"""A bounded part of `python -m reports fuzz`: the same inputs in every run."""

import io
import os
import random
import time
import types

import numpy as np
import pytest

from pca_tools import files
from reports.attacks import bench, mutations, targets
from reports.attacks import report as fuzz

NAMES = [target.name for target in targets.TARGETS]


@pytest.mark.parametrize('name', NAMES)
def test_reader_refuses_or_returns_what_can_be(name, tmp_path):
    """100 inputs a reader; docs/findings.md counts those of a long run."""
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
    for number in range(200):
        if bench.dealt(NAMES, number).name == 'edges.json':
            bench.make_input(NAMES, 1, number)
    assert bench.make_input(NAMES, 1, 40) == first


def test_forged_archives_do_not_depend_on_the_clock(monkeypatch):
    stream = io.BytesIO()
    np.savez(stream, a=np.arange(6.0), b=np.ones((2, 3)))

    def forgeries():
        return [mutations.forge('a.npz', stream.getvalue(), random.Random(i)) for i in range(50)]

    first = forgeries()
    monkeypatch.setattr(time, 'time', lambda: 1e9)
    assert forgeries() == first


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


def test_every_reader_has_its_share_of_a_round(monkeypatch, tmp_path):
    shares = {'cheap': 3, 'dear': 1}
    made = [
        targets.Target(
            name, targets.Promise.OPEN, Broken.write, ('a.json',), Broken.read_anything, share=share
        )
        for name, share in shares.items()
    ]  # fmt: skip
    monkeypatch.setattr(bench, 'TARGETS', made)
    assert [bench.dealt(list(shares), n).name for n in (0, 2, 3, 4)] == [
        'cheap', 'cheap', 'dear', 'cheap'
    ]  # fmt: skip
    with bench.benches(list(shares)) as benches:
        counts = bench.run_block(benches, 0, 0, 40, str(tmp_path / 'note'))['counts']
    assert {name: sum(c.values()) for name, c in counts.items()} == {'cheap': 30, 'dear': 10}


def part(first, last, commit='a', failures=(), refused=1):
    counts = {'edges.json': {'refused': refused, 'equal': 2, 'possible': 1, 'failed': 0}}
    values = {'first': first, 'last': last, 'commit': commit, 'seconds': 1}
    return values | {'counts': counts, 'failures': list(failures)}


def test_table_counts_everything(tmp_path):
    files.write_json(str(tmp_path / 'fuzz.json'), {'parts': [part(0, 4), part(4, 8, refused=3)]})
    assert '| edges.json | open | 10 | 4 | 4 | 2 | 0 |' in fuzz.table(str(tmp_path / 'fuzz.json'))


def test_a_process_that_dies_is_a_failure_of_its_input(monkeypatch, tmp_path):
    """Run here in place of another process, which dies at input 5 and at input 9."""
    dying = {5, 9}

    def alone(function, names, seed, first, last, note, limit_s):
        for number in range(first, last):
            if number in dying:
                with open(note, 'w', encoding='utf-8') as file:
                    file.write(f'{number:12d}')
                raise RuntimeError('ended from outside')
        counts = {'edges.json': dict.fromkeys(fuzz.COLUMNS, 0) | {'equal': last - first}}
        return {'counts': counts, 'failures': []}

    monkeypatch.setattr(fuzz.isolated, 'call', alone)
    part = fuzz.run_part(['edges.json'], 0, (0, 20))
    assert part['counts']['edges.json'] == {'refused': 0, 'equal': 18, 'possible': 0, 'failed': 2}
    assert sorted(failure['number'] for failure in part['failures']) == [5, 9]


@pytest.mark.slow
def test_the_command_counts_every_input(tmp_path):
    """Called here: the workers, which import TensorFlow again, are processes all the same."""
    values = types.SimpleNamespace(
        count=100, seed=0, num_processes=1, targets=['edges.json'], output_path=str(tmp_path)
    )
    assert fuzz.main(values, None) == 0
    (part,) = files.read_json(str(tmp_path / 'fuzz.json'))['parts']
    assert sum(part['counts']['edges.json'].values()) == 100
