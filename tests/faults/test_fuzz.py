"""A bounded part of `python -m reports fuzz`: the same inputs in every run."""

import io
import os
import random
import time
import types
from concurrent.futures.process import BrokenProcessPool

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


def _write(folder):
    with open(os.path.join(folder, 'a.json'), 'w', encoding='utf-8') as file:
        file.write('{"a": 1, "b": [1, 2, 3], "c": "text"}')


def _read(folder):
    with open(os.path.join(folder, 'a.json'), 'rb') as file:
        return file.read()


@pytest.mark.parametrize(
    'raised, reason',
    [
        (None, 'was read as if it were whole'),
        (KeyError('a'), 'KeyError'),
        (ValueError('something is wrong somewhere'), 'no file in the message'),
    ],
)
def test_faulty_readers_are_found(monkeypatch, tmp_path, raised, reason):
    calls = []

    def read(folder):
        calls.append(folder)
        if raised and len(calls) > 1:  # the valid file must be readable
            raise raised
        return _read(folder)

    target = targets.Target('broken', targets.Promise.SEALED, _write, ('a.json',), read)
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


def test_forgeries_do_not_depend_on_the_clock_or_on_those_before_and_change_files(monkeypatch):
    stream = io.BytesIO()
    np.savez(stream, a=np.arange(6.0), b=np.ones((2, 3)))
    valid = {
        'a.npz': stream.getvalue(),
        'a.json': b'{"a": [1, 2], "b": {"c": "x"}, "d": [[1, 2], [3]]}',
    }

    def changes(name, data, count=300):
        return [mutations.forge(name, data, random.Random(i)) for i in range(count)] + [
            mutations.damage(data, random.Random(i)) for i in range(count)
        ]

    first = {name: changes(name, data) for name, data in valid.items()}
    monkeypatch.setattr(time, 'time', lambda: 1e9)
    for name, data in valid.items():
        assert changes(name, data) == first[name]
        assert sum(changed != data for changed in first[name]) > 480


def test_every_reader_has_its_share_of_a_round(monkeypatch, tmp_path):
    shares = {'cheap': 3, 'dear': 1}
    made = [
        targets.Target(name, targets.Promise.OPEN, _write, ('a.json',), _read, share=share)
        for name, share in shares.items()
    ]
    monkeypatch.setattr(bench, 'TARGETS', made)
    assert [bench.dealt(list(shares), n).name for n in (0, 2, 3, 4)] == [
        'cheap', 'cheap', 'dear', 'cheap'
    ]  # fmt: skip
    with bench.benches(list(shares)) as benches:
        counts = bench.run_block(benches, 0, 0, 40, str(tmp_path / 'note'))['counts']
    assert {name: sum(c.values()) for name, c in counts.items()} == {'cheap': 30, 'dear': 10}


def test_a_process_that_dies_is_a_failure_of_its_input(monkeypatch):
    """Run here in place of another process, which dies at input 5 and at input 9."""
    dying = {5, 9}

    def alone(function, names, seed, first, last, note):
        for number in range(first, last):
            if number in dying:
                with open(note, 'w', encoding='utf-8') as file:
                    file.write(f'{number:12d}')
                raise BrokenProcessPool
        return {'counts': {'edges.json': {'equal': last - first}}, 'failures': []}

    monkeypatch.setattr(fuzz, 'alone', alone)
    part = fuzz.run_part(['edges.json'], 0, (0, 20))
    assert part['counts']['edges.json'] == {'refused': 0, 'equal': 18, 'possible': 0, 'failed': 2}
    assert sorted(failure['number'] for failure in part['failures']) == [5, 9]
    assert '| edges.json | open | 40 | 0 | 36 | 0 | 4 |' in fuzz.table([part, part])


@pytest.mark.slow
def test_the_command_counts_every_input(tmp_path):
    """Called here: the workers, which import TensorFlow again, are processes all the same."""
    values = types.SimpleNamespace(
        count=100, seed=0, num_processes=1, targets=['edges.json'], output_path=str(tmp_path)
    )
    assert fuzz.main(values, None) == 0
    (part,) = files.read_json(str(tmp_path / 'fuzz.json'))['parts']
    assert sum(part['counts']['edges.json'].values()) == 100
