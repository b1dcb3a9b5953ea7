"""A dataset that grows part by part, against one conversion of all runs."""

import os
import shutil

import numpy as np
import pytest

from pca_tools import append, convert, dataset, encode, files, particles
from pca_tools.subspace import Subspace
from tests.pca_tools import synthetic
from tests.pca_tools.synthetic import raw_of, write_raw_folder

SPLITS = {3: 'valid', 5: 'test', 7: 'valid', 8: 'test'}


def split_of(case):
    return SPLITS.get(case, 'train')


@pytest.fixture(scope='module')
def first(tmp_path_factory):
    """Dataset of cases 1 to 5; not to be changed."""
    folder = tmp_path_factory.mktemp('first')
    raw = write_raw_folder(folder / 'raw', 'excavation', range(1, 6), split=split_of)
    convert.convert(raw, str(folder / 'data'), modes=5)
    return str(folder / 'data')


@pytest.fixture
def grown(first, tmp_path):
    """A copy of `first`, and raw runs 4 to 7 beside it."""
    second = write_raw_folder(tmp_path / 'second', 'excavation', range(4, 8), split=split_of)
    return str(shutil.copytree(first, tmp_path / 'data')), second


def test_new_runs_go_where_they_say_and_old_ones_stay(grown):
    data, second = grown
    before = files.read_json(f'{data}/metadata.json')
    records = {split: dataset.read_split(data, split) for split in before['cases']}
    after = append.append(second, data)

    assert after == files.read_json(f'{data}/metadata.json')
    assert after['dataset_split'] == {'train': [1, 2, 4, 6], 'valid': [3, 7], 'test': [5]}
    for key in ('vel_mean', 'acc_std', 'rigid_body_force_std', 'pca', 'bounds'):
        assert after[key] == before[key]
    for split, old in records.items():
        for one, other in zip(old, dataset.read_split(data, split)):
            np.testing.assert_array_equal(one.position, other.position)
    sample = particles.read_sample(data, 'train')
    kept = raw_of(second, 6)['positions'][:: sample.frame_stride, sample.indices]
    np.testing.assert_allclose(sample[3], kept, atol=sample.resolution / 2 + 1e-7)
    assert files.check_manifest(data)
    # Truncation errors are those of all runs.
    assert after['projection_floors']['modes'] == [5]
    for split, values in after['projection_mse'].items():
        assert after['projection_floors'][split][0] == pytest.approx(np.mean(values), rel=1e-6)


def test_what_it_refuses_changes_nothing(grown, tmp_path):
    data, second = grown
    manifest = files.read_json(f'{data}/manifest.json')

    def more(name):
        return lambda case, arrays: arrays.update({name: arrays[name] + np.float32(1e-3)})

    def beside_the_modes(case, arrays):
        """Moves particles so that their scores stay."""
        modes = Subspace.load(f'{data}/subspace.npz').components
        moved = np.random.default_rng(case).normal(0, 1e-3, (140, 3))
        arrays['positions'] += (moved - modes @ (modes.T @ moved)).astype(np.float32)

    def refused(name, cases, text, scene='excavation', change=None, split=split_of):
        raw = write_raw_folder(tmp_path / name, scene, cases, change=change, split=split)
        with pytest.raises(ValueError, match=text):
            append.append(raw, data)
        assert files.read_json(f'{data}/manifest.json') == manifest

    refused('same', (4, 5), 'holds all 2 runs already')
    refused('unnamed', (6, 7), 'name no split', split=None)
    refused('other scene', (6,), 'of another scene', scene='wheel')
    for name, change in (
        ('soil', beside_the_modes), ('force', more('force')), ('body', more('rigid_positions')),
    ):  # fmt: skip
        refused(name, (5, 6), 'case 5 with other content.*case id of its own', change=change)
    (tmp_path / 'data' / 'edges.json').write_text('{}')
    refused('beside', (6,), r"not of the dataset \(\['edges.json'\]\)")


