"""Damaged and forged files to everything that reads files: the same inputs in every run.

FUZZ_COUNT in the environment is their number a reader, for a long run.
"""

import collections
import os

import pytest

from tests.faults import targets
from tests.faults.bench import Bench, limited

COUNT = int(os.environ.get('FUZZ_COUNT', '100'))
TARGETS = {target.name: target for target in targets.TARGETS}


def outcomes(target, folder, seed, count):
    """How often each outcome came, and the reasons of the failures by input."""
    made, counts, failures = Bench(target, str(folder)), collections.Counter(), {}
    with limited():
        for number in range(count):
            outcome, why = made.run(seed, number)
            counts[outcome] += 1
            if outcome == 'failed':
                failures[number] = why
    return counts, failures


@pytest.mark.parametrize('name', TARGETS)
def test_reader_refuses_or_returns_what_can_be(name, tmp_path):
    counts, failures = outcomes(TARGETS[name], tmp_path / 'folder', 20, COUNT)
    assert not failures
    assert counts['refused'] + counts['possible'] > COUNT / 5  # else no file would have changed


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
        (MemoryError(), 'MemoryError'),
    ],
)
def test_faulty_readers_are_found(tmp_path, raised, reason):
    calls = []

    def read(folder):
        calls.append(folder)
        if len(calls) > 1:  # the valid file must be readable
            if isinstance(raised, MemoryError):
                bytes(2**31)
            elif raised:
                raise raised
        return _read(folder)

    target = targets.Target('broken', targets.Promise.SEALED, _write, ('a.json',), read)
    counts, failures = outcomes(target, tmp_path / 'folder', 0, 20)
    assert counts['failed'] >= 15
    assert any(reason in why for why in failures.values())
