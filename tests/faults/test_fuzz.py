"""Damaged and forged files to everything that reads files: the same inputs in every run.

A reader may refuse (ValueError or OSError with the name of the file in its message) or return a
value: the original one, or, where the files carry no checksum, one that some valid file could hold.
Everything else is a failure: another exception, more than `SECONDS`, more than `MEMORY`, a damaged
file that passes. Inputs are functions of (target, seed, number).

FUZZ_COUNT in the environment is their number a reader, for a long run.
"""

import collections
import contextlib
import dataclasses
import hashlib
import io
import os
import random
import resource
import signal
import traceback
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tests.faults import mutations, targets
from tests.faults.targets import Promise, Target

COUNT = int(os.environ.get('FUZZ_COUNT', '100'))
TARGETS = {target.name: target for target in targets.TARGETS}
# Limits of one input, far above the milliseconds and kilobytes of the valid ones. Seconds of CPU:
# a busy machine is no fault of a reader.
SECONDS, MEMORY = 10, 2**30


class Hang(BaseException):
    """A reader took too long; no `except Exception` of a reader may swallow it."""


class Bench:
    """One target in its folder, with the valid content of its files in memory."""

    def __init__(self, target: Target, folder: str):
        self.target, self._folder = target, folder
        os.makedirs(folder)
        with contextlib.redirect_stdout(io.StringIO()):
            target.write(folder)
            self._valid = {}
            for name in os.listdir(folder):
                with open(os.path.join(folder, name), 'rb') as file:
                    self._valid[name] = file.read()
            value = target.read(folder)
            self._original = fingerprint(value)
            self._parts = {fingerprint(part) for part in target.parts(value)}
            self._restore()

    def _write(self, name, data):
        with open(os.path.join(self._folder, name), 'wb') as file:
            file.write(data)

    def _restore(self):
        """Puts back what a reader removed or made; changed files are put back by `run`."""
        there = set(os.listdir(self._folder))
        for name in there - self._valid.keys():
            os.remove(os.path.join(self._folder, name))
        for name in self._valid.keys() - there:
            self._write(name, self._valid[name])

    def make(self, seed: int, number: int) -> tuple[str, bytes, bool]:
        """File name, content and whether it is a forgery of input `number`."""
        rng = random.Random(f'{self.target.name}:{seed}:{number}')
        name = rng.choice(self.target.changed)
        forged = rng.random() < 0.5
        data = self._valid[name]
        data = mutations.forge(name, data, rng) if forged else mutations.damage(data, rng)
        return name, data, forged

    def run(self, seed: int, number: int) -> tuple[str, str]:
        """'refused', 'equal', 'possible' or 'failed', and what there is to say about a failure."""
        name, data, forged = self.make(seed, number)
        self._write(name, data)
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                value = self.target.read(self._folder)
            return self._judged(name, value, forged)
        except (ValueError, OSError) as error:
            named = self._folder in str(error)
            return ('refused', '') if named else ('failed', f'no file in the message: {error!r}')
        except Hang:
            return 'failed', f'hangs for {SECONDS} s'
        except Exception:
            return 'failed', traceback.format_exc(limit=-3)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            self._write(name, self._valid[name])
            self._restore()

    def _judged(self, name, value, forged):
        target = self.target
        if fingerprint(value) == self._original:
            return 'equal', ''
        parts = {fingerprint(part) for part in target.parts(value)}
        damaged = target.promise is Promise.CHECKSUM and not forged and not parts <= self._parts
        if target.promise is Promise.SEALED or damaged:
            return 'failed', f'a changed {name} was read as if it were whole'
        if not target.possible(value):
            return 'failed', f'a {name} that cannot be was read'
        return 'possible', ''


def fingerprint(value: Any) -> str:
    """Digest of a value's arrays, numbers and texts; equal values have equal ones."""
    digest = hashlib.sha256()

    def add(part):
        if isinstance(part, np.ndarray):
            digest.update(f'{part.shape}{part.dtype}'.encode())
            digest.update(np.ascontiguousarray(part).tobytes())
        elif dataclasses.is_dataclass(part):
            add([getattr(part, field.name) for field in dataclasses.fields(part)])
        elif isinstance(part, dict):
            add([item for key in sorted(part, key=repr) for item in (key, part[key])])
        elif isinstance(part, (list, tuple)):
            digest.update(str(len(part)).encode())
            for item in part:
                add(item)
        else:
            digest.update(repr(part).encode('utf-8', 'surrogatepass'))

    add(value)
    return digest.hexdigest()


def _raise_hang(*_):
    raise Hang


@contextlib.contextmanager
def limited() -> Iterator[None]:
    """This process may take `MEMORY` bytes more than it has; a hang ends with a signal."""
    signal.signal(signal.SIGPROF, _raise_hang)
    with open('/proc/self/statm', encoding='utf-8') as file:
        size = int(file.read().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


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

    target = Target('broken', Promise.SEALED, _write, ('a.json',), read)
    counts, failures = outcomes(target, tmp_path / 'folder', 0, 20)
    assert counts['failed'] >= 15
    assert any(reason in why for why in failures.values())
