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


@dataclasses.dataclass
class Bench:
    """One target in its folder, with the valid content of its files in memory."""

    target: Target
    folder: str

    def __post_init__(self):
        os.makedirs(self.folder)
        with contextlib.redirect_stdout(io.StringIO()):
            self.target.write(self.folder)
            self.valid = {name: self._bytes(name) for name in os.listdir(self.folder)}
            value = self.target.read(self.folder)
            self.original = fingerprint(value)
            self.parts = {fingerprint(part) for part in self.target.parts(value)}
            self._restore()

    def _bytes(self, name):
        with open(os.path.join(self.folder, name), 'rb') as file:
            return file.read()

    def _write(self, name, data):
        with open(os.path.join(self.folder, name), 'wb') as file:
            file.write(data)

    def _restore(self):
        for name in os.listdir(self.folder):
            if name not in self.valid:
                os.remove(os.path.join(self.folder, name))
        for name, data in self.valid.items():
            if not os.path.exists(os.path.join(self.folder, name)):
                self._write(name, data)

    def make(self, seed: int, number: int) -> tuple[str, bytes, bool]:
        """File name, content and whether it is a forgery of input `number`."""
        rng = random.Random(f'{self.target.name}:{seed}:{number}')
        name = rng.choice(self.target.changed)
        forged = rng.random() < 0.5
        data = self.valid[name]
        data = mutations.forge(name, data, rng) if forged else mutations.damage(data, rng)
        return name, data, forged

    def run(self, seed: int, number: int) -> tuple[str, str]:
        """Outcome of input `number`, and what there is to say about a failure."""
        name, data, forged = self.make(seed, number)
        self._write(name, data)
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                value = self.target.read(self.folder)
            if fingerprint(value) == self.original:
                return 'equal', ''
            damaged = self.target.promise is Promise.CHECKSUM and not forged
            if self.target.promise is Promise.SEALED or (
                damaged and not {fingerprint(p) for p in self.target.parts(value)} <= self.parts
            ):
                return 'failed', f'a changed {name} was read as if it were whole'
            if not self.target.possible(value):
                return 'failed', f'a {name} that cannot be was read'
            return 'possible', ''
        except (ValueError, OSError) as error:
            named = self.folder in str(error)
            return ('refused', '') if named else ('failed', f'no file in the message: {error!r}')
        except Hang:
            return 'failed', f'hangs for {SECONDS} s'
        except Exception:
            return 'failed', traceback.format_exc(limit=-3)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            self._write(name, self.valid[name])
            self._restore()


def fingerprint(value: Any) -> str:
    """Digest of a value's arrays, numbers and texts; equal values have equal ones."""
    digest = hashlib.sha256()

    def add(part):
        if isinstance(part, np.ndarray):
            digest.update(f'{part.shape}{part.dtype}'.encode())
            digest.update(np.ascontiguousarray(part).tobytes())
        elif dataclasses.is_dataclass(part):
            for field in dataclasses.fields(part):
                add(getattr(part, field.name))
        elif isinstance(part, dict):
            for key in sorted(part, key=repr):
                digest.update(repr(key).encode('utf-8', 'surrogatepass'))
                add(part[key])
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
def benches(names: list[str]) -> Iterator[list[Bench]]:
    """A round of benches of some targets (see `dealt`), their folders in memory where that can
    be."""
    signal.signal(signal.SIGPROF, _raise_hang)
    with tempfile.TemporaryDirectory(dir=_memory_folder()) as work:
        made = {
            target.name: Bench(target, os.path.join(work, str(i)))
            for i, target in enumerate(_chosen(names))
        }
        yield [made[target.name] for target in _round(names)]


def run_block(made: list[Bench], seed: int, first: int, last: int, note: str) -> dict:
    """Runs inputs `first` .. `last` - 1; number n goes to bench n of the round.

    Args:
        made: of `benches`.
        seed: of the inputs.
        first: first number.
        last: one beyond the last number.
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
    """`run_block` of some targets in a process that has nothing else to do."""
    limit_memory()
    with benches(names) as made:
        return run_block(made, seed, first, last, note)


def make_input(names: list[str], seed: int, number: int) -> tuple[str, bytes]:
    """File name and content of input `number`."""
    with tempfile.TemporaryDirectory() as work:
        bench = Bench(dealt(names, number), os.path.join(work, '0'))
        return bench.make(seed, number)[:2]


def dealt(names: list[str], number: int) -> Target:
    """The target of input `number`: in rounds, in which each has as many turns as its share."""
    turns = _round(names)
    return turns[number % len(turns)]


def _round(names):
    return [target for target in _chosen(names) for _ in range(target.share)]


def _chosen(names):
    return [target for target in TARGETS if target.name in names]


def _memory_folder():
    return '/dev/shm' if os.access('/dev/shm', os.W_OK) else None


def limit_memory() -> None:
    """Lets this process take `MEMORY` bytes more than it has now."""
    tf.constant(0)  # TensorFlow's threads and arenas come first
    with open('/proc/self/statm', encoding='utf-8') as file:
        size = int(file.read().split()[0]) * resource.getpagesize()
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, hard))
