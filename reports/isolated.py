"""Calls a function in a fresh process, also from the workers of a pool or a cluster."""

import concurrent.futures
import multiprocessing

from pca_tools.storage import parent


def call(function, *arguments, limit_s: float | None = None, threads: int | None = None):
    """Calls a function of a module in a fresh process and returns what it returns.

    Args:
      function, arguments: what to call.
      limit_s: seconds that it may take; None for any.
      threads: CPU threads of TensorFlow in that process; None leaves them alone.

    Raises:
      TimeoutError: it ran longer than `limit_s`; the process was ended.
      RuntimeError: the process died without an answer.
      Exception: whatever the function raises.
    """
    pool = concurrent.futures.ProcessPoolExecutor(
        1, multiprocessing.get_context('spawn'), initializer=_prepare, initargs=(threads,)
    )
    try:
        return pool.submit(function, *arguments).result(limit_s)
    except TimeoutError as error:
        for process in pool._processes.values():
            process.terminate()
        raise TimeoutError(f'not done within {limit_s:g} s') from error
    except concurrent.futures.process.BrokenProcessPool as error:
        raise RuntimeError('its process was ended from outside (out of memory?)') from error
    finally:
        pool.shutdown(cancel_futures=True)


def _prepare(threads: int | None) -> None:
    parent.end_with_parent()  # a worker that is killed leaves no training behind
    if threads:  # must come before TensorFlow's first operation
        import tensorflow as tf

        tf.config.threading.set_intra_op_parallelism_threads(threads)
        tf.config.threading.set_inter_op_parallelism_threads(1)
