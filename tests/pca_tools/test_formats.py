"""Formats of other projects: what is written is read back bit for bit, by us and by clients that
know the format and nothing of us."""

import base64
import json
import os
import pathlib
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
import zlib

import h5py
import numpy as np
import pytest

from pca_tools import convert, dataset, files, formats
from pca_tools.export_data import export_data, full_space_of
from pca_tools.formats import full_space
from pca_tools.import_data import explain, import_data
from pca_tools.raw_runs import RawRuns
from tests.pca_tools import synthetic
from tests.pca_tools.commands import REPOSITORY, call_command

LENNARD_JONES = REPOSITORY / 'tests' / 'data' / 'lagrangebench_3d_lj'
FORMATS = ('deepmind', 'geoelements', 'lagrangebench', 'mpm_ngf', 'npz', 'vtp')
COUNTED = ('deepmind', 'geoelements', 'lagrangebench')  # these count their runs
WITHOUT_FORCE = ('geoelements', 'lagrangebench')
# Pickles stay out of this process.
GEOELEMENTS = """
import sys
import numpy as np
held = [np.load(f'{sys.argv[1]}/{split}.npz', allow_pickle=True)['gns_data']
        for split in ('train', 'valid', 'test')]
np.savez(sys.argv[2], *(values for run in np.concatenate(held) for values in run))
"""
VTK_TYPES = {'Float32': '<f4', 'Float64': '<f8', 'Int32': '<i4'}


@pytest.fixture(scope='module')
def truth(excavation, raw_excavation):
    """Name -> what is exported, in the order of the splits."""
    return {run.name: run for run in full_space_of(excavation, raw_excavation).runs()}


@pytest.fixture(scope='module')
def exports(excavation, raw_excavation, tmp_path_factory):
    """Gives the folder of an export, made once; not to be changed."""
    made = {}

    def of(name):
        if name not in made:
            made[name] = tmp_path_factory.mktemp('exports') / name
            export_data(excavation, str(made[name]), name, raw_path=raw_excavation)
        return made[name]

    return of


@pytest.fixture
def copied(exports, tmp_path):
    """Gives the folder of an export that may be changed."""
    return lambda name: pathlib.Path(shutil.copytree(exports(name), tmp_path / name))


def vtk_array(element):
    """A DataArray of one compressed block, by the rules of VTK's XML formats: its text is base64 of
    four UInt32 (blocks, size, size of a shorter last one, packed size), then of zlib's bytes."""
    text = element.text.strip()
    blocks, size, shorter, packed = np.frombuffer(base64.b64decode(text[:24])[:16], '<u4')
    data = zlib.decompress(base64.b64decode(text[24:]))
    assert (blocks, shorter, len(data)) == (1, 0, size) and packed <= len(text)
    values = np.frombuffer(data, VTK_TYPES[element.get('type')])
    components = int(element.get('NumberOfComponents', 1))
    return values if components == 1 else values.reshape(-1, components)


def of_vtp(folder, tmp_path):
    """As ParaView: the files that each .pvd lists, by their times."""
    for path in sorted(folder.glob('*.pvd')):
        frames = []
        for listed in ElementTree.parse(path).iter('DataSet'):
            root = ElementTree.parse(folder / listed.get('file')).getroot()
            frames.append({e.get('Name'): vtk_array(e) for e in root.iter('DataArray')})
        positions, force = (
            np.stack([frame[key] for frame in frames]) for key in ('Points', 'force')
        )
        yield path.stem, positions, frames[0]['particle_type'] == 3, force.reshape(-1, 3)


def of_mpm_ngf(folder, tmp_path):
    """As Subspace-Graph-Physics: five columns, the force in row 0."""
    for case in sorted(folder.iterdir()):
        paths = sorted((case / 'frames').glob('ds_*.csv'))
        rows = np.stack([np.loadtxt(path, delimiter=',')[:, :5] for path in paths])
        rows = rows.astype(np.float32)
        yield case.name, rows[:, 1:, 1:4], rows[0, 1:, 0] == 1, rows[:, 0, :3]


def of_npz(folder, tmp_path):
    """As anyone: plain arrays, no pickles."""
    for path in sorted(folder.glob('*.npz')):
        with np.load(path, allow_pickle=False) as held:
            yield path.stem, held['positions'], held['particle_type'] == 3, held['force']


