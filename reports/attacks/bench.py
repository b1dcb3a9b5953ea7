"""One fuzzed input after another, in this process: outcome by outcome."""

import contextlib
import dataclasses
import hashlib
import io
import os
import random
import resource
import signal
import tempfile
import traceback
from collections.abc import Iterator
from typing import Any

import numpy as np
import tensorflow as tf

from reports.attacks import mutations
from reports.attacks.targets import TARGETS, Promise, Target

OUTCOMES = ('refused', 'equal', 'possible', 'failed')
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
        """Outcome of input `number`, and what there is to say about a failure."""
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
        """The outcome of an input that was read."""
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


def turns(names: list[str]) -> list[Target]:
    """A round of inputs: some targets, each as often as its share. Number n goes to the n-th."""
    chosen = (target for target in TARGETS if target.name in names)
    return [target for target in chosen for _ in range(target.share)]


def dealt(names: list[str], number: int) -> Target:
    """The target of input `number`."""
    order = turns(names)
    return order[number % len(order)]


@contextlib.contextmanager
def benches(names: list[str]) -> Iterator[list[Bench]]:
    """A round of benches, their folders in memory where that can be."""
    signal.signal(signal.SIGPROF, _raise_hang)
    memory = '/dev/shm' if os.access('/dev/shm', os.W_OK) else None
    with tempfile.TemporaryDirectory(dir=memory) as work:
        order = turns(names)
        made: dict[str, Bench] = {}
        for target in order:
            if target.name not in made:
                made[target.name] = Bench(target, os.path.join(work, str(len(made))))
        yield [made[target.name] for target in order]


def run_block(made: list[Bench], seed: int, first: int, last: int, note: str) -> dict:
    """Runs inputs `first` .. `last` - 1; number n goes to bench n of the round.

    Args:
      made: of `benches`.
      seed, first, last: of the inputs.
      note: file that always holds the number at hand, for whoever finds this process dead.

    Returns:
      `counts`: target -> outcome -> number; `failures`: list of dicts.
    """
    counts = {bench.target.name: dict.fromkeys(OUTCOMES, 0) for bench in made}
    failures = []
    with open(note, 'w', encoding='utf-8') as progress:
        for number in range(first, last):
            progress.seek(0)
            progress.write(f'{number:12d}')
            progress.flush()
            bench = made[number % len(made)]
            outcome, text = bench.run(seed, number)
            counts[bench.target.name][outcome] += 1
            if outcome == 'failed':
                failures.append({'target': bench.target.name, 'number': number, 'why': text})
    return {'counts': counts, 'failures': failures}


def run_alone(names: list[str], seed: int, first: int, last: int, note: str) -> dict:
    """`run_block` in a process that has nothing else to do: it may take `MEMORY` bytes more than it
    has, and ends where all inputs together take more CPU than they may."""
    tf.constant(0)  # TensorFlow's threads and arenas come first
    with open('/proc/self/statm', encoding='utf-8') as file:
        size = int(file.read().split()[0]) * resource.getpagesize()
    used = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
    seconds = int(used) + SECONDS * (last - first + 10)
    for kind, limit in ((resource.RLIMIT_AS, size + MEMORY), (resource.RLIMIT_CPU, seconds)):
        resource.setrlimit(kind, (limit, resource.getrlimit(kind)[1]))
    with benches(names) as made:
        return run_block(made, seed, first, last, note)


def make_input(names: list[str], seed: int, number: int) -> tuple[str, bytes]:
    """File name and content of input `number`."""
    with tempfile.TemporaryDirectory() as work:
        bench = Bench(dealt(names, number), os.path.join(work, '0'))
        return bench.make(seed, number)[:2]
