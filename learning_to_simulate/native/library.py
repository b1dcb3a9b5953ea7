"""The C library: compiled once per machine and loaded by ctypes; structures and constants are read
from its headers, which are the only place where they are listed."""

import ctypes
import functools
import glob
import hashlib
import importlib.util
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import tempfile

from pca_tools import files

SOURCES = os.path.join(os.path.dirname(os.path.abspath(__file__)), 'c')
FLAGS = ('-std=c99', '-O3', '-fPIC', '-shared', '-fvisibility=hidden')

_HEADERS = (
    'include/lts.h', 'src/lts_model.h', 'include/lts_field.h', 'src/lts_field_model.h',
)  # fmt: skip
_NUMBERS = {
    'int32_t': ctypes.c_int32,
    'uint32_t': ctypes.c_uint32,
    'double': ctypes.c_double,
    'float': ctypes.c_float,
}
_STRUCT = re.compile(r'(?:typedef struct|struct (\w+)) \{(.*?)\}\s*(\w*);', re.DOTALL)
_COMMENT = re.compile(r'/\*.*?\*/', re.DOTALL)
_ENUM = re.compile(r'(LTS_\w+)\s*=\s*(-?\d+)')
_DEFINE = re.compile(r'#define (LTS_\w+) (\d+)')


class NoCompiler(RuntimeError):
    """There is no C compiler, or the library cannot be kept or loaded here."""


class CompileFailed(ValueError):
    """There is a C compiler, and it cannot compile the sources."""


def compiler() -> list[str]:
    """A C compiler and its first arguments: $CC, or the first of cc, gcc and clang, or that of the
    package `ziglang`.

    Raises:
      NoCompiler: there is none.
      ValueError: a $CC whose quotes do not close.
    """
    named = os.environ.get('CC', '').strip()
    for name, *more in [shlex.split(named)] if named else [['cc'], ['gcc'], ['clang']]:
        if path := shutil.which(name):
            return [path, *more]
    if not named and importlib.util.find_spec('ziglang'):
        return [sys.executable, '-m', 'ziglang', 'cc']
    wanted = f'$CC is {named!r}, which' if named else 'none of cc, gcc and clang'
    raise NoCompiler(
        f'no C compiler: {wanted} is on the path; install one (apt '
        f'install gcc, or pip install ziglang)'
    )


def compile_sources(output: str, project: str, flags=FLAGS, extra_sources=()) -> None:
    """Compiles the C files of a project into a shared library, whole or not at all.

    Args:
      output: path of the library.
      project: folder with `include` and `src`.
      flags: of the compiler.
      extra_sources: more C files.

    Raises:
      NoCompiler: there is none.
      CompileFailed: it fails; with what it said.
    """
    include, src = (os.path.join(project, part) for part in ('include', 'src'))
    _compile(output, [include, src], [*_c_files(src), *extra_sources], flags)


def compile_flat(output: str, folder: str, flags=FLAGS) -> None:
    """The same for a folder that holds all sources and headers."""
    _compile(output, [folder], _c_files(folder), flags)


def _c_files(folder):
    return sorted(glob.glob(os.path.join(folder, '*.c')))


def _compile(output, include, sources, flags):
    def build(name):
        include_flags = [f'-I{folder}' for folder in include]
        command = [*compiler(), *flags, *include_flags, *sources, '-o', name, '-lm']
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise CompileFailed(f'{shlex.join(command)} failed:\n{done.stderr[-2000:]}')

    files.write_atomically(output, build)


@functools.cache
def load() -> ctypes.CDLL:
    """The library of this machine, compiled at the first call of all and kept in the user's cache.

    Raises:
      NoCompiler: it is not there and there is no compiler, or it cannot be loaded.
      CompileFailed: as `compile_sources`.
    """
    # A home may be shared by machines of several kinds.
    content = hashlib.sha256(repr((FLAGS, platform.machine())).encode())
    for path in sorted(glob.glob(os.path.join(SOURCES, '*', '*'))):
        with open(path, 'rb') as file:
            content.update(file.read())
    path = os.path.join(_cache_folder(), f'lts-{content.hexdigest()[:16]}.so')
    try:
        if not os.path.exists(path):
            try:
                os.makedirs(os.path.dirname(path), exist_ok=True)
                compile_sources(path, SOURCES)
            except OSError:  # a home that cannot be written
                return load_once()
        return declared(ctypes.CDLL(path))
    except OSError as error:  # of another processor, or on a disk that runs no programs
        raise NoCompiler(f'{path}: the C library cannot be loaded ({error})') from error


