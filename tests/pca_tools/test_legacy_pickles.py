"""The restricted unpickler reads numpy arrays and runs nothing."""

import os
import pickle
import pickletools
import subprocess
import sys

import numpy as np
import pytest

from pca_tools import legacy_pickles
from tests.pca_tools.commands import REPOSITORY


class Evil:
    """Asks its reader to run a command."""

    def __reduce__(self):
        return os.system, ('touch this_file_must_not_appear',)


class Sneaky:
    """Asks for a numpy function that is not on the list."""

    def __reduce__(self):
        return np.fromfile, ('/etc/hostname', np.uint8)


def read(path, data):
    path.write_bytes(data)
    return legacy_pickles.read_array(str(path))


@pytest.mark.parametrize(
    'array', [np.arange(5.0), np.eye(2) * 1j, np.float64(0.25), np.arange(3, dtype=np.int32)]
)
def test_reads_arrays_and_scalars(tmp_path, array):
    for protocol in (3, 4):
        found = read(tmp_path / 'a.pkl', pickle.dumps(array, protocol))
        np.testing.assert_array_equal(found, array)


def test_reads_the_authors_files(original):
    eigenvalues = legacy_pickles.read_array(f'{original}/{legacy_pickles.EIGENVALUES_NAME}')
    assert eigenvalues.shape in ((4880,), (6005,))
    with pytest.raises(ValueError, match='git-lfs pointer'):
        legacy_pickles.read_array(f'{original}/{legacy_pickles.EIGENVECTORS_NAME}')


def test_object_arrays_give_arrays_and_nothing_else(tmp_path):
    held = np.empty((2, 2), dtype=object)
    held[0] = np.arange(3.0), 5
    held[1] = np.float32([1, 2]), (np.int64(7), [1.5])
    (first, five), (second, pair) = legacy_pickles.parse_objects(pickle.dumps(held), 'here')
    assert first.tolist() == [0, 1, 2] and five == 5 and second.dtype == np.float32
    assert pair[0] == 7 and pair[1] == [1.5]
    held[1, 1] = 'text'
    with pytest.raises(ValueError, match='here: .*holds str'):
        legacy_pickles.parse_objects(pickle.dumps(held), 'here')


PLAIN = pickle.dumps(np.array([3.0, 2.0, 1.0]), 3)
# dtype state: version, byte order, subarray, names, fields, item size, alignment, flags; 63 is all
# of NPY_ITEM_REFCOUNT ... NPY_NEEDS_PYAPI.
STATE_END = b'J\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00'
REFERENCES = PLAIN.replace(STATE_END, STATE_END[:-1] + b'\x3f')


@pytest.mark.parametrize('data', [PLAIN, REFERENCES], ids=['plain', 'references'])
def test_flags_of_a_pickled_type_are_ignored(tmp_path, data):
    """float64 items marked as references are dereferenced when numpy frees the array. Found by
    fuzzing; the reader therefore calls no function of numpy's pickles."""
    path = tmp_path / 'a.pkl'
    path.write_bytes(data)
    assert PLAIN != REFERENCES
    code = 'import sys; from pca_tools import legacy_pickles as p; print(p.read_array(sys.argv[1]))'
    program = [sys.executable, '-c', code, str(path)]
    done = subprocess.run(program, cwd=REPOSITORY, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, '[3. 2. 1.]\n', '')


CODES = {opcode.name: opcode.code.encode('latin-1') for opcode in pickletools.opcodes}
REFUSED = [
    *(
        (pickle.dumps(evil), 'not a numpy array')
        for evil in (Evil(), Sneaky(), [np.arange(3), Evil()], np.array([Evil()], dtype=object))
    ),
    # LONG_BINPUT of a huge place: 12 bytes that took 4.2 GB and 87 s.
    (b'\x80\x02Nr\xff\xff\xff\x1f.', 'fills place 536870911 of its memory after 0 others'),
    # BUILD on a class sets its attributes for the whole process, unless the class refuses.
    (b'\x80\x02cnumpy.core.multiarray\nscalar\n(N}X\x05\x00\x00\x00arrayNstb.', 'uses EMPTY_DICT'),
    *(
        (b'\x80\x02N' + CODES[name] + b'\x01\n.', f'uses {name}')
        for name in ('NEXT_BUFFER', 'PERSID', 'OBJ', 'EXT1', 'SETITEM')
    ),
    # Other types, shapes and names.
    *(
        (PLAIN.replace(*change), 'is not a pickled numpy array')
        for change in (
            (b'f8', b'O8'), (b'f8', b'f9'), (b'\x00<', b'\x00?'), (b'K\x03\x85', b'K\x04\x85'),
            (b'K\x03\x85', b'K\xff\x85'), (b'numpy\nndarray', b'builtins\neval'),
        )
    ),
]  # fmt: skip


@pytest.mark.parametrize(('data', 'text'), REFUSED, ids=range(len(REFUSED)))
def test_anything_else_is_refused_and_nothing_is_run_or_changed(tmp_path, monkeypatch, data, text):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / 'a.pkl'
    with pytest.raises(ValueError, match=f'a.pkl: .*{text}'):
        read(path, data)
    assert data != PLAIN and os.listdir(tmp_path) == ['a.pkl']
    assert read(path, pickle.dumps(np.float64(2.5))) == 2.5