def test_runs_of_another_solver_version_do_not_replace_records(grown, tmp_path):
    data, _ = grown
    raw = write_raw_folder(
        tmp_path / 'raw', 'excavation', (5, 6), split=split_of, solver_version='next',
        change=lambda case, arrays: arrays.update(force=arrays['force'] + np.float32(1.0)),
    )  # fmt: skip
    force = dataset.read_split(data, 'test')[0].force
    with pytest.warns(UserWarning, match='solver version'):
        after = append.append(raw, data)
    assert after['dataset_split']['train'] == [1, 2, 4, 6]
    np.testing.assert_array_equal(dataset.read_split(data, 'test')[0].force, force)
    assert after['cases']['train'][-1]['solver_version'] == 'next'


def test_second_command_is_refused_while_the_first_one_works(grown, tmp_path, monkeypatch):
    data, second = grown
    third = write_raw_folder(tmp_path / 'third', 'excavation', (8,), split=split_of)
    encode_runs, refusals = encode.encode_runs, []

    def encode_meanwhile(*arguments):
        monkeypatch.undo()
        with pytest.raises(ValueError, match='process .* writes into this folder') as refusal:
            append.append(third, data)
        refusals.append(refusal)
        return encode_runs(*arguments)

    monkeypatch.setattr(encode, 'encode_runs', encode_meanwhile)
    append.append(second, data)
    after = append.append(third, data)
    assert len(refusals) == 1
    assert after['dataset_split'] == {'train': [1, 2, 4, 6], 'valid': [3, 7], 'test': [5, 8]}
    assert '.lock.json' not in os.listdir(data) and files.check_manifest(data)


def test_dataset_that_is_replaced_meanwhile_is_kept(grown, tmp_path, monkeypatch):
    data, second = grown
    third = write_raw_folder(tmp_path / 'third', 'excavation', (8, 9))
    encode_runs = encode.encode_runs

    def replace_meanwhile(*arguments):
        monkeypatch.undo()
        convert.convert(third, data, like=data, overwrite=True)
        return encode_runs(*arguments)

    monkeypatch.setattr(encode, 'encode_runs', replace_meanwhile)
    with pytest.raises(ValueError, match='was replaced while runs were added'):
        append.append(second, data)
    assert dataset.read_metadata(data)['dataset_split'] == {'test': [8, 9]}
    assert files.check_manifest(data) and '.lock.json' not in os.listdir(data)


def test_scene_stays_and_bounds_hold_both(grown, tmp_path):
    data, _ = grown
    before = dataset.read_metadata(data)
    raw = write_raw_folder(tmp_path / 'raw', 'excavation', (6, 7), split=split_of)
    manifest = files.read_json(f'{raw}/manifest.json')
    scene = manifest['scene']
    bodies = [{'name': n, 'points': 10, 'rigid_motion': 'prescribed'} for n in ('left', 'right')]
    files.write_json(f'{raw}/manifest.json', manifest | {'scene': scene | {'bodies': bodies}})
    with pytest.raises(ValueError, match='of another scene: its bodies'):
        append.append(raw, data)
    bounds = [[0.0, 0.88], [0.15, 1.3], [0.1, 0.9]]
    changes = {'scene': scene | {'gravity': [0.0, -9.81, 0.0]}, 'bounds': bounds}
    files.write_json(f'{raw}/manifest.json', manifest | changes)
    like = convert.convert(raw, str(tmp_path / 'new'), like=data)
    after = append.append(raw, data)
    for metadata in (like, after):
        assert metadata['bounds'] == [[0.0, 0.9], [0.15, 1.3], [0.1, 0.9]]
        assert metadata['scene'] == before['scene']


def test_particles_in_another_order_are_matched_on_demand(grown, tmp_path):
    data, _ = grown
    order = np.random.default_rng(3).permutation(140)
    raw = write_raw_folder(
        tmp_path / 'raw', 'excavation', (6,), split=split_of,
        change=lambda case, arrays: arrays.update(positions=arrays['positions'][:, order]),
    )  # fmt: skip
    held = Subspace.load(f'{data}/subspace.npz')
    with pytest.raises(ValueError, match='case 6: .*give --match_particles'):
        append.append(raw, data)
    append.append(raw, data, match_particles=True)
    run = dataset.read_split(data, 'train')[-1]
    positions = synthetic.make_run('excavation', 6)['positions']
    np.testing.assert_allclose(run.position[:, 20:], held.encode(positions), atol=1e-6)
