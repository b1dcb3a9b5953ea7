"""Formats of other projects: what is written is read back bit for bit, and by others' rules."""

import json
import os
import pathlib
import shutil

import h5py
import numpy as np
import pytest

from pca_tools import convert, dataset, files
from pca_tools.export_data import export_data, full_space_of
from pca_tools.formats import detect, full_space
from pca_tools.import_data import explain, import_data
from pca_tools.raw_runs import RawRuns
from tests.pca_tools import synthetic
from tests.pca_tools.commands import REPOSITORY, run_command

LENNARD_JONES = REPOSITORY / 'tests' / 'data' / 'lagrangebench_3d_lj'
FORMATS = ('deepmind', 'geoelements', 'lagrangebench', 'mpm_ngf', 'npz', 'vtp')


def written(excavation, raw_excavation, tmp_path, name):
    if name == 'vtp':
        pytest.importorskip('vtk')
    out = str(tmp_path / name)
    export_data(excavation, out, name, raw_path=raw_excavation)
    return out


@pytest.mark.parametrize('name', FORMATS)
def test_round_trip_keeps_every_bit(excavation, raw_excavation, tmp_path, name):
    out = written(excavation, raw_excavation, tmp_path, name)
    assert detect.detect(out) == name
    truth = list(full_space_of(excavation, raw_excavation).runs())
    data = detect.FORMATS[name].read(out, 1 / 60)
    read = list(data.runs())
    assert len(read) == len(truth) == 12 and data.dt == pytest.approx(1 / 60)
    if name in ('mpm_ngf', 'npz', 'vtp'):  # these name their runs, the others count them
        read = sorted(read, key=lambda run: [t.name for t in truth].index(run.name))
    for run, wanted in zip(read, truth, strict=True):
        assert run.positions.dtype == np.float32
        np.testing.assert_array_equal(run.positions, wanted.positions)
        np.testing.assert_array_equal(run.particle_type == 3, wanted.particle_type == 3)
        if name not in ('geoelements', 'lagrangebench'):  # these hold no forces
            np.testing.assert_array_equal(run.force, wanted.force)
        if name != 'mpm_ngf':
            assert run.split == wanted.split


@pytest.mark.parametrize('name', FORMATS)
def test_exports_come_back_as_raw_runs(excavation, raw_excavation, tmp_path, name):
    out = written(excavation, raw_excavation, tmp_path, name)
    raw = str(tmp_path / 'raw')
    text = import_data(out, raw, dt=1 / 60, up_axis=1)
    assert f'{raw}: raw runs of {out}' in text and 'body: prescribed, y up' in text
    expected = {run.positions.tobytes() for run in RawRuns(raw_excavation)}
    assert {run.positions.tobytes() for run in RawRuns(raw)} == expected
    metadata = convert.convert(raw, str(tmp_path / 'again'))
    base = dataset.read_metadata(excavation)
    if name != 'mpm_ngf':  # every other format says which split a run belongs to
        # the runs may come in another order
        floor, expected = (m['pca']['projection_floor'] for m in (metadata, base))
        assert floor == pytest.approx(expected, rel=1e-9)
        np.testing.assert_allclose(metadata['vel_std'], base['vel_std'], rtol=1e-9)
    assert metadata['scene']['force'] == (name not in ('geoelements', 'lagrangebench'))