def of_geoelements(folder, tmp_path):
    """An object array of (positions, types) under `gns_data`, pickled as theirs are."""
    plain = str(tmp_path / 'plain.npz')
    subprocess.run([sys.executable, '-c', GEOELEMENTS, str(folder), plain], check=True)
    with np.load(plain) as file:
        arrays = list(file.values())
    for positions, types in zip(arrays[::2], arrays[1::2], strict=True):
        yield None, positions, types == 3, None


def of_lagrangebench(folder, tmp_path):
    """A group per run, in the order of their names; 0 is fluid, 2 a moving wall."""
    metadata = json.loads((folder / 'metadata.json').read_text())
    assert metadata['num_particles_max'] == 160 and metadata['case'] == 'excavation'
    assert metadata['periodic_boundary_conditions'] == [False] * 3
    assert metadata['sequence_length_train'] == 24 and metadata['num_trajs_train'] == 4
    for split in ('train', 'valid', 'test'):
        with h5py.File(folder / f'{split}.h5') as file:
            assert list(file) == [f'{index:05d}' for index in range(len(file))]
            for group in file.values():
                yield None, group['position'][()], group['particle_type'][()] == 2, None


def of_deepmind(folder, tmp_path):
    """As their reader takes them; velocities in the metadata are per frame."""
    import tensorflow as tf

    metadata = json.loads((folder / 'metadata.json').read_text())
    assert metadata['sequence_length'] == 23 and metadata['dim'] == 3
    texts = {name: tf.io.FixedLenSequenceFeature([], tf.string) for name in ('position', 'force')}
    single = {'key': tf.io.FixedLenFeature([], tf.int64),
              'particle_type': tf.io.FixedLenFeature([], tf.string)}  # fmt: skip
    steps = []
    for split in ('train', 'valid', 'test'):
        for index, record in enumerate(tf.data.TFRecordDataset(str(folder / f'{split}.tfrecord'))):
            context, lists = tf.io.parse_single_sequence_example(record, single, texts)
            assert int(context['key']) == index
            position, force = (
                tf.io.decode_raw(lists[n], tf.float32).numpy() for n in ('position', 'force')
            )
            position = position.reshape(24, -1, 3)
            types = tf.io.decode_raw(context['particle_type'], tf.int64).numpy()
            if split == 'train':
                steps.append(np.diff(position[:, types != 3].astype(float), axis=0).reshape(-1, 3))
            yield None, position, types == 3, force
    steps = np.concatenate(steps)
    np.testing.assert_allclose(metadata['vel_mean'], steps.mean(0), rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(metadata['vel_std'], steps.std(0), rtol=1e-6)


@pytest.mark.parametrize('name', FORMATS)
def test_clients_find_every_bit(exports, truth, tmp_path, name):
    found = list(globals()[f'of_{name}'](exports(name), tmp_path))
    assert len(found) == len(truth) == 6
    for (run, positions, is_body, force), counted in zip(found, truth.values()):
        wanted = truth[run] if run else counted
        assert positions.dtype == np.float32
        np.testing.assert_array_equal(positions, wanted.positions)
        np.testing.assert_array_equal(is_body, wanted.particle_type == 3)
        if force is not None:
            np.testing.assert_array_equal(force.astype(np.float32), wanted.force)


@pytest.mark.parametrize('name', FORMATS)
def test_exports_come_back_as_raw_runs(exports, truth, excavation, tmp_path, name):
    if name == 'vtp':
        pytest.importorskip('vtk')
    out, raw = str(exports(name)), str(tmp_path / 'raw')
    assert formats.detect(out) == name
    for run, counted in zip(formats.FORMATS[name].read(out, 1 / 60).runs(), truth.values()):
        wanted = counted if name in COUNTED else truth[run.name]
        np.testing.assert_array_equal(run.positions, wanted.positions)
        np.testing.assert_array_equal(run.particle_type == 3, wanted.particle_type == 3)
        assert name == 'mpm_ngf' or run.split == wanted.split
        if name not in WITHOUT_FORCE:
            np.testing.assert_array_equal(run.force, wanted.force)
    text = import_data(out, raw, dt=1 / 60, up_axis=1)
    assert f'{raw}: raw runs of {out}' in text and 'body: prescribed, y up' in text
    runs = RawRuns(raw)
    assert runs.scene['force'] == (name not in WITHOUT_FORCE) and runs.dt == pytest.approx(1 / 60)
    expected = {run.positions[:, 20:].tobytes() for run in truth.values()}
    assert {run.positions.tobytes() for run in runs} == expected


def test_contexts_travel(wheel, raw_wheel, tmp_path):
    some = {'raw_path': raw_wheel, 'splits': ['valid', 'test']}
    export_data(wheel, str(tmp_path / 'dm'), 'deepmind', **some)
    truth = full_space_of(wheel, **some)
    data = formats.FORMATS['deepmind'].read(str(tmp_path / 'dm'))
    assert data.context_names == truth.context_names == synthetic.CONTEXT_NAMES
    for run, wanted in zip(data.runs(), truth.runs(), strict=True):
        np.testing.assert_array_equal(run.context, wanted.context)
        np.testing.assert_array_equal(run.particle_type, wanted.particle_type)


def test_public_lagrangebench_set_becomes_a_dataset(tmp_path):
    raw = str(tmp_path / 'raw')
    with pytest.raises(ValueError, match='(?s)soil particles are .* apart.*--nocheck_units'):
        import_data(str(LENNARD_JONES), raw, up_axis=1)
    text = import_data(str(LENNARD_JONES), raw, up_axis=1, check_units=False)
    assert 'boundaries are periodic' in text and 'body: none' in text
    runs = RawRuns(raw)
    with h5py.File(LENNARD_JONES / 'train.h5') as file:
        np.testing.assert_array_equal(runs[0].positions, file['00000/position'][()])
    assert [len(run.positions) for run in runs] == [1214, 405, 405]
    # its runs start from different places: there is no common subspace, which is said at once
    with pytest.raises(ValueError, match='(?s)2 faults.*not the same packing.*full_space'):
        convert.convert(raw, str(tmp_path / 'out'), modes=2, check_units=False)


def test_both_layouts_and_other_writings_of_geoelements(tmp_path):
    positions = np.random.default_rng(0).uniform(0.2, 0.8, (9, 5, 2)).astype(np.float32)
    types = np.array([6, 6, 6, 3, 6])
    item = np.empty(2, dtype=object)
    item[0], item[1] = positions, 6
    several = np.empty((2, 3), dtype=object)
    for row in several:
        row[:] = positions.astype(np.float64), types, np.full(5, 0.4)
    folder = tmp_path / 'geo'
    folder.mkdir()
    metadata = {'train': {'bounds': [[0, 1], [0, 1]], 'dim': 2, 'dt': 0.01}, 'rollout': {}}
    (folder / 'metadata.json').write_text(json.dumps(metadata))
    np.savez(folder / 'train.npz', simulation_7=item)
    np.savez_compressed(folder / 'test.npz', gns_data=several)
    data = formats.FORMATS['geoelements'].read(str(folder))
    first, *rest = data.runs()
    assert data.dt == 0.01 and data.up_axis == 1 and len(rest) == 2
    np.testing.assert_array_equal(first.positions, positions)
    assert first.particle_type.tolist() == [6] * 5
    assert rest[1].particle_type.tolist() == types.tolist()
    assert rest[1].split == 'test'
    # in the plane: a third coordinate of 0, the boundary is the body of those runs that have one
    np.savez(folder / 'train.npz', gns_data=several)
    import_data(str(folder), str(tmp_path / 'raw'), check_units=False)
    assert RawRuns(str(tmp_path / 'raw'))[0].positions.shape == (9, 4, 3)


def test_folders_are_named_wherever_they_are_met(exports, excavation, raw_excavation, tmp_path):
    for name in ('deepmind', 'geoelements', 'lagrangebench', 'mpm_ngf'):
        text = f'this is {formats.FORMATS[name].TITLE}; to use it: lts import'
        with pytest.raises((ValueError, FileNotFoundError), match='`lts import .* says what'):
            dataset.read_metadata(str(exports(name)))
        assert text in explain(str(exports(name)))
    done = call_command('pca_tools.import_data', str(exports('mpm_ngf')))
    assert done.returncode == 0 and done.stdout.endswith('--output_path=RAW --dt=SECONDS\n')
    for name in ('records', 'notes', 'nothing'):
        (tmp_path / name).mkdir()
    (tmp_path / 'records' / 'train.tfrecord').touch()
    (tmp_path / 'notes' / 'notes.txt').touch()
    for folder, text in (
        (raw_excavation, 'raw runs already'), (excavation, 'already: lts inspect'),
        (tmp_path / 'records', 'no metadata.json'),
        (tmp_path / 'notes', 'none of the known formats'), (tmp_path / 'nothing', 'holds nothing'),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=text):
            import_data(str(folder), str(tmp_path / 'out'))
    assert not (tmp_path / 'out').exists()


def test_what_the_data_do_not_say_is_asked_for(copied, tmp_path):
    raw = str(tmp_path / 'raw')
    np.savez(tmp_path / 'run.npz', positions=np.random.default_rng(0).random((5, 8, 3)))
    both = 'does not say its time step: give --dt, .* and which axis points up.* give --up_axis'
    with pytest.raises(ValueError, match=both):
        import_data(str(tmp_path), raw)
    assert explain(str(tmp_path)).endswith('--output_path=RAW --dt=SECONDS --up_axis=0|1|2')
    out = copied('lagrangebench')
    metadata = json.loads((out / 'metadata.json').read_text()) | {'write_every': 4}
    metadata['bounds'] = [[0.18, 0.84], [0.2, 0.42], [0.28, 0.72]]
    (out / 'metadata.json').write_text(json.dumps(metadata))
    assert explain(str(out)).endswith('--output_path=RAW')  # no run is read for it
    with pytest.raises(ValueError, match='which axis points up.*give --up_axis'):
        import_data(str(out), raw, check_units=False)
    import_data(str(out), raw, up_axis=1, check_units=False)
    assert RawRuns(raw).dt == pytest.approx(4 / 60)


def test_plain_runs_share_dt_and_axis_and_their_bounds_are_those_of_all(tmp_path):
    folder, raw = tmp_path / 'npz', str(tmp_path / 'raw')
    folder.mkdir()

    def write(name, **arrays):
        soil = np.random.default_rng(0).uniform(0.1, 0.4, (9, 8, 3))
        np.savez(folder / f'{name}.npz', positions=soil, **arrays)

    write('a', dt=0.1, bounds=[[0, 1], [0, 0.5], [0, 1]], up_axis=2)
    write('b', dt=np.float32(0.1), bounds=[[0, 0.7], [0, 2], [-1, 0.5]], up_axis=2)
    write('c')
    import_data(str(folder), raw)
    runs = RawRuns(raw)
    assert runs.dt == 0.1 and runs.scene['up_axis'] == 2
    assert runs.bounds == [[0, 1], [0, 2], [-1, 1]]
    write('b', dt=0.2, up_axis=2)
    with pytest.raises(ValueError, match='a.npz has dt 0.1, b.npz 0.2: .*give --dt'):
        import_data(str(folder), str(tmp_path / 'other'))
    import_data(str(folder), str(tmp_path / 'other'), dt=0.2)
    assert RawRuns(str(tmp_path / 'other')).dt == 0.2
    write('b', dt=0.1, up_axis=1)
    with pytest.raises(ValueError, match='a.npz has up_axis 2, b.npz 1'):
        import_data(str(folder), str(tmp_path / 'third'))
    write('b', dt=0.1, up_axis=[1, 2])
    with pytest.raises(ValueError, match=r'b.npz: up_axis is \[1, 2\], 0, 1 or 2 was expected'):
        import_data(str(folder), str(tmp_path / 'third'))
    for name in 'abc':
        write(name, dt=0.1, up_axis=2, context=np.float32(4.5))
    import_data(str(folder), str(tmp_path / 'third'))
    assert RawRuns(str(tmp_path / 'third'))[0].context.tolist() == [4.5]


def test_differing_particles_and_moving_walls_are_refused():
    def mappings(*runs, **extra):
        data = full_space.FullSpaceData('here', lambda: iter(runs), 0.1, **extra)
        return list(full_space.raw_mappings(data, None))

    x = np.random.default_rng(0).uniform(size=(5, 4, 3)).astype(np.float32)
    types = np.array([6, 6, 0, 3])
    run = full_space.FullSpaceRun
    with pytest.raises(ValueError, match='rigid body .* moving boundary'):
        mappings(run('a', '', x, types))
    still = x.copy()
    still[:, 3] = still[0, 3]  # a wall that never moves is no body beside a rigid one
    (mapping,) = mappings(run('a', '', still, types))
    np.testing.assert_array_equal(mapping['rigid_positions'], x[:, 2:3])
    with pytest.raises(ValueError, match='b: has 1 soil particles, a 2: .*full_space'):
        mappings(run('a', '', still, types), run('b', '', x[:, :3], np.array([6, 0, 0])))
    with pytest.raises(ValueError, match='there is no soil'):
        mappings(run('a', '', x, np.array([3, 3, 0, 0])))
    changing = run('a', '', still, types, context=np.arange(5.0)[:, None])
    (mapping,) = mappings(changing, context_names=['load'])
    assert mapping['context'] == {'load': 0.0} and len(mapping['step_context']) == 5


def test_links_out_of_an_hdf5_file_are_not_followed(copied, tmp_path):
    out = copied('lagrangebench')
    with h5py.File(f'{out}/train.h5', 'r+') as file:
        del file['00000/position']
        file['00000/position'] = h5py.ExternalLink(f'{out}/test.h5', '/00000/position')
    with pytest.raises(ValueError, match='position and particle_type were expected'):
        import_data(str(out), str(tmp_path / 'raw'), up_axis=1)


def test_decoded_and_thinned_exports_and_rollouts(excavation, tmp_path):
    text = export_data(excavation, str(tmp_path / 'npz'), 'npz', particle_stride=7, splits=['test'])
    assert 'decoded from 8 modes' in text
    (name,) = os.listdir(tmp_path / 'npz')
    assert files.read_npz(f'{tmp_path}/npz/{name}')['positions'].shape == (24, 20 + 20, 3)
    run = dataset.read_split(excavation, 'test')[0]
    (tmp_path / 'rolled').mkdir()
    files.write_npz(
        str(tmp_path / 'rolled' / 'rollout_test_0.npz'),
        initial_positions=run.position[:6], predicted_rollout=run.position[6:],
        particle_types=run.particle_type, initial_forces=run.force[:6],
        predicted_forces=run.force[6:],
    )  # fmt: skip
    export_data(excavation, str(tmp_path / 'dm'), 'deepmind', rollouts=str(tmp_path / 'rolled'))
    (again,) = formats.FORMATS['deepmind'].read(str(tmp_path / 'dm')).runs()
    (decoded,) = full_space_of(excavation, splits=['test']).runs()
    np.testing.assert_array_equal(again.positions, decoded.positions)
    np.testing.assert_array_equal(again.force, run.force)
    with pytest.raises(ValueError, match='is not empty'):
        export_data(excavation, str(tmp_path / 'dm'), 'npz')


def test_cases_that_point_out_of_the_folder_are_refused(excavation, tmp_path):
    data = str(shutil.copytree(excavation, tmp_path / 'data'))
    metadata = files.read_json(f'{data}/metadata.json')
    metadata['dataset_split']['test'] = ['a/../../../outside']
    files.write_json(f'{data}/metadata.json', metadata)
    os.remove(f'{data}/manifest.json')
    with pytest.raises(ValueError, match="data: case 'a/../../../outside' cannot name a file"):
        export_data(data, str(tmp_path / 'out'), 'mpm_ngf', splits=['test'])
    assert os.listdir(tmp_path) == ['data']


def test_the_authors_folder_becomes_a_dataset(original, tmp_path):
    text = import_data(original, str(tmp_path / 'out'), body='predicted')
    assert 'a dataset of' in text and 'scores cannot be decoded' in text
    metadata = dataset.read_metadata(str(tmp_path / 'out'))
    # As published; without it no model can be trained.
    assert metadata['n_soil'] in (4880, 6005)
    for split, ids in metadata['dataset_split'].items():
        ours = dataset.read_split(str(tmp_path / 'out'), split)
        theirs = dataset.read_split(original, split)
        assert [run.key for run in ours] == list(range(len(ids)))
        for run, wanted in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(run.position, wanted.position)
            np.testing.assert_array_equal(run.force, wanted.force)


@pytest.mark.parametrize('other', [{'dt': 0.1}, {'length_scale': 1e-3, 'force_scale': 2.0}])
def test_the_authors_scores_take_no_other_units(tmp_path, other):
    files.write_json(str(tmp_path / 'metadata.json'), {'mode_number': 8})
    (tmp_path / 'train.tfrecord').touch()
    with pytest.raises(ValueError, match='leave out --') as error:
        import_data(str(tmp_path), str(tmp_path / 'out'), **other)
    assert all(f'--{name}={value}' in str(error.value) for name, value in other.items())
    assert not (tmp_path / 'out').exists()


def test_runs_of_different_lengths_only_go_where_they_fit(tmp_path):
    def change(case, arrays):
        for name in ('positions', 'rigid_positions', 'force', 'pose'):
            arrays[name] = arrays[name][: 20 + case]

    raw = synthetic.write_raw_folder(tmp_path / 'raw', 'excavation', range(4), change=change)
    convert.convert(raw, str(tmp_path / 'data'), modes=2)
    for name in ('deepmind', 'lagrangebench'):
        with pytest.raises(ValueError, match='this format holds runs of one length'):
            export_data(str(tmp_path / 'data'), str(tmp_path / name), name)
        assert not (tmp_path / name).exists()
    export_data(str(tmp_path / 'data'), str(tmp_path / 'geo'), 'geoelements')
    metadata = json.loads((tmp_path / 'geo' / 'metadata.json').read_text())
    assert metadata['sequence_length'] is None
