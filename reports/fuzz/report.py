"""Feeds damaged and forged files to everything that reads files, and counts what happens.

A reader may refuse (ValueError or OSError with the name of the file in its message) or return a
value: the original one, or, where the files carry no checksum, one that some valid file could hold.
Everything else is a failure: another exception, a crash of the process, more than 10 s, more than
1 GB of memory, a damaged file that passes. Inputs are functions of (seed, number); those that fail
are kept in `<output_path>/fuzz_failures/`. The same command goes on where it was stopped, and runs
those parts again in which an input failed.

Examples:
    python -m reports fuzz --count=1000000 --seed=0 --num_processes=8 --output_path=docs

    python -m reports fuzz --count=2000 --targets=subspace.npz --output_path=/tmp/fuzz
"""

import contextlib
import multiprocessing
import os
import queue
import tempfile
import time
from collections.abc import Callable, Iterator
from typing import Any

import tqdm
from absl import flags

from pca_tools import files
from reports import command, markdown, record
from reports.fuzz import bench
from reports.fuzz.targets import TARGETS
from storage import parent

COLUMNS = {
    'refused': 'refused',
    'equal': 'read as the original',
    'possible': 'read as another valid file',
    'failed': 'failures',
}
_BLOCK, _PART = 100, 5000  # inputs that a worker takes, and those between two saves


def _work(blocks, results, names, seed, note):
    parent.end_with_parent()
    bench.limit_memory()
    with bench.benches(names) as made:
        while (block := blocks.get()) is not None:
            results.put((block, bench.run_block(made, seed, *block, note)))


class Pool:
    """Processes that take blocks of inputs; one that dies is replaced.

    Args:
        names: of the targets.
        seed: of the inputs.
        num_processes: at a time.
    """

    def __init__(self, names: list[str], seed: int, num_processes: int = 1):
        self._context = multiprocessing.get_context('spawn')
        self._blocks, self._results = self._context.Queue(), self._context.Queue()
        self._names, self._seed = names, seed
        self._folder = tempfile.TemporaryDirectory()
        self._workers: dict = {}
        for slot in range(num_processes):
            self._start(slot)

    def __enter__(self):
        return self

    def __exit__(self, kind, *_):
        """Lets the workers end, or ends them in the middle of their blocks."""
        for process in self._workers.values():
            self._blocks.put(None) if kind is None else process.kill()
        for process in self._workers.values():
            process.join()
        self._blocks.cancel_join_thread()
        self._folder.cleanup()

    def run(self, first: int, last: int, show: Callable[[int], Any] = lambda done: None) -> dict:
        """Runs inputs `first` .. `last` - 1.

        Args:
            first: first number.
            last: one beyond the last number.
            show: is told how many more inputs are done.

        Returns:
            `counts`: target -> outcome -> number; `failures`: list of target, number and reason. A
            process that dies is a failure of the input at hand.
        """
        counts = {name: dict.fromkeys(bench.OUTCOMES, 0) for name in self._names}
        failures, done = [], 0
        for start in range(first, last, _BLOCK):
            self._blocks.put((start, min(start + _BLOCK, last)))
        while done < last - first:
            try:
                (start, end), result = self._results.get(timeout=1.0)
            except queue.Empty:
                for number, code in self._bury():
                    name, done = bench.dealt(self._names, number).name, done + 1
                    why = f'the process died with code {code}'
                    failures.append({'target': name, 'number': number, 'why': why})
                    counts[name]['failed'] += 1
                continue
            for name, outcomes in result['counts'].items():
                for outcome, n in outcomes.items():
                    counts[name][outcome] += n
            failures += result['failures']
            done += end - start
            show(end - start)
        return {'counts': counts, 'failures': failures}

    def _note(self, slot):
        return os.path.join(self._folder.name, str(slot))

    def _start(self, slot):
        arguments = (self._blocks, self._results, self._names, self._seed, self._note(slot))
        self._workers[slot] = self._context.Process(target=_work, args=arguments, daemon=True)
        self._workers[slot].start()

    def _bury(self):
        """Replaces dead workers, puts the rest of their blocks back; returns (input, exit code)."""
        died = []
        for slot, process in list(self._workers.items()):
            if self._hangs(slot):
                process.kill()
                process.join()
            if process.exitcode is None:
                continue
            if not os.path.exists(self._note(slot)):
                raise OSError(f'a fuzzing process ended with {process.exitcode} before any input')
            with open(self._note(slot), encoding='utf-8') as file:
                first, last, number = map(int, file.read().split())
            for block in ((first, number), (number + 1, last)):
                if block[0] < block[1]:
                    self._blocks.put(block)
            died.append((number, process.exitcode))
            os.remove(self._note(slot))
            self._start(slot)
        return died

    def _hangs(self, slot):
        """Whether an input has taken longer than the alarm inside of the worker allows, which
        cannot stop a loop that is not Python's."""
        with contextlib.suppress(FileNotFoundError):
            return time.time() - os.path.getmtime(self._note(slot)) > 60 * bench.SECONDS
        return False


