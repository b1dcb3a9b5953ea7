"""The order of the files, and what is compiled.

A test of a network spends most of its time in XLA's compiler. So tests run functions as traced;
those marked `xla` compile them, as users and commands in processes of their own do, with few
optimisations. C is compiled in a quarter of the time that it takes for users, to the same bits."""

import contextlib
import functools
import os
import sys

import pytest

from learning_to_simulate.native import library

os.environ.setdefault('XLA_FLAGS', '--xla_backend_optimization_level=0')
_is_compiled = True


def pytest_collection_modifyitems(items):
    """A process that is given a slow file at the end works alone for a minute. Files go to
    processes in the order of collection (`run_scripts/test.sh`): the first compiles the solver, the
    one with faults, which needs it, comes when it is compiled."""
    slow = {item.path for item in items if item.get_closest_marker('slow')}
    items.sort(key=lambda item: (item.path not in slow, 'faults' in item.path.parts))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    global _is_compiled
    _is_compiled = item.get_closest_marker('xla') is not None
    tf = sys.modules.get('tensorflow')
    if tf is None or hasattr(tf.function, 'by_xla'):
        return
    function = tf.function

    @functools.wraps(function)
    def traced(*args, jit_compile=None, **settings):
        return function(*args, jit_compile=jit_compile if _is_compiled else None, **settings)

    traced.by_xla = function
    tf.function = traced


@pytest.fixture(scope='session', autouse=True)
def quick_c():
    with contextlib.suppress(library.NoCompiler):
        library.load()  # in the user's cache, as it should be
    flags = [flag.replace('-O3', '-O0') for flag in library.FLAGS]
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(library.compile_sources.__kwdefaults__, 'flags', flags)
        yield
