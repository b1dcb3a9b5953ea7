"""The C header as Python reads it, and values on their way to C."""

import ctypes
import os
import subprocess

import numpy as np
import pytest

from learning_to_simulate.native import c_values, library
from tests.learning_to_simulate.native import worlds


@worlds.needs_c
def test_structures_are_laid_out_as_the_compiler_lays_them_out(tmp_path):
    lines = [
        '#include <stdio.h>',
        '#include <stddef.h>',
        '#include "lts_model.h"',
        '#include "lts_soil_model.h"',
        'int main(void) {',
    ]
    expected = []
    for name, kind in library.structures().items():
        tagged = ('lts_model', 'lts_soil_model')
        c_name = f'struct {name}' if name in tagged else name
        lines.append(f'  printf("%zu\\n", sizeof({c_name}));')
        expected.append(ctypes.sizeof(kind))
        for field, _ in kind._fields_:
            lines.append(f'  printf("%zu\\n", offsetof({c_name}, {field}));')
            expected.append(getattr(kind, field).offset)
    (tmp_path / 'sizes.c').write_text('\n'.join([*lines, '  return 0;\n}\n']))
    include = [f'-I{os.path.join(library.SOURCES, part)}' for part in ('include', 'src')]
    program = str(tmp_path / 'sizes')
    subprocess.run(
        [*library.compiler(), *include, str(tmp_path / 'sizes.c'), '-o', program], check=True
    )
    printed = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    assert list(map(int, printed.split())) == expected


def test_numbers_come_back_bit_by_bit():
    rng = np.random.default_rng(0)
    bits = rng.integers(0, 2**32, 4000, dtype=np.uint32).view(np.float32)
    for value in bits[np.isfinite(bits)]:
        text = c_values.number(value, ctypes.c_float)
        assert text.endswith('f') and np.float32(text[:-1]) == value
    for value in (0.1, 1e-300, -3.0, 1 / 3):
        assert float(c_values.number(value, ctypes.c_double)) == value
    with pytest.raises(ValueError, match='nan'):
        c_values.number(np.nan, ctypes.c_float)


def test_unknown_fields_are_refused_and_digests_follow_the_numbers():
    with pytest.raises(ValueError, match="no fields \\['colour'\\]"):
        c_values.Structure('lts_dense', {'rows': 1, 'colour': 2})
    values = {'rows': 2, 'w': np.arange(3.0)}
    other = values | {'w': np.array([0.0, 1.0, np.nextafter(2.0, 3.0)])}
    assert c_values.digest(values) == c_values.digest(dict(reversed(values.items())))
    assert c_values.digest(values) != c_values.digest(other)
