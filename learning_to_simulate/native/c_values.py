"""Values for C structures: nested dicts, lists and arrays -> ctypes, or C text.

A structure is a dict of its fields; a pointer to structures a list of dicts (None for null), a
pointer to numbers an array.
"""

import ctypes
import hashlib

import numpy as np

from learning_to_simulate.native import library

_DTYPES = {ctypes.c_float: np.float32, ctypes.c_double: np.float64, ctypes.c_int32: np.int32}
_C_NAMES = {ctypes.c_float: 'float', ctypes.c_double: 'double', ctypes.c_int32: 'int32_t'}
_ALIGNMENT = 64
_POINTER = type(ctypes.POINTER(ctypes.c_float))


def _parts(kind):
    return dict(kind._fields_)


def _check_fields(kind, values):
    if unknown := values.keys() - _parts(kind).keys():
        raise ValueError(f'{kind.__name__} has no fields {sorted(unknown)}')


def digest(values) -> str:
    """sha256 of a tree of values."""
    total = hashlib.sha256()

    def add(value):
        if isinstance(value, dict):
            for name in sorted(value):
                total.update(name.encode())
                add(value[name])
        elif isinstance(value, (list, tuple)):
            total.update(f'[{len(value)}]'.encode())
            for item in value:
                add(item)
        elif isinstance(value, np.ndarray):
            total.update(f'{value.shape}{value.dtype}'.encode())
            total.update(np.ascontiguousarray(value).tobytes())
        else:
            total.update(repr(value).encode())

    add(values)
    return total.hexdigest()


class Structure:
    """A C structure in memory, with everything that it points to.

    Args:
      name: of the C type.
      values: its fields; those left out are zero.

    Attributes:
      value: the `ctypes.Structure`.
    """

    def __init__(self, name: str, values: dict):
        self._alive: list = []
        self.value = self._structure(library.structures()[name], values)

    def _structure(self, kind, values):
        _check_fields(kind, values)
        result = kind()
        for name, part in _parts(kind).items():
            if values.get(name) is not None:
                setattr(result, name, self._field(part, values[name]))
        return result

    def _field(self, kind, value):
        if kind is ctypes.c_char_p:
            return value.encode()
        if isinstance(kind, _POINTER):
            return self._pointer(kind, value)
        if issubclass(kind, ctypes.Array):
            return kind(*(self._structure(kind._type_, item) for item in value))
        return self._structure(kind, value) if isinstance(value, dict) else value

    def _pointer(self, kind, value):
        of = kind._type_
        if of in _DTYPES:
            array = aligned(value, _DTYPES[of])
            self._alive.append(array)
            return array.ctypes.data_as(kind) if array.size else None
        array = (of * len(value))(*(self._structure(of, item) for item in value))
        self._alive.append(array)
        return ctypes.cast(array, kind) if len(value) else None


def aligned(values, dtype) -> np.ndarray:
    """A contiguous copy whose first byte begins a cache line."""
    values = np.asarray(values, dtype)
    room = np.empty(values.nbytes + _ALIGNMENT, np.uint8)
    first = -room.ctypes.data % _ALIGNMENT
    array = room[first : first + values.nbytes].view(dtype).reshape(values.shape)
    array[...] = values
    return array


class Source:
    """C text that defines a structure and all that it points to; equal arrays are written once."""

    def __init__(self):
        self._lines: list[str] = []
        self._arrays: dict[tuple, str] = {}

    def define(self, c_type: str, symbol: str, values: dict) -> str:
        """The definitions, the last one `const <c_type> <symbol>`."""
        body = self._structure(library.structures()[c_type], values)
        return '\n'.join([*self._lines, f'const {c_type} {symbol} = {body};', ''])

    def _structure(self, kind, values):
        _check_fields(kind, values)
        parts = [
            f'.{name} = {self._field(part, values[name])}'
            for name, part in _parts(kind).items()
            if values.get(name) is not None
        ]
        return '{' + ', '.join(parts) + '}'

    def _field(self, kind, value):
        if kind is ctypes.c_char_p:
            text = value.replace('\\', '\\\\').replace('"', '\\"')
            return f'"{text}"'
        if isinstance(kind, _POINTER):
            return self._pointer(kind._type_, value)
        if issubclass(kind, ctypes.Array):
            return '{' + ', '.join(self._structure(kind._type_, item) for item in value) + '}'
        if isinstance(value, dict):
            return self._structure(kind, value)
        return _number(value, kind)

    def _pointer(self, of, value):
        if not len(value):
            return '0'
        if of in _DTYPES:
            flat = np.asarray(value, _DTYPES[of]).reshape(-1)
            texts = [_number(v, of) for v in flat]
            body = ',\n'.join(','.join(texts[i : i + 12]) for i in range(0, len(texts), 12))
            return self._array(_C_NAMES[of], 'LTS_ALIGNED ', body)
        body = ',\n'.join(self._structure(of, item) for item in value)
        return self._array(of.__name__, '', body)

    def _array(self, c_type, prefix, body):
        key = c_type, hashlib.sha256(body.encode()).digest()
        if key not in self._arrays:
            self._arrays[key] = f'a{len(self._arrays)}'
            self._lines.append(f'{prefix}static const {c_type} {self._arrays[key]}[] = {{{body}}};')
        return self._arrays[key]


def _number(value, kind):
    """A number that a C compiler reads back bit by bit."""
    if kind is ctypes.c_int32:
        return str(int(value))
    if not np.isfinite(value):
        raise ValueError(f'a model holds {value}, which has no place in C source')
    text = repr(float(value)) if kind is ctypes.c_double else str(np.float32(value))
    if not any(c in text for c in '.en'):
        text += '.0'
    return text + ('' if kind is ctypes.c_double else 'f')
