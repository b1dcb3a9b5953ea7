"""How the commands of the package start: help at once, errors in one line, outputs tried before the
work, a quiet TensorFlow."""

import contextlib
import os
import sys
import tempfile
from collections.abc import Iterator

from pca_tools.command import HELP as HELP
from pca_tools.command import start as start

_TRUTHS = {'true': True, '1': True, 'false': False, '0': False}


def named_paths(flag: str, items: list[str], what: str) -> dict[str, str]:
    """Name -> path of the values NAME=PATH of a flag; `what` the path is, FILE or FOLDER.
    ValueError for one without a name or a path, or a name that comes twice."""
    found = dict(item.partition('=')[::2] for item in items)
    if '' in found or '' in found.values() or len(found) < len(items):
        raise ValueError(f'--{flag}={",".join(items)}: NAME={what} was expected, each name once')
    return found


def settings(items: list[str], types: dict[str, type], flag: str = 'set') -> dict:
    """Name -> value of the values NAME=VALUE of a flag, by the type of every setting there is.
    ValueError for an unknown name, one that is given twice, or a value of another type."""
    found: dict = {}
    for item in items:
        name, equals, text = item.partition('=')
        if not equals or name not in types or name in found:
            reason = 'is given twice' if name in found else 'NAME=VALUE was expected'
            raise ValueError(f'--{flag}={item}: {reason}; names are {", ".join(types)}')
        kind = types[name]
        try:
            found[name] = _TRUTHS[text.lower()] if kind is bool else kind(text)
        except (KeyError, ValueError) as error:
            raise ValueError(f'--{flag}={item}: must be of type {kind.__name__}') from error
    return found


def writable_folder(path: str) -> None:
    """Tries whether results can be written into a folder, which need not exist, and leaves nothing
    behind; OSError where not."""
    missing, above = [], os.path.abspath(path)
    while not os.path.exists(above):
        missing.append(above)
        above = os.path.dirname(above)
    try:
        os.makedirs(path, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
        for folder in missing:
            os.rmdir(folder)
    except OSError as error:
        raise OSError(f'{path}: cannot be written to ({error.strerror})') from error


def import_tensorflow(num_threads: int | None = None) -> None:
    """Imports TensorFlow without the lines that it writes while it starts, and sooner than it does,
    with a number of CPU threads (None: its own choice); ValueError where it is not installed.

    It loads Keras at the end, a sixth of the whole import, which only training needs: it goes
    without where Keras is absent, so it is, meanwhile, and comes when it is first asked for.
    """
    os.environ.setdefault('TF_CPP_MIN_LOG_LEVEL', '2')
    if 'tensorflow' not in sys.modules:
        try:
            with _quiet_stderr(), _absent('keras', 'scipy', 'h5py'):
                import tensorflow  # noqa: F401
        except ModuleNotFoundError as error:
            raise ValueError(
                f'this needs {error.name}, which is not installed: pip install -c constraints.txt '
                f'-e .[cpu]'
            ) from error
    if num_threads:
        import tensorflow as tf

        tf.config.threading.set_intra_op_parallelism_threads(num_threads)
        tf.config.threading.set_inter_op_parallelism_threads(1)


def import_keras() -> None:
    """Imports Keras, for training; scikit-learn and matplotlib, which it loads for wrappers that
    nothing here uses, are a third of its time and that of TensorFlow together."""
    with _absent('sklearn', 'matplotlib'):
        import keras  # noqa: F401


@contextlib.contextmanager
def _absent(*names: str) -> Iterator[None]:
    """Makes packages that are not loaded yet look as if they were not installed."""
    absent = [name for name in names if name not in sys.modules]
    for name in absent:
        sys.modules[name] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        for name in absent:
            sys.modules.pop(name, None)


@contextlib.contextmanager
def _quiet_stderr():
    """Keeps what is written to the error stream back, and shows it where an exception ends the
    block. TensorFlow's C++ part writes to the descriptor itself, before any log level holds."""
    sys.stderr.flush()
    with tempfile.TemporaryFile() as aside:
        terminal = os.dup(2)
        os.dup2(aside.fileno(), 2)
        try:
            yield
        except BaseException:
            aside.seek(0)
            os.write(terminal, aside.read())
            raise
        finally:
            os.dup2(terminal, 2)
            os.close(terminal)
