"""Feeds damaged and forged files to everything that reads files, and counts what happens.

A reader may refuse (ValueError or OSError with the name of the file in its message) or return a
value: the original one, or, where the files carry no checksum, one that some valid file could hold.
Everything else is a failure: another exception, a crash of the process, more than 10 s, more than
1 GB of memory, a damaged file that passes. Inputs are functions of (seed, number); those that fail
are kept in `<output_path>/fuzz_failures/`.

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

import tqdm
from absl import flags

from pca_tools import files
from reports import command, markdown, record
from reports.fuzz import bench
from reports.fuzz.targets import TARGETS

COLUMNS = {
    'refused': 'refused',
    'equal': 'read as the original',
    'possible': 'read as another valid file',
    'failed': 'failures',
}
_BLOCK = 100


def _work(blocks, results, names, seed, note):
    bench.limit_memory()
    with bench.benches(names) as made:
        while (block := blocks.get()) is not None:
            results.put((block, bench.run_block(made, seed, *block, note)))


class _Pool:
    """Processes that take blocks of inputs; one that dies is replaced."""

    def __init__(self, names, seed, num_processes, folder):
        self._context = multiprocessing.get_context('spawn')
        self.blocks, self.results = self._context.Queue(), self._context.Queue()
        self._names, self._seed, self._folder = names, seed, folder
        self._workers = {}
        for slot in range(num_processes):
            self._start(slot)

    def _note(self, slot):
        return os.path.join(self._folder, str(slot))

    def _start(self, slot):
        arguments = (self.blocks, self.results, self._names, self._seed, self._note(slot))
        self._workers[slot] = self._context.Process(target=_work, args=arguments, daemon=True)
        self._workers[slot].start()

    def bury(self) -> list[tuple[int, int]]:
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
                    self.blocks.put(block)
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

    def close(self, finished: bool):
        """Lets the workers end, or ends them in the middle of their blocks."""
        for process in self._workers.values():
            self.blocks.put(None) if finished else process.kill()
        for process in self._workers.values():
            process.join()
        self.blocks.cancel_join_thread()


def fuzz(
    names: list[str], count: int, seed: int, num_processes: int = 1, minutes: float | None = None
) -> dict:
    """Runs `count` inputs in processes of their own.

    Args:
        names: of the targets.
        count: inputs in all.
        seed: of the inputs.
        num_processes: at a time.
        minutes: after which it ends with what was run; None for all.

    Returns:
        `counts`: target -> outcome -> number; `failures`: list of target, number and reason. A
        process that dies is a failure of the input at hand.
    """
    counts = {name: dict.fromkeys(bench.OUTCOMES, 0) for name in names}
    failures, done = [], 0
    end = time.monotonic() + 60.0 * minutes if minutes else float('inf')
    with (
        tempfile.TemporaryDirectory() as folder,
        tqdm.tqdm(total=count, unit='input', disable=None) as bar,
    ):
        pool = _Pool(names, seed, num_processes, folder)
        for first in range(0, count, _BLOCK):
            pool.blocks.put((first, min(first + _BLOCK, count)))
        while done < count and time.monotonic() < end:
            try:
                (first, last), result = pool.results.get(timeout=1.0)
            except queue.Empty:
                for number, code in pool.bury():
                    name, done = names[number % len(names)], done + 1
                    why = f'the process died with code {code}'
                    failures.append({'target': name, 'number': number, 'why': why})
                    counts[name]['failed'] += 1
                continue
            for name, outcomes in result['counts'].items():
                for outcome, n in outcomes.items():
                    counts[name][outcome] += n
            failures += result['failures']
            done += last - first
            bar.update(last - first)
            bar.set_postfix(failed=len(failures))
        pool.close(done == count)
    return {'counts': counts, 'failures': failures}


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


def table(counts: dict) -> str:
    """The outcomes by target, as Markdown."""
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
    flags.DEFINE_float('minutes', None, 'End after so many, with what was run; default: run all.')
    flags.DEFINE_list('targets', None, 'Names of readers as in the table; default: all.')
    flags.DEFINE_string('output_path', None, 'Folder for fuzz.json, fuzz.md and failing inputs.')


def main(values, _) -> int:
    """Runs the command; exit code 1 if an input failed."""
    known = [target.name for target in TARGETS]
    names = [name for name in known if values.targets is None or name in values.targets]
    if unknown := set(values.targets or ()) - set(known):
        raise ValueError(f'no readers named {sorted(unknown)}; there are {known}')
    start = time.time()
    result = fuzz(names, values.count, values.seed, values.num_processes, values.minutes)
    text = table(result['counts'])
    if values.output_path:
        os.makedirs(values.output_path, exist_ok=True)
        head = record.provenance() | {'seconds': round(time.time() - start)}
        files.write_json(os.path.join(values.output_path, 'fuzz.json'), head | result)
        files.write_text(
            os.path.join(values.output_path, 'fuzz.md'),
            f'# Fuzzed readers\n`{head["command"]}`\n\n{text}\n',
        )
        save_failures(
            os.path.join(values.output_path, 'fuzz_failures'), result['failures'], names,
            values.seed,
        )  # fmt: skip
    print(text)
    for failure in result['failures'][:20]:
        last_line = failure['why'].strip().splitlines()[-1]
        print(f'input {failure["number"]} of {failure["target"]}: {last_line}')
    return int(bool(result['failures']))


if __name__ == '__main__':
    command.start(define_flags, main)
