"""One fuzzed input after another, in this process: outcome by outcome.

A reader may refuse (ValueError or OSError with the name of the file in its message) or return a
value: the original one, or, where the files carry no checksum, one that some valid file could hold.
Everything else is a failure: another exception, more than `SECONDS`, more than `MEMORY`, a damaged
file that passes. Inputs are functions of (target, seed, number).
"""

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

from tests.faults import mutations
from tests.faults.targets import Promise, Target

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
