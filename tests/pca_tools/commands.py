"""Running the commands of the package as a person does."""

import contextlib
import io
import pathlib
import runpy
import subprocess
import sys
import warnings
from unittest import mock

from absl import app, flags

REPOSITORY = pathlib.Path(__file__).resolve().parents[2]


def call_command(*arguments):
    """Runs `python -m <arguments>` in this process, which need not import TensorFlow again, and
    without threads of its own; returns what a finished process has."""
    app.define_help_flags()
    known, out, errors, code = set(flags.FLAGS), io.StringIO(), io.StringIO(), None
    try:
        with (
            mock.patch.object(sys, 'argv', list(arguments)),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(errors),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter('ignore', RuntimeWarning)  # runpy's, of a module that is known
            runpy.run_module(arguments[0], run_name='__main__', alter_sys=True)
    except SystemExit as done:
        code = done.code
    finally:
        for name in set(flags.FLAGS) - known:
            delattr(flags.FLAGS, name)
        flags.FLAGS.unparse_flags()
    if isinstance(code, str):  # Python's own way to end with a message
        errors.write(f'{code}\n')
    return subprocess.CompletedProcess(
        arguments, 1 if isinstance(code, str) else code or 0, out.getvalue(), errors.getvalue()
    )
