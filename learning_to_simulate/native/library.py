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
ZIG = [sys.executable, '-m', 'ziglang', 'cc']  # of the package `ziglang`

_HEADERS = ('include/lts.h', 'src/lts_model.h', 'include/lts_soil.h', 'src/lts_soil_model.h')
_NUMBERS = {
    'int': ctypes.c_int,
    'size_t': ctypes.c_size_t,
    'int32_t': ctypes.c_int32,
    'uint32_t': ctypes.c_uint32,
    'double': ctypes.c_double,
    'float': ctypes.c_float,
}
_STRUCT = re.compile(r'(?:typedef struct|struct (\w+)) \{(.*?)\}\s*(\w*);', re.DOTALL)
_CALL = re.compile(r'LTS_API (const char \*|\w+ )(lts_\w+)\(([^)]*)\)')
_CONSTANT = re.compile(r'(?:#define )?(LTS_\w+)(?:\s*=)? +(-?\d+)\b')


class NoCompiler(RuntimeError):
    """There is no C compiler, or the library cannot be kept or loaded here."""


class CompileFailed(ValueError):
    """There is a C compiler, and it cannot compile the sources."""


def compiler() -> list[str]:
    """A C compiler and its first arguments: $CC, or the first of cc, gcc and clang, or that of the
    package `ziglang`; NoCompiler where there is none, ValueError for a $CC whose quotes do not
    close."""
    named = os.environ.get('CC', '').strip()
    for name, *more in [shlex.split(named)] if named else [['cc'], ['gcc'], ['clang']]:
        if path := shutil.which(name):
            return [path, *more]
    if not named and importlib.util.find_spec('ziglang'):
        return ZIG
    wanted = f'$CC is {named!r}, which' if named else 'none of cc, gcc and clang'
    raise NoCompiler(
        f'no C compiler: {wanted} is on the path; install one (apt '
        f'install gcc, or pip install ziglang)'
    )


def compile_sources(output: str, *folders: str, flags=FLAGS, command=None) -> None:
    """Compiles all C files of folders with sources and headers into a shared library, whole or not
    at all; by the `command` of a compiler, None for that of `compiler`.

    Raises:
      NoCompiler: there is none.
      CompileFailed: it fails; with what it said.
    """

    def build(name):
        include = [f'-I{folder}' for folder in folders]
        sources = sorted(path for folder in folders for path in glob.glob(f'{folder}/*.c'))
        whole = [*(command or compiler()), *flags, *include, *sources, '-o', name, '-lm']
        done = subprocess.run(whole, capture_output=True, text=True)
        if done.returncode:
            raise CompileFailed(f'{shlex.join(whole)} failed:\n{done.stderr[-2000:]}')

    files.write_atomically(output, build)


def parts_of(project: str) -> list[str]:
    """The folders of a project that `compile_sources` takes."""
    return [os.path.join(project, part) for part in ('include', 'src')]


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
    base = os.environ.get('XDG_CACHE_HOME') or os.path.expanduser('~/.cache')
    path = os.path.join(base, 'learning_to_simulate', f'lts-{content.hexdigest()[:16]}.so')
    try:
        if not os.path.exists(path):
            try:
                os.makedirs(os.path.dirname(path), exist_ok=True)
                compile_sources(path, *parts_of(SOURCES))
            except OSError:  # a home that cannot be written
                return load_once()
        return declared(ctypes.CDLL(path))
    except OSError as error:  # of another processor, or on a disk that runs no programs
        raise NoCompiler(f'{path}: the C library cannot be loaded ({error})') from error


def load_once() -> ctypes.CDLL:
    """The library, compiled for this process alone; raises as `compile_sources`, and OSError where
    there is no place for it or it cannot be loaded."""
    # Once loaded it needs no file; where one that is in use cannot go, it stays.
    with tempfile.TemporaryDirectory(prefix='lts-', ignore_cleanup_errors=True) as folder:
        path = os.path.join(folder, 'lts.so')
        compile_sources(path, *parts_of(SOURCES))
        return declared(ctypes.CDLL(path))


def declared(library: ctypes.CDLL) -> ctypes.CDLL:
    """Gives functions the types of the headers, so that ctypes refuses what C would not survive;
    AttributeError for another library."""
    library.lts_error_text.restype = ctypes.c_char_p  # that of the project, or AttributeError
    for result, name, arguments in _CALL.findall(_headers()):
        if hasattr(library, name):  # an exported library has the functions of one kind of models
            function = getattr(library, name)
            function.restype = _type_of(result)
            function.argtypes = [_type_of(a) for a in arguments.split(',')]
    return library


def _type_of(declaration):
    """The ctype of a parameter or a result; of any pointer to data `c_void_p`."""
    if declaration == 'const char *':
        return ctypes.c_char_p
    return ctypes.c_void_p if '*' in declaration else _NUMBERS[declaration.split()[0]]


@functools.cache
def structures() -> dict[str, type[ctypes.Structure]]:
    """The C structures by name, laid out as the compiler lays them out."""
    found: dict = {}
    for tag, body, typedef in _STRUCT.findall(_headers()):
        fields = [field for part in body.split(';') for field in _fields(part, found)]
        found[tag or typedef] = type(tag or typedef, (ctypes.Structure,), {'_fields_': fields})
    return found


def tool_numbers(tool) -> list[float]:
    """Of a tool of a soil field, in the order of `lts_soil_tool`."""
    names = (name for name, _ in structures()['lts_soil_tool']._fields_)  # type: ignore[misc]
    return [float(getattr(tool, name, 0.0)) for name in names]


@functools.cache
def constants() -> dict[str, int]:
    """The constants of the headers by name."""
    return {name: int(value) for name, value in _CONSTANT.findall(_headers())}


@functools.cache
def _headers():
    texts = []
    for name in _HEADERS:
        with open(os.path.join(SOURCES, name), encoding='utf-8') as file:
            texts.append(re.sub(r'/\*.*?\*/', '', file.read(), flags=re.DOTALL))
    return ''.join(texts)


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