def load_once(flags=FLAGS, extra_sources=()) -> ctypes.CDLL:
    """The library, compiled for this process alone; arguments and errors as of `compile_sources`.

    Raises:
      OSError: no place for it, or it cannot be loaded.
    """
    # Once loaded it needs no file; where one that is in use cannot go, it stays.
    with tempfile.TemporaryDirectory(prefix='lts-', ignore_cleanup_errors=True) as folder:
        path = os.path.join(folder, 'lts.so')
        compile_sources(path, SOURCES, flags, extra_sources)
        return declared(ctypes.CDLL(path))


def _cache_folder():
    base = os.environ.get('XDG_CACHE_HOME') or os.path.expanduser('~/.cache')
    return os.path.join(base, 'learning_to_simulate')


def declared(library: ctypes.CDLL) -> ctypes.CDLL:
    """Gives the functions their types, so that ctypes refuses what C would not survive.

    Raises:
      AttributeError: a library of neither kind of models.
    """
    pointer, size, number, real = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_double
    bytes_of = pointer, pointer, size
    of_all = {
        'describe': (pointer, pointer),
        'init': (pointer, pointer, size, number, ctypes.POINTER(pointer)),
        'kernel': (pointer,),
        'advance': (pointer, real, pointer, pointer, pointer),
        'particles': bytes_of,
        'height_map': (pointer, pointer, pointer),
        'judge': (pointer, pointer),
        'save': bytes_of,
        'load': bytes_of,
        'clone': (pointer, pointer),
    }
    of_graph = {
        'reset': (pointer, pointer, pointer),
        'start': (pointer, number, pointer, pointer, pointer),
        'start_pose': (pointer, number, pointer),
        'start_context': (pointer, number, pointer),
        'prepare': (pointer,),
        'set_context': (pointer, pointer),
        'frame': (pointer, pointer, pointer),
        'frame_at': (pointer, pointer, pointer),
        'modes': (pointer, pointer),
        'points': (pointer, pointer),
    }
    of_field = {
        'members': (pointer, number, number),
        'start': (pointer, pointer, pointer, pointer, real),
        'start_wheel': (pointer, number, *4 * (pointer,)),
        'start_pose': (pointer, number, pointer),
        'start_context': (pointer, number, pointer),
        'set_context': (pointer, pointer),
        'context': (pointer, pointer),
        'renew': (pointer,),
        'frame': (pointer, pointer, real, pointer),
        'newest': (pointer, pointer),
        'moving': (pointer,),
    }
    kinds = [('lts_', of_graph), ('lts_field_', of_field)]
    kinds = [(prefix, more) for prefix, more in kinds if hasattr(library, f'{prefix}init')]
    for prefix, more in kinds:
        for name, types in (of_all | more).items():
            getattr(library, prefix + name).argtypes = types
            getattr(library, prefix + name).restype = number
        for name in ('size', 'state_size'):
            getattr(library, prefix + name).argtypes = (pointer,)
            getattr(library, prefix + name).restype = size
    library.lts_error_text.argtypes = (number,)
    library.lts_error_text.restype = ctypes.c_char_p
    return library


@functools.cache
def structures() -> dict[str, type[ctypes.Structure]]:
    """The C structures by name, laid out as the compiler lays them out."""
    found: dict = {}
    for name in _HEADERS:
        for tag, body, typedef in _STRUCT.findall(_COMMENT.sub('', _header(name))):
            fields = [field for part in body.split(';') for field in _fields(part, found)]
            found[tag or typedef] = type(tag or typedef, (ctypes.Structure,), {'_fields_': fields})
    return found


@functools.cache
def constants() -> dict[str, int]:
    """The constants of the headers by name."""
    text = _COMMENT.sub('', ''.join(map(_header, _HEADERS)))
    return {name: int(value) for name, value in _ENUM.findall(text) + _DEFINE.findall(text)}


def _header(name):
    with open(os.path.join(SOURCES, name), encoding='utf-8') as file:
        return file.read()


def _fields(declaration, known):
    """(name, ctype) of each field of one C declaration."""
    words = declaration.split(None, 1)
    if not words:
        return
    if words[0] == 'const':
        words = words[1].split(None, 1)
    base, names = words
    for name in names.split(','):
        name, kind = name.strip(), known.get(base) or _NUMBERS.get(base)
        if name.startswith('*'):
            name, kind = name[1:], ctypes.c_char_p if base == 'char' else ctypes.POINTER(kind)
        while match := re.fullmatch(r'(\w+)\[(\w+)\](.*)', name):
            name, kind = match[1] + match[3], kind * int(match[2])
        yield name, kind
