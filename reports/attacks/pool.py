"""Processes that feed inputs to the readers, block by block, and are replaced where they die."""

import contextlib
import multiprocessing
import os
import queue
import tempfile
import time
from collections.abc import Callable
from typing import Any

from pca_tools.storage import parent
from reports.attacks import bench

_BLOCK = 100  # inputs that a worker takes


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
