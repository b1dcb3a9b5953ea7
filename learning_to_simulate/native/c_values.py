"""Values for C structures: nested dicts, lists and arrays -> a structure in memory -> C text.

A structure is a dict of its fields; a pointer to structures a list of dicts (None for null), a
pointer to numbers an array.
"""

import ctypes
import hashlib

import numpy as np

from learning_to_simulate.native import library

# C number -> its name in C and its dtype in numpy.
_KINDS = {
    ctypes.c_float: ('float', np.float32),
    ctypes.c_double: ('double', np.float64),
    ctypes.c_int32: ('int32_t', np.int32),
}
_ALIGNMENT = 64  # a cache line
_POINTER = type(ctypes.POINTER(ctypes.c_float))


class Structure:
    """A C structure of a type `name` in memory (`value`, a `ctypes.Structure`), with everything
    that it points to; fields that are left out are zero. ValueError for a field that the type has
    not."""

    def __init__(self, name: str, values: dict):
        self.name = name
        self._pointed: dict[int, np.ndarray | ctypes.Array] = {}  # address -> what lies there
        self.value = self._made(library.structures()[name], values)

    def _made(self, kind, values):
        fields = dict(kind._fields_)
        if unknown := values.keys() - fields.keys():
            raise ValueError(f'{kind.__name__} has no fields {sorted(unknown)}')
        result = kind()
        for name, value in values.items():
            if value is not None:
                setattr(result, name, self._field(fields[name], value))
        return result

    def _field(self, kind, value):
        if kind is ctypes.c_char_p:
            return value.encode()
        if isinstance(kind, _POINTER):
            return self._pointer(kind, value)
        if issubclass(kind, ctypes.Array):
            return kind(*(self._field(kind._type_, item) for item in value))
        return self._made(kind, value) if isinstance(value, dict) else value

    def _pointer(self, kind, value):
        if not np.size(value):
            return None
        if kind._type_ in _KINDS:
            array = aligned(value, _KINDS[kind._type_][1])
            pointer = array.ctypes.data_as(kind)
        else:
            array = (kind._type_ * len(value))(*(self._made(kind._type_, x) for x in value))
            pointer = ctypes.cast(array, kind)
        self._pointed[_address(pointer)] = array
        return pointer

    def source(self, symbol: str) -> str:
        """C text that defines the structure and all that it points to; equal arrays are written
        once. Numbers come back bit by bit; ValueError for one that is not finite."""
        lines: list[str] = []
        names: dict[str, str] = {}  # definition of an array -> its name

        def text(kind, value):
            if kind is ctypes.c_char_p:
                plain = (value or b'').decode().replace('\\', '\\\\').replace('"', '\\"')
                return f'"{plain}"'
            if isinstance(kind, _POINTER):
                return array_of(kind._type_, self._pointed[_address(value)]) if value else '0'
            if issubclass(kind, ctypes.Array):
                return '{' + ', '.join(text(kind._type_, item) for item in value) + '}'
            if issubclass(kind, ctypes.Structure):
                parts = (f'.{n} = {text(k, getattr(value, n))}' for n, k in kind._fields_)
                return '{' + ', '.join(parts) + '}'
            return number(value, kind)

        def array_of(kind, values):
            c_type, align = kind.__name__, ''
            if kind in _KINDS:
                c_type, align = _KINDS[kind][0], 'LTS_ALIGNED '
                values = values.reshape(-1)
            texts = [text(kind, value) for value in values]
            body = ',\n'.join(','.join(texts[i : i + 12]) for i in range(0, len(texts), 12))
            if (key := c_type + body) not in names:
                names[key] = f'a{len(names)}'
                lines.append(f'{align}static const {c_type} {names[key]}[] = {{{body}}};')
            return names[key]

        body = text(type(self.value), self.value)
        return '\n'.join([*lines, f'const {self.name} {symbol} = {body};', ''])


def _address(pointer):
    return ctypes.addressof(pointer.contents)


def aligned(values, dtype) -> np.ndarray:
    """A contiguous copy whose first byte begins a cache line."""
    values = np.asarray(values, dtype)
    room = np.empty(values.nbytes + _ALIGNMENT, np.uint8)
    first = -room.ctypes.data % _ALIGNMENT
    array = room[first : first + values.nbytes].view(dtype).reshape(values.shape)
    array[...] = values
    return array


def number(value, kind) -> str:
    """A number as C text, which a compiler reads back bit by bit; ValueError for one that is not
    finite."""
    if kind is ctypes.c_int32:
        return str(int(value))
    if not np.isfinite(value):
        raise ValueError(f'a model holds {value}, which has no place in C source')
    text = repr(float(value)) if kind is ctypes.c_double else str(np.float32(value))
    if not any(c in text for c in '.en'):
        text += '.0'
    return text + ('' if kind is ctypes.c_double else 'f')


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