def missing(parts: list[dict], count: int) -> Iterator[tuple[int, int]]:
    """(first, one beyond the last) input of what is to be run, in pieces that are saved one by one.

    Args:
        parts: what was run; see `joined`. One in which an input failed is to be run again.
        count: inputs in all.
    """
    whole = sorted((p['first'], p['last']) for p in parts if not p['failures'])
    at = 0
    for first, last in (*whole, (count, count)):
        for start in range(at, min(first, count), _PART):
            yield start, min(start + _PART, first, count)
        at = max(at, last)


def joined(parts: list[dict], new: dict) -> list[dict]:
    """Parts with another one, in order: `first`, `last`, `commit`, `seconds`, `counts`, `failures`.

    Neighbours of one commit without failures become one. What `new` was run again for goes.
    """
    kept = [p for p in parts if p['last'] <= new['first'] or p['first'] >= new['last']]
    result: list[dict] = []
    for part in sorted([*kept, new], key=lambda p: p['first']):
        before = result[-1] if result else None
        if (
            before
            and (before['last'], before['commit']) == (part['first'], part['commit'])
            and not before['failures'] + part['failures']
        ):
            seconds = before['seconds'] + part['seconds']
            counts = _sum([before['counts'], part['counts']])
            result[-1] = before | {'last': part['last'], 'seconds': seconds, 'counts': counts}
        else:
            result.append(part)
    return result


def _sum(counts):
    """Counts of several parts in one."""
    return {
        name: {outcome: sum(c[name][outcome] for c in counts) for outcome in bench.OUTCOMES}
        for name in counts[0]
    }


def save_failures(path: str, failures: list[dict], names: list[str], seed: int) -> None:
    """Writes the inputs that failed, with the reason beside each."""
    for failure in failures:
        folder = os.path.join(path, f'{failure["number"]:07d}')
        name, data = bench.make_input(names, seed, failure['number'])
        os.makedirs(folder, exist_ok=True)
        with open(os.path.join(folder, name), 'wb') as file:
            file.write(data)
        with open(os.path.join(folder, 'why.txt'), 'w', encoding='utf-8') as file:
            file.write(f'{failure["target"]}\n{failure["why"]}\n')


def table(path: str) -> str:
    """The outcomes by target in a `fuzz.json`, as Markdown."""
    return _table(files.read_json(path)['parts'])


def _table(parts):
    counts = _sum([part['counts'] for part in parts])
    promises = {target.name: target.promise.value for target in TARGETS}
    rows = []
    for name, outcomes in counts.items():
        values = [outcomes[key] for key in COLUMNS]
        rows.append([name, promises[name], sum(values), *values])
    sums = [sum(o[key] for o in counts.values()) for key in COLUMNS]
    rows.append(['**all**', '', sum(sums), *sums])
    return markdown.table(('reader', 'promise', 'inputs', *COLUMNS.values()), rows)


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_integer('count', 10_000, 'Inputs in all, dealt to the readers in turn.', 1)
    flags.DEFINE_integer('seed', 0, 'Seed of the inputs.')
    flags.DEFINE_integer('num_processes', 1, 'Processes.', 1)
    flags.DEFINE_float('minutes', None, 'Begin no further part after so many; default: run all.')
    flags.DEFINE_list('targets', None, 'Names of readers as in the table; default: all.')
    flags.DEFINE_string('output_path', None, 'Folder for fuzz.json and failing inputs.')


def main(values, _) -> int:
    """Runs the command; exit code 1 if an input failed."""
    known = [target.name for target in TARGETS]
    names = [name for name in known if values.targets is None or name in values.targets]
    if unknown := set(values.targets or ()) - set(known):
        raise ValueError(f'no readers named {sorted(unknown)}; there are {known}')
    path = values.output_path
    document: dict = {'parts': []}
    if path:
        os.makedirs(path, exist_ok=True)
        identity = {'seed': values.seed, 'readers': names}
        document = record.resume(f'{path}/fuzz.json', identity, document)
    parts = document['parts']
    todo = list(missing(parts, values.count))
    end = time.monotonic() + 60.0 * (values.minutes or float('inf'))
    with (
        Pool(names, values.seed, values.num_processes) as pool,
        tqdm.tqdm(total=sum(b - a for a, b in todo), unit='input', disable=None) as bar,
    ):
        for first, last in todo:
            if time.monotonic() > end:
                break
            head, start = record.provenance(), time.monotonic()
            part = {'first': first, 'last': last, 'commit': head['commit']}
            part |= pool.run(first, last, bar.update)
            part['seconds'] = round(time.monotonic() - start)
            parts = joined(parts, part)
            if path:
                files.write_json(f'{path}/fuzz.json', document | head | {'parts': parts})
                save_failures(f'{path}/fuzz_failures', part['failures'], names, values.seed)
    print(_table(parts))
    failures = [failure for part in parts for failure in part['failures']]
    for failure in failures[:20]:
        last_line = failure['why'].strip().splitlines()[-1]
        print(f'input {failure["number"]} of {failure["target"]}: {last_line}')
    return int(bool(failures))


if __name__ == '__main__':
    command.start(define_flags, main)
