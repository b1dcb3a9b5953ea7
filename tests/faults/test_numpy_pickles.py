"""A pickle that names nothing but numpy's own functions can still break the process that trusts it.

`numpy.dtype.__setstate__` accepts flags: float64 items marked as references are dereferenced when
the array is freed. Found by fuzzing; the reader therefore calls no function of numpy's pickles.
"""

import pathlib
import subprocess
import sys

import numpy as np
import pytest

from pca_tools import legacy_pickles

ROOT = pathlib.Path(__file__).resolve().parents[2]
# dtype state: version, byte order, subarray, names, fields, item size, alignment, flags.
FLAGS = b'K\x3f'  # 63: all of NPY_ITEM_REFCOUNT ... NPY_NEEDS_PYAPI


def pickled(flags):
    """Protocol 2 by hand: an array of three float64 whose dtype state holds `flags`."""
    dtype = (
        b'cnumpy\ndtype\nX\x02\x00\x00\x00f8\x89\x88\x87R'
        b'(K\x03X\x01\x00\x00\x00<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xff' + flags + b'tb'
    )
    head = b'\x80\x03cnumpy._core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R'
    values = np.array([3.0, 2.0, 1.0]).tobytes()
    data = b'C' + bytes([len(values)]) + values
    return head + b'(K\x01K\x03\x85' + dtype + b'\x89' + data + b'tb.'


@pytest.mark.parametrize('flags', [b'K\x00', FLAGS], ids=['plain', 'references'])
def test_flags_of_a_pickled_type_are_ignored(tmp_path, flags):
    path = tmp_path / 'a.pkl'
    path.write_bytes(pickled(flags))
    code = 'import sys; from pca_tools import legacy_pickles as p; print(p.read_array(sys.argv[1]))'
    done = subprocess.run(
        [sys.executable, '-c', code, str(path)], cwd=ROOT, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, '[3. 2. 1.]\n', '')


@pytest.mark.parametrize(
    'change',
    [
        (b'f8', b'O8'),
        (b'f8', b'f9'),
        (b'<NNN', b'?NNN'),
        (b'K\x01K\x03\x85', b'K\x01K\x04\x85'),
        (b'K\x01K\x03\x85', b'K\x01K\xff\x85'),
        (b'numpy\nndarray', b'builtins\neval'),
    ],
    ids=repr,
)
def test_other_types_shapes_and_names_are_refused(tmp_path, change):
    path = tmp_path / 'a.pkl'
    whole = pickled(b'K\x00')
    assert change[0] in whole
    path.write_bytes(whole.replace(*change))
    with pytest.raises(ValueError, match='a.pkl: is not a pickled numpy array'):
        legacy_pickles.read_array(str(path))
