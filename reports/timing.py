"""The one timer: calls take turns after a warm-up, so a drift of the machine meets them all."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import tqdm

CLOCKS = {'min': 0, 'median': 50, 'p95': 95, 'p99': 99, 'worst': 100}


@dataclasses.dataclass(frozen=True)
class Timing:
    """Raw samples of one clock, ms per step of one graph.

    Attributes:
      samples_ms: every measured call, in the order of measurement.
      processor_ms: the same by processor time of all threads, where it was taken: on a busy
        machine it says more than the clock.
    """

    samples_ms: tuple[float, ...]
    processor_ms: tuple[float, ...] = ()

    def __post_init__(self):
        if not self.samples_ms or not all(s > 0 for s in self.samples_ms):
            raise ValueError(f'a timing needs positive samples, got {self.samples_ms[:5]!r}')

    def percentile(self, q: float) -> float:
        """The q-th percentile, ms per step; 0 is the minimum, 100 the worst."""
        return float(np.percentile(self.samples_ms, q))

    def summary(self, prefix: str = '') -> dict[str, float]:
        """min, median, p95, p99 and worst, ms per step; names start with `prefix`."""
        return {f'{prefix}{name}': self.percentile(q) for name, q in CLOCKS.items()}


@dataclasses.dataclass(frozen=True)
class Job:
    """Something to be timed.

    Attributes:
      call: does it once, results materialised. If it returns numbers, these are the seconds: one
        call may time only a part of what it does, or many steps each by itself.
      steps: what the time of a call is divided by.
      rounds: turns; None for as many as the others.
      warm_up: calls before.
    """

    call: Callable[[], object]
    steps: int = 1
    rounds: int | None = None
    warm_up: int = 2


def first_output(function: Callable, inputs: Sequence) -> None:
    """Calls a compiled function and waits for its first output: a rollout's positions."""
    function(*inputs)[0].numpy()


def in_turns(jobs: Mapping[str, Job], rounds: int, label: str = 'in turns') -> dict[str, Timing]:
    """Times all jobs, one call of each in every round.

    Args:
      jobs: name -> what to time.
      rounds: turns of a job that does not say its own number.
      label: of the progress bar.

    Returns:
      name -> `Timing`, ms per step.

    Raises:
      ValueError: a job returned a time that is not above 0.
    """
    for job in tqdm.tqdm(jobs.values(), 'warm-up', unit='job', disable=None, leave=False):
        for _ in range(job.warm_up):
            job.call()
    seconds: dict[str, list] = {name: [] for name in jobs}
    processor: dict[str, list] = {name: [] for name in jobs}
    turns = max((job.rounds or rounds for job in jobs.values()), default=0)
    for turn in tqdm.tqdm(range(turns), label, unit='round', disable=None):
        for name, job in jobs.items():
            if turn >= (job.rounds or rounds):
                continue
            wall, busy = time.perf_counter(), time.process_time()
            result = job.call()
            wall, busy = time.perf_counter() - wall, time.process_time() - busy
            if isinstance(result, int | float | list | tuple):
                seconds[name] += np.ravel(result).tolist()
            else:
                seconds[name].append(wall)
                processor[name].append(busy)
    return {
        name: Timing(
            tuple(1e3 * s / job.steps for s in seconds[name]),
            tuple(1e3 * s / job.steps for s in processor[name]),
        )
        for name, job in jobs.items()
    }
