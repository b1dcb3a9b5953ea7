"""Data folders: bombs, hostile arrays, full disks, a reader beside a writer."""

import re
import threading
import zipfile

import numpy as np
import pytest

from learning_to_simulate.scene import RigidMotion, Scene
from learning_to_simulate.subspace import edge_lists
from nri import data as nri_data
from pca_tools import dataset, files, tfrecord_io
from pca_tools.formats import full_space, lagrangebench
from tests.faults.test_training_state import files_up_to
from tests.learning_to_simulate import synthetic

MARK = 'this_file_must_not_appear'


class Evil:
    """Asks whoever unpickles it to make a file."""

    def __reduce__(self):
        return open, (MARK, 'w')


def test_bombs_are_refused_by_what_their_directory_says(tmp_path):
    """Five members that claim 300 MB each: none of them is over the limit, all together are."""
    path = tmp_path / 'bomb.npz'
    np.savez_compressed(path, **{f'a{i}': np.zeros(9) for i in range(5)})
    data = bytearray(path.read_bytes())
    for entry in re.finditer(b'PK\x01\x02', bytes(data)):
        data[entry.start() + 24 : entry.start() + 28] = (3 * 10**8).to_bytes(4, 'little')
    path.write_bytes(data)
    with pytest.raises(ValueError, match='bomb.npz.*unpacks to 1500000000 bytes.*limit'):
        files.read_npz(str(path))


@pytest.mark.parametrize(
    'read', [edge_lists.read_mask, lambda path: nri_data._read_array(path, 4), files.read_npy]
)
def test_hostile_npy_files(tmp_path, read, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / 'a.npy'
    with open(path, 'wb') as file:
        np.lib.format.write_array(file, np.array([Evil()], object))
    with pytest.raises(ValueError, match='a.npy.*Python objects'):
        read(str(path))
    with zipfile.ZipFile(tmp_path / 'evil.npz', 'w') as archive:
        archive.write(path, 'evil.npy')
    with pytest.raises(ValueError, match='evil.npz.*Python objects'):
        files.read_npz('evil.npz')
    assert not (tmp_path / MARK).exists()
    with open(path, 'wb') as file:
        header = {'descr': '|u1', 'fortran_order': False, 'shape': (10**6, 10**6)}
        np.lib.format.write_array_header_1_0(file, header)
        file.write(bytes(100))
    with pytest.raises(ValueError, match=r'a.npy.*1000000000000 bytes but it holds 100'):
        read(str(path))


@pytest.mark.parametrize('ending', ['npz', 'json', 'tfrecord'])
def test_full_disk_leaves_the_old_file(tmp_path, ending):
    path = tmp_path / f'a.{ending}'
    values = np.random.default_rng(0).random(40_000)
    write = {
        'npz': lambda values: files.write_npz(str(path), a=values),
        'json': lambda values: files.write_json(str(path), values.tolist()),
        'tfrecord': lambda values: tfrecord_io.write_records(
            str(path), [tfrecord_io.SequenceRecord.of(0, np.arange(3), {'position': values})]
        ),
    }[ending]
    write(values[:10])
    before = path.read_bytes()
    with files_up_to(100_000), pytest.raises(OSError, match=path.name):
        write(values)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    assert path.read_bytes() == before


def test_reader_beside_a_writer_sees_one_version_or_the_other(tmp_path):
    """A dataset that is replaced again and again is read whole, old or new, or refused."""
    path = str(tmp_path / 'set')

    def fill(value):
        def write(folder):
            synthetic.write_dataset(folder, n_run=1 + value)
            names = ['metadata.json', 'train.tfrecord', 'valid.tfrecord', 'test.tfrecord']
            files.write_manifest(folder, {name: {} for name in names})

        return write

    files.write_folder_atomically(path, fill(0))
    counts, refused, stop = set(), 0, threading.Event()

    def write():
        for round_ in range(6):
            files.write_folder_atomically(path, fill(round_ % 2))
        stop.set()

    writer = threading.Thread(target=write)
    writer.start()
    while not stop.is_set():
        try:
            counts.add(len(dataset.read_split(path, 'train')))
        except (ValueError, OSError):  # between the two renames, or with files of both
            refused += 1
    writer.join()
    assert counts <= {1, 2} and len(counts) + refused
    assert len(dataset.read_split(path, 'train')) == 2


def test_members_that_a_damaged_directory_lost_are_missed(tmp_path):
    """One bit in the length of an entry swallows those after it; the rest has right checksums."""
    path = tmp_path / 'a.npz'
    np.savez(path, first=np.arange(3.0), second=np.arange(4.0), third=np.arange(5.0))
    data = bytearray(path.read_bytes())
    entries = [i for i in range(len(data)) if data[i : i + 4] == b'PK\x01\x02']
    rest = data.rindex(b'PK\x05\x06') - entries[1]
    data[entries[0] + 32 : entries[0] + 34] = rest.to_bytes(2, 'little')  # length of its comment
    path.write_bytes(data)
    with zipfile.ZipFile(path) as archive:
        assert archive.namelist() == ['first.npy']  # nobody complains
    with pytest.raises(ValueError, match='a.npz.*1 members, its end says 3'):
        files.read_npz(str(path))


def test_texts_of_impossible_characters_are_refused(tmp_path):
    path = tmp_path / 'a.npz'
    np.savez(path, text=np.frombuffer(b'\xff\xff\xff\x7f', '<U1'))
    with pytest.raises(ValueError, match='a.npz.*characters that there are not'):
        files.read_npz(str(path))


@pytest.mark.parametrize('types', [np.array(['soil'] * 4), np.array([1.5] * 4), np.full(4, np.nan)])
def test_particle_types_that_are_no_whole_numbers_are_refused(types):
    with pytest.raises(ValueError, match='run.npz: particle types are not whole numbers'):
        full_space.particle_types(types, np.zeros((1, 4, 3)), 'run.npz')


def test_periodic_boundaries_that_are_no_list_are_refused(tmp_path):
    (tmp_path / 'metadata.json').write_text('{"periodic_boundary_conditions": 3}')
    with pytest.raises(ValueError, match='metadata.json: periodic_boundary_conditions is 3'):
        lagrangebench.read(str(tmp_path), 0.1)


def test_numbers_that_numpy_has_not_are_refused(tmp_path):
    h5py = pytest.importorskip('h5py')
    kind = h5py.h5t.IEEE_F32LE.copy()
    kind.set_ebias(90_000)  # an exponent far beyond those of any machine
    with h5py.File(tmp_path / 'train.h5', 'w') as file:
        run = file.create_group('00000')
        run['particle_type'] = np.zeros(2, np.int32)
        h5py.h5d.create(run.id, b'position', kind, h5py.h5s.create_simple((4, 2, 3)))
    (tmp_path / 'metadata.json').write_text('{}')
    with pytest.raises(ValueError, match='train.h5: 00000: position holds numbers that numpy has'):
        list(lagrangebench.read(str(tmp_path), 0.1).runs())


@pytest.mark.parametrize('name', ['a\0b', '\ud800', 'two\nlines'])
def test_names_that_cannot_be_printed_are_refused(name):
    """XML, and so the description of an FMU, has no such characters."""
    fields = dict(n_modes=2, rigid_motion=RigidMotion('none'), rigid_edges=(), has_force=False)
    fields |= dict(n_soil=9, dt=0.1)
    for names in ({'name': name}, {'context_names': (name,)}, {'bodies': ((name, 3),)}):
        with pytest.raises(ValueError, match='names of a scene are printable text, got'):
            Scene(**{'name': 'bin', 'context_names': ()} | fields | names)
