"""How commands start: help at once and with exit code 0, errors in one line."""

import os
import sys
from collections.abc import Callable

from absl import app, flags, logging

_MAX_MESSAGE = 4000  # a message may quote what a file holds
HELP = ('-h', '--help', '-help', '--helpshort', '--helpfull', '--helpxml')


def start(run: Callable, n_argument: int = 0, usage: str = '') -> None:
    """Runs a command as the main program; its flags are defined already. `run` is called with their
    values and, if it takes up to `n_argument` arguments that are no flags, a list of these; what it
    returns is the exit code. `usage` says how, where it does nothing without such an argument.

    A question for help ends with exit code 0. `ValueError`, `OSError`, a package that is not
    installed and an argument that is no flag end in one line that begins with `error:`, with 1."""

    def main(argv):
        if len(argv) > n_argument + 1:
            sys.exit(f'error: unexpected arguments {argv[n_argument + 1 :]}; flags begin with --')
        if usage and len(argv) == 1:
            sys.exit(f'usage: {usage}')
        if not flags.FLAGS['verbosity'].present:  # TensorFlow tells of every checkpoint it writes
            logging.set_verbosity(logging.WARNING)
        try:
            return run(flags.FLAGS, argv[1:]) if n_argument else run(flags.FLAGS)
        except ModuleNotFoundError as error:
            sys.exit(f'error: this needs {error.name}, which is not installed')
        except (ValueError, OSError) as error:
            logging.debug('stack', exc_info=True)
            sys.exit(f'error: {printable(error)}')

    asked = any(argument.split('=')[0] in HELP for argument in sys.argv[1:])
    try:
        app.run(main)
    except SystemExit as done:
        if asked and done.code == 1:  # absl's code for help that was printed
            sys.exit(0)
        raise


def start_quietly(run: Callable, n_argument: int = 0, usage: str = '') -> None:
    """As `start`, of a command in which TensorFlow only reads and writes records."""
    os.environ.setdefault('TF_ENABLE_ONEDNN_OPTS', '0')  # its banner stays away, too
    start(run, n_argument, usage)


def printable(text: object) -> str:
    """Returns a message as it may be printed: what files and names hold cannot control a terminal.
    Control characters become escapes, line breaks and tabs stay; a long one is cut."""
    shown = ''.join(
        character if character.isprintable() or character in '\n\t' else repr(character)[1:-1]
        for character in str(text)[: _MAX_MESSAGE + 1]
    )
    return shown if len(str(text)) <= _MAX_MESSAGE else f'{shown[:_MAX_MESSAGE]} ... (cut)'
