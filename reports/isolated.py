"""Calls a function in a fresh process, also from workers that `multiprocessing` lets have none.

python -m reports.isolated CALL ANSWER      # what `call` starts
"""

import functools
import os
import pickle
import subprocess
import sys
import tempfile


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
    with tempfile.TemporaryDirectory() as folder:
        names = [os.path.join(folder, name) for name in ('call', 'answer')]
        with open(names[0], 'wb') as file:
            pickle.dump((functools.partial(function, *arguments), threads), file)
        # Ends with this process: a worker that is killed leaves no training behind.
        command = [sys.executable, '-m', 'storage.parent', str(os.getpid()), 'reports.isolated']
        environment = os.environ | {'PYTHONPATH': os.pathsep.join(sys.path)}
        try:
            done = subprocess.run([*command, *names], env=environment, timeout=limit_s, check=False)
        except subprocess.TimeoutExpired as error:
            raise TimeoutError(f'not done within {limit_s:g} s') from error
        if done.returncode or not os.path.exists(names[1]):
            raise RuntimeError('its process was ended from outside (out of memory?)')
        with open(names[1], 'rb') as file:
            value, raised = pickle.load(file)
    if raised is not None:
        raise raised
    return value


def use_threads(count: int) -> None:
    """Gives TensorFlow `count` CPU threads; must come before its first operation."""
    import tensorflow as tf

    tf.config.threading.set_intra_op_parallelism_threads(count)
    tf.config.threading.set_inter_op_parallelism_threads(1)


def _answer(question: str, answer: str) -> None:
    with open(question, 'rb') as file:
        function, threads = pickle.load(file)
    if threads:
        use_threads(threads)
    result: tuple[object, Exception | None]
    try:
        result = function(), None
    except Exception as error:
        result = None, error
    with open(answer, 'wb') as file:
        pickle.dump(result, file)


if __name__ == '__main__':
    _answer(*sys.argv[1:])
