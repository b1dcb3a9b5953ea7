"""Structures and constants of the C headers, read from the headers themselves.

Python fills `struct lts_model` or `struct lts_field_model` and calls the functions of lts.h and
lts_field.h. The headers are the only place where their fields are listed.
"""

import ctypes
import functools
import os
import re

NATIVE = os.path.join(os.path.dirname(os.path.abspath(__file__)), 'native')

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


@functools.cache
def structures() -> dict[str, type[ctypes.Structure]]:
    """The C structures by name, laid out as the compiler lays them out."""
    found: dict = {}
    for name in _HEADERS:
        for tag, body, typedef in _STRUCT.findall(_COMMENT.sub('', _read(name))):
            fields = [field for part in body.split(';') for field in _fields(part, found)]
            found[tag or typedef] = type(tag or typedef, (ctypes.Structure,), {'_fields_': fields})
    return found


@functools.cache
def constants() -> dict[str, int]:
    """The constants of the headers by name."""
    text = _COMMENT.sub('', ''.join(map(_read, _HEADERS)))
    return {name: int(value) for name, value in _ENUM.findall(text) + _DEFINE.findall(text)}


def _read(name):
    with open(os.path.join(NATIVE, name), encoding='utf-8') as file:
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