def test_deepmind_records_are_as_their_reader_takes_them(wheel, raw_wheel, tmp_path):
    import tensorflow as tf

    out = str(tmp_path / 'dm')
    export_data(wheel, out, 'deepmind', raw_path=raw_wheel)
    metadata = json.loads((tmp_path / 'dm' / 'metadata.json').read_text())
    assert metadata['sequence_length'] == 23 and metadata['dim'] == 3
    truth = [run for run in full_space_of(wheel, raw_wheel).runs() if run.split == 'train']
    for index, record in enumerate(tf.data.TFRecordDataset(f'{out}/train.tfrecord')):
        context, lists = tf.io.parse_single_sequence_example(
            record,
            {'key': tf.io.FixedLenFeature([], tf.int64),
             'particle_type': tf.io.FixedLenFeature([], tf.string)},
            {'position': tf.io.FixedLenSequenceFeature([], tf.string),
             'step_context': tf.io.FixedLenSequenceFeature([], tf.string)},
        )  # fmt: skip
        positions = tf.io.decode_raw(lists['position'], tf.float32).numpy()
        assert int(context['key']) == index
        np.testing.assert_array_equal(positions.reshape(24, -1, 3), truth[index].positions)
        types = tf.io.decode_raw(context['particle_type'], tf.int64).numpy()
        np.testing.assert_array_equal(types, truth[index].particle_type)
        contexts = tf.io.decode_raw(lists['step_context'], tf.float32).numpy()
        np.testing.assert_array_equal(contexts, truth[index].context)
    steps = np.concatenate(
        [np.diff(run.positions.astype(float), axis=0).reshape(-1, 3) for run in truth]
    )
    np.testing.assert_allclose(metadata['vel_mean'], steps.mean(0), rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(metadata['vel_std'], steps.std(0), rtol=1e-6)


def test_lagrangebench_files_have_what_their_loader_needs(excavation, raw_excavation, tmp_path):
    out = written(excavation, raw_excavation, tmp_path, 'lagrangebench')
    metadata = json.loads((tmp_path / 'lagrangebench' / 'metadata.json').read_text())
    assert metadata['num_particles_max'] == 160
    assert metadata['periodic_boundary_conditions'] == [False] * 3
    assert metadata['sequence_length_train'] == 24 and metadata['num_trajs_train'] == 10
    with h5py.File(f'{out}/train.h5') as file:
        assert list(file) == [f'{index:05d}' for index in range(10)]
        assert file['00000/position'].shape == (24, 160, 3)
        assert set(file['00000/particle_type'][()].tolist()) == {0, 2}  # fluid, moving wall


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
    data = detect.FORMATS['geoelements'].read(str(folder))
    first, *rest = data.runs()
    assert data.dt == 0.01 and data.up_axis == 1 and len(rest) == 2
    np.testing.assert_array_equal(first.positions, positions)
    assert first.particle_type.tolist() == [6] * 5 and first.material is None
    assert rest[1].particle_type.tolist() == types.tolist()
    assert rest[1].material.tolist() == [0.4] * 5 and rest[1].split == 'test'
    # in the plane: a third coordinate of 0, the boundary is the body of those runs that have one
    np.savez(folder / 'train.npz', gns_data=several)
    import_data(str(folder), str(tmp_path / 'raw'), check_units=False)
    assert RawRuns(str(tmp_path / 'raw'))[0].positions.shape == (9, 4, 3)


@pytest.mark.parametrize('name', ['deepmind', 'geoelements', 'lagrangebench', 'mpm_ngf'])
def test_foreign_data_are_named_wherever_they_are_met(excavation, raw_excavation, tmp_path, name):
    out = written(excavation, raw_excavation, tmp_path, name)
    expected = f'this is {detect.FORMATS[name].TITLE}; to use it: python -m pca_tools.import_data'
    with pytest.raises((ValueError, FileNotFoundError)) as error:
        dataset.read_metadata(out)
    assert expected in str(error.value)
    done = run_command('pca_tools.import_data', out)
    assert done.returncode == 0 and expected in done.stdout


def test_folders_that_need_no_import_or_cannot_be_imported(excavation, raw_excavation, tmp_path):
    for folder, text in ((raw_excavation, 'raw runs already'), (excavation, 'already: python -m')):
        with pytest.raises(ValueError, match=text):
            import_data(folder, str(tmp_path / 'out'))
    for names, text in (
        (('meta.json',), 'MeshGraphNets'), (('loc_train_springs5.npy',), 'NRI'),
        (('train.tfrecord',), 'no metadata.json'), (('notes.txt',), 'none of the known formats'),
        ((), 'holds nothing'),
    ):  # fmt: skip
        folder = tmp_path / text.replace(' ', '_')
        folder.mkdir()
        for name in names:
            (folder / name).write_text('{}')
        with pytest.raises(ValueError, match=text):
            import_data(str(folder), str(tmp_path / 'out'))
    assert not (tmp_path / 'out').exists()


def test_what_the_data_do_not_say_is_asked_for(excavation, raw_excavation, tmp_path):
    out = written(excavation, raw_excavation, tmp_path, 'mpm_ngf')
    with pytest.raises(ValueError, match='does not say its time step: give --dt'):
        import_data(out, str(tmp_path / 'raw'))
    out = written(excavation, raw_excavation, tmp_path, 'lagrangebench')
    path = tmp_path / 'lagrangebench' / 'metadata.json'
    metadata = json.loads(path.read_text()) | {'write_every': 4, 'bounds': [[0, 1]] * 3}
    path.write_text(json.dumps(metadata))
    with pytest.raises(ValueError, match='which axis points up.*give --up_axis'):
        metadata['bounds'] = [[0.18, 0.84], [0.2, 0.42], [0.28, 0.72]]
        path.write_text(json.dumps(metadata))
        import_data(out, str(tmp_path / 'raw'), check_units=False)
    import_data(out, str(tmp_path / 'raw'), up_axis=1, check_units=False)
    assert RawRuns(str(tmp_path / 'raw')).dt == pytest.approx(4 / 60)


def test_all_that_is_lacking_is_said_at_once_and_by_the_name(tmp_path):
    np.savez(tmp_path / 'run.npz', positions=np.random.default_rng(0).random((5, 8, 3)))
    both = 'does not say its time step: give --dt, .* and which axis points up.* give --up_axis'
    with pytest.raises(ValueError, match=both):
        import_data(str(tmp_path), str(tmp_path / 'raw'))
    assert explain(str(tmp_path)).endswith('--output_path=RAW --dt=SECONDS --up_axis=0|1|2')


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


def test_a_folder_is_named_without_reading_its_runs(
    excavation, raw_excavation, tmp_path, monkeypatch
):
    out = written(excavation, raw_excavation, tmp_path, 'deepmind')

    def read_all(*_):
        raise AssertionError('all runs are read')

    monkeypatch.setattr('pca_tools.formats.full_space.find_up_axis', read_all)
    assert explain(out).endswith('--output_path=RAW')
    with pytest.raises(AssertionError, match='all runs are read'):
        import_data(out, str(tmp_path / 'raw'))


def test_differing_particles_and_moving_walls_are_refused(tmp_path):
    def data_of(*runs, **extra):
        return full_space.FullSpaceData('here', lambda: iter(runs), 0.1, **extra)

    x = np.random.default_rng(0).uniform(size=(5, 4, 3)).astype(np.float32)
    types = np.array([6, 6, 0, 3])
    run = full_space.FullSpaceRun
    with pytest.raises(ValueError, match='rigid body .* moving boundary'):
        list(full_space.raw_mappings(data_of(run('a', '', x, types)), None))
    still = x.copy()
    still[:, 3] = still[0, 3]  # a wall that never moves is no body beside a rigid one
    (mapping,) = full_space.raw_mappings(data_of(run('a', '', still, types)), None)
    np.testing.assert_array_equal(mapping['rigid_positions'], x[:, 2:3])
    fewer = run('b', '', x[:, :3], np.array([6, 0, 0]))
    with pytest.raises(ValueError, match='b: has 1 soil particles, a 2: .*full_space'):
        list(full_space.raw_mappings(data_of(run('a', '', still, types), fewer), None))
    with pytest.raises(ValueError, match='there is no soil'):
        list(full_space.raw_mappings(data_of(run('a', '', x, np.array([3, 3, 0, 0]))), None))
    changing = run('a', '', still, types, context=np.arange(5.0)[:, None])
    (mapping,) = full_space.raw_mappings(data_of(changing, context_names=['load']), None)
    assert mapping['context'] == {'load': 0.0} and len(mapping['step_context']) == 5


def damage(folder: pathlib.Path, name: str) -> None:
    path = next(p for p in sorted(folder.rglob('*')) if p.suffix in ('.npz', '.h5', '.csv'))
    if name == 'cut':
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    elif name == 'empty':
        path.write_bytes(b'')
    else:
        path.write_bytes(b'version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 7\n')


@pytest.mark.parametrize('kind', ['cut', 'empty', 'pointer'])
@pytest.mark.parametrize('name', ['geoelements', 'lagrangebench', 'mpm_ngf', 'npz'])
def test_damaged_files_are_named_and_leave_nothing(
    excavation, raw_excavation, tmp_path, name, kind
):
    out = written(excavation, raw_excavation, tmp_path, name)
    damage(pathlib.Path(out), kind)
    with pytest.raises((ValueError, OSError)):
        import_data(out, str(tmp_path / 'raw'), dt=1 / 60, up_axis=1)
    assert os.listdir(tmp_path) == [name]


def test_links_out_of_an_hdf5_file_are_not_followed(excavation, raw_excavation, tmp_path):
    out = written(excavation, raw_excavation, tmp_path, 'lagrangebench')
    with h5py.File(f'{out}/train.h5', 'r+') as file:
        del file['00000/position']
        file['00000/position'] = h5py.ExternalLink(f'{out}/test.h5', '/00000/position')
    with pytest.raises(ValueError, match='position and particle_type were expected'):
        import_data(out, str(tmp_path / 'raw'), up_axis=1)


def test_decoded_and_thinned_exports_and_rollouts(excavation, tmp_path):
    text = export_data(excavation, str(tmp_path / 'npz'), 'npz', particle_stride=7, splits=['test'])
    assert '1 runs' in text and 'decoded from 8 modes' in text
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
    (again,) = (
        detect.FORMATS['deepmind'].read(str(tmp_path / 'dm')).runs()
    )
    (decoded,) = full_space_of(excavation, splits=['test']).runs()
    np.testing.assert_array_equal(again.positions, decoded.positions)
    np.testing.assert_array_equal(again.force, run.force)
    with pytest.raises(ValueError, match='is not empty'):
        export_data(excavation, str(tmp_path / 'dm'), 'npz')


def test_the_authors_folder_becomes_a_dataset(original, tmp_path):
    text = import_data(original, str(tmp_path / 'out'), body='predicted')
    assert 'a dataset of' in text and 'scores cannot be decoded' in text
    metadata = dataset.read_metadata(str(tmp_path / 'out'))
    for split, ids in metadata['dataset_split'].items():
        ours = dataset.read_split(str(tmp_path / 'out'), split)
        theirs = dataset.read_split(original, split)
        assert [run.key for run in ours] == list(range(len(ids)))
        for run, wanted in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(run.position, wanted.position)
            np.testing.assert_array_equal(run.force, wanted.force)


def test_runs_of_different_lengths_only_go_where_they_fit(tmp_path):
    def change(case, arrays):
        for name in ('positions', 'rigid_positions', 'force', 'pose'):
            arrays[name] = arrays[name][: 20 + case]

    raw = synthetic.write_raw_folder(str(tmp_path / 'raw'), 'excavation', range(4), change=change)
    convert.convert(raw, str(tmp_path / 'data'), modes=2)
    for name in ('deepmind', 'lagrangebench'):
        with pytest.raises(ValueError, match='this format holds runs of one length'):
            export_data(str(tmp_path / 'data'), str(tmp_path / name), name)
        assert not (tmp_path / name).exists()
    export_data(str(tmp_path / 'data'), str(tmp_path / 'geo'), 'geoelements')
    metadata = json.loads((tmp_path / 'geo' / 'metadata.json').read_text())
    assert metadata['sequence_length'] is None
    shutil.rmtree(tmp_path / 'geo')
