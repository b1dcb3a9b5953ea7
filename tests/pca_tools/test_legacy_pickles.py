"""The restricted unpickler reads numpy arrays and runs nothing."""

import os
import pickle

import numpy as np
import pytest

from pca_tools import legacy_pickles

MARK = 'this_file_must_not_appear'


class Evil:
    """Asks its reader to run a command."""

    def __reduce__(self):
        return os.system, (f'touch {MARK}',)


class Sneaky:
    """Asks for a numpy function that is not on the list."""

    def __reduce__(self):
        return np.fromfile, ('/etc/hostname', np.uint8)


@pytest.mark.parametrize(
    'array', [np.arange(5.0), np.eye(2) * 1j, np.float64(0.25), np.arange(3, dtype=np.int32)]
)
def test_reads_arrays_and_scalars(tmp_path, array):
    path = tmp_path / 'a.pkl'
    for protocol in (3, 4):
        path.write_bytes(pickle.dumps(array, protocol))
        np.testing.assert_array_equal(legacy_pickles.read_array(str(path)), array)


def test_runs_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for evil in (Evil(), [np.arange(3), Evil()], Sneaky()):
        (tmp_path / 'a.pkl').write_bytes(pickle.dumps(evil))
        with pytest.raises(ValueError, match='not a numpy array'):
            legacy_pickles.read_array('a.pkl')
    (tmp_path / 'a.pkl').write_bytes(pickle.dumps(np.array([Evil()], dtype=object)))
    with pytest.raises(ValueError, match='a.pkl'):
        legacy_pickles.read_array('a.pkl')
    assert os.listdir(tmp_path) == ['a.pkl']


def test_other_contents_are_refused(tmp_path):
    path = tmp_path / 'a.pkl'
    for data in (pickle.dumps([1, 2]), pickle.dumps(np.array(['a'])), b'garbage', b'\x80\x03'):
        path.write_bytes(data)
        with pytest.raises(ValueError, match='a.pkl'):
            legacy_pickles.read_array(str(path))


def test_reads_the_authors_files(original):
    eigenvalues = legacy_pickles.read_array(f'{original}/{legacy_pickles.EIGENVALUES_NAME}')
    mean = legacy_pickles.read_array(f'{original}/{legacy_pickles.MEAN_NAME}')
    assert eigenvalues.shape in ((4880,), (6005,)) and mean.shape == ()
    with pytest.raises(ValueError, match='git-lfs pointer'):
        legacy_pickles.read_array(f'{original}/{legacy_pickles.EIGENVECTORS_NAME}')
