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
import pathlib
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
# Limits of one input, far above the milliseconds and kilobytes of the valid ones. Seconds of CPU:
# a busy machine is no fault of a reader.
SECONDS, MEMORY = 10, 2**30


class Hang(BaseException):
    """A reader took too long; no `except Exception` of a reader may swallow it."""


class Bench:
    """One target in its folder, with the valid content of its files in memory."""

    def __init__(self, target: Target, folder: pathlib.Path):
        self.target, self._folder = target, folder
        folder.mkdir()
        with contextlib.redirect_stdout(io.StringIO()):
            target.write(str(folder))
            self._valid = {path.name: path.read_bytes() for path in folder.iterdir()}
            value = target.read(str(folder))
        self._original = fingerprint(value)
        self._parts = set(map(fingerprint, target.parts(value)))

    def _restore(self):
        """Writes the valid files again, and removes what a reader made."""
        for path in self._folder.iterdir():
            if self._valid.get(path.name) != path.read_bytes():
                path.unlink()
        for name, data in self._valid.items():
            if not (self._folder / name).exists():
                (self._folder / name).write_bytes(data)

    def run(self, seed: int, number: int) -> tuple[str, str]:
        """'refused', 'equal', 'possible' or 'failed', and what there is to say about a failure."""
        self._restore()
        rng = random.Random(f'{self.target.name}:{seed}:{number}')
        name = rng.choice(self.target.changed)
        forged, data = rng.random() < 0.5, self._valid[name]
        data = mutations.forge(name, data, rng) if forged else mutations.damage(data, rng)
        (self._folder / name).write_bytes(data)
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                value = self.target.read(str(self._folder))
            return self._judged(name, value, forged)
        except (ValueError, OSError) as error:
            named = str(self._folder) in str(error)
            return ('refused', '') if named else ('failed', f'no file in the message: {error!r}')
        except Hang:
            return 'failed', f'hangs for {SECONDS} s'
        except Exception:
            return 'failed', traceback.format_exc(limit=-3)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)

    def _judged(self, name, value, forged):
        target = self.target
        if fingerprint(value) == self._original:
            return 'equal', ''
        parts = set(map(fingerprint, target.parts(value)))
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
    made = Bench(target, folder)
    with limited():
        found = [made.run(seed, number) for number in range(count)]
    counts = collections.Counter(outcome for outcome, _ in found)
    return counts, {n: why for n, (outcome, why) in enumerate(found) if outcome == 'failed'}


@pytest.mark.parametrize('target', targets.TARGETS, ids=lambda target: target.name)
def test_reader_refuses_or_returns_what_can_be(target, tmp_path):
    counts, failures = outcomes(target, tmp_path / 'folder', 20, COUNT)
    assert not failures
    assert counts['refused'] + counts['possible'] > COUNT / 5  # else no file would have changed


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
    valid = '{"a": 1, "b": [1, 2, 3], "c": "text"}'

    def write(folder):
        pathlib.Path(folder, 'a.json').write_text(valid)

    def read(folder):
        data = pathlib.Path(folder, 'a.json').read_bytes()
        if data != valid.encode() and isinstance(raised, MemoryError):
            bytes(2**31)
        elif data != valid.encode() and raised:
            raise raised
        return data

    target = Target('broken', Promise.SEALED, write, ('a.json',), read)
    counts, failures = outcomes(target, tmp_path / 'folder', 0, 20)
    assert counts['failed'] >= 15
    assert any(reason in why for why in failures.values())
