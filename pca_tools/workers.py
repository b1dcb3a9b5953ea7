"""Runs a function over many inputs: a pool of processes, or Dask on this machine or a cluster.

One word chooses: '' (a pool), 'local' or 'local:4' (Dask here, 4 workers), 'tcp://host:port' (a
scheduler that runs already), 'slurm' or 'slurm:64' (64 jobs of the batch system). Dask is the extra
`[cluster]`; a pool needs nothing.

Each input is one task of one thread. Dask gives a task whose worker dies to another one; in
a pool that ends the command. An input that raises is tried again twice, and one that always raises
is reported without stopping the rest.
Functions that write should write one whole file per input and skip what is there: then a command
that was killed, scheduler and all, goes on when it is given again.
"""

import concurrent.futures
import contextlib
import dataclasses
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from pca_tools.storage import parent

RETRIES = 2
# Batch jobs end themselves before the batch system ends them, a little apart from each other.
SLURM_WALLTIME = '01:00:00'
SLURM_LIFETIME = ('--lifetime', '55m', '--lifetime-stagger', '4m')
SLURM_MEMORY = '4GB'
_GOES_ON = 'what was finished is kept, the same command goes on'


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of one input: its index, what the function returned, or why it failed."""

    index: int
    value: Any
    error: str | None = None


class Workers:
    """Processes that take tasks; made by `start`."""

    def __init__(self, client=None, pool: concurrent.futures.ProcessPoolExecutor | None = None):
        self.client = client
        self._pool = pool

    def run(self, function: Callable[[Any], Any], inputs: Sequence[Any]) -> Iterator[Outcome]:
        """Yields the outcome of every input, one task each, as it is there, in any order; the
        function is of a module that the workers can import too. OSError: the pool lost a process
        (Dask does not mind), or the scheduler is gone."""
        if self._pool:
            yield from self._run_pool(self._pool, function, inputs)
        else:
            yield from self._run_dask(function, inputs)

    def _run_pool(self, pool, function, inputs) -> Iterator[Outcome]:
        places = {pool.submit(_tried, function, item): i for i, item in enumerate(inputs)}
        try:
            for future in concurrent.futures.as_completed(places):
                # Out of the list, so that a value that was taken is freed.
                index, error = places.pop(future), future.exception()
                if isinstance(error, BrokenProcessPool):
                    text = 'a process was killed from outside (out of memory?)'
                    raise OSError(f'{text}; {_GOES_ON}') from error
                if error is None:
                    yield Outcome(index, future.result())
                else:
                    yield Outcome(index, None, f'{type(error).__name__}: {error}')
        finally:
            for future in places:
                future.cancel()

    def _run_dask(self, function, inputs) -> Iterator[Outcome]:
        from distributed import as_completed

        # Not pure: equal inputs are two tasks, and results of an older call do not stand in.
        futures = self.client.map(function, inputs, pure=False, retries=RETRIES)
        places = {future.key: index for index, future in enumerate(futures)}
        for future, value in as_completed(futures, with_results=True, raise_errors=False):
            index = places[future.key]
            # A value that has come stays, though the worker that held it died since ('lost').
            if future.status == 'error':
                error = future.exception()
                yield Outcome(index, None, f'{type(error).__name__}: {error}')
            elif future.cancelled():
                text = f'the cluster lost task {index} ({future.status}): its scheduler is gone'
                raise OSError(f'{text}; {_GOES_ON}')
            else:
                yield Outcome(index, value)
            future.release()


def _tried(function: Callable[[Any], Any], item: Any) -> Any:
    """Calls the function once more after each of `RETRIES` errors."""
    for _ in range(RETRIES):
        with contextlib.suppress(Exception):
            return function(item)
    return function(item)


@contextlib.contextmanager
def start(where: str = '', processes: int | None = None) -> Iterator[Workers]:
    """Starts the workers for the length of a `with` block: `where` as the module says, `processes`
    of a pool or of 'local' and 'slurm' without a number, default one per core. ValueError: an
    unknown word. ModuleNotFoundError: Dask is not installed. OSError: no scheduler answers."""
    kind, _, number = where.partition(':')
    if kind not in ('', 'local', 'slurm', 'tcp', 'tls'):
        raise ValueError(
            f'cluster is {where!r}; local, local:4, slurm, slurm:64 or tcp://host:port was expected'
        )
    if kind in ('local', 'slurm') and number:
        if not number.isdigit() or int(number) < 1:
            raise ValueError(f'cluster is {where!r}; a number of workers was expected')
        processes = int(number)
    count = processes or os.cpu_count() or 1
    with contextlib.ExitStack() as stack:
        if kind:
            yield Workers(client=_client(stack, kind, where, count))
        else:
            context = multiprocessing.get_context('spawn')
            pool = concurrent.futures.ProcessPoolExecutor(count, context, parent.end_with_parent)
            yield Workers(pool=stack.enter_context(pool))


def _client(stack: contextlib.ExitStack, kind: str, where: str, count: int):
    import dask
    import distributed

    if kind in ('tcp', 'tls'):
        target: Any = where
    elif kind == 'local':
        # A row of a report runs in a process of its own, which a daemonic worker may not start.
        stack.enter_context(dask.config.set({'distributed.worker.daemon': False}))
        target = stack.enter_context(
            distributed.LocalCluster(
                n_workers=count, threads_per_worker=1, processes=True, dashboard_address=None
            )
        )
    else:
        target = stack.enter_context(slurm_cluster())
        target.scale(jobs=count)  # a fixed number: adapting ends workers that hold results
    return stack.enter_context(distributed.Client(target))


def slurm_cluster():
    """Returns the cluster of the batch system; `.job_script()` shows what is submitted. Queue,
    account and the like are set in Dask's own configuration (`~/.config/dask/jobqueue.yaml`)."""
    from dask_jobqueue import SLURMCluster

    return SLURMCluster(
        cores=1, processes=1, memory=SLURM_MEMORY, walltime=SLURM_WALLTIME,
        worker_extra_args=list(SLURM_LIFETIME),
        job_script_prologue=['export DASK_DISTRIBUTED__WORKER__DAEMON=False'],
    )  # fmt: skip
