"""How every report starts: flags, threads, errors in one line."""

import sys
from collections.abc import Callable

from absl import app, flags


def start(define_flags: Callable[[], None], run: Callable, n_argument: int = 0) -> None:
    """Runs a report as the main program.

    Args:
      define_flags: defines its flags. One named `num_threads` sets TensorFlow's threads.
      run: takes the flags' values and the arguments beside them; what it returns is the exit code.
        `ValueError` and `OSError` end in one line and code 1.
      n_argument: how many arguments without `--` it takes at most.
    """

    def main(argv):
        values = flags.FLAGS
        if len(argv) > n_argument + 1:
            sys.exit(f'error: unexpected arguments {argv[n_argument + 1 :]}')
        if 'num_threads' in values:
            import tensorflow as tf

            tf.config.threading.set_intra_op_parallelism_threads(values.num_threads)
        try:
            sys.exit(run(values, argv[1:]))
        except (ValueError, OSError) as error:
            sys.exit(f'error: {error}')

    define_flags()
    app.run(main)
