"""How every report starts: as the other commands, with its flags, threads and arguments."""

from collections.abc import Callable

from absl import flags

from learning_to_simulate import command


def start(define_flags: Callable[[], None], run: Callable, n_argument: int = 0) -> None:
    """Runs a report as the main program; see `learning_to_simulate.command.start`.

    Args:
      define_flags: defines its flags. One named `num_threads` sets TensorFlow's threads.
      run: takes the flags' values and the arguments beside them; what it returns is the exit code.
      n_argument: how many arguments without `--` it takes at most.
    """

    def main(values, arguments=()):
        if 'num_threads' in values:
            command.import_tensorflow(values.num_threads)
        return run(values, list(arguments))

    define_flags()
    command.start(main, n_argument)


def define_workers(what: str) -> None:
    """Defines --cluster and --num_processes.

    Args:
      what: is done side by side, for the help.
    """
    flags.DEFINE_integer('num_processes', 1, f'{what[:-1]}, where no cluster is named.', 1)
    flags.DEFINE_string(
        'cluster', '', "Where that is done: '' here, local:4, slurm:64 or tcp://... with Dask."
    )
