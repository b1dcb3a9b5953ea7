"""A dataset that grows part by part, against one conversion of all runs."""

import json
import os

import numpy as np
import pytest

from pca_tools import append, convert, dataset, files, particles, write_raw
from pca_tools.subspace import Subspace
from tests.pca_tools import synthetic

SPLITS = {
    1: 'train',
    2: 'train',
    3: 'valid',
    4: 'train',
    5: 'test',
    6: 'train',
    7: 'valid',
    8: 'test',
}


def with_split(case, arrays, **more):
    parameters = json.loads(str(arrays['parameters']))
    arrays['parameters'] = np.array(json.dumps({**parameters, 'split': SPLITS[case], **more}))


@pytest.fixture
def grown(tmp_path):
    """A dataset of cases 1 to 5, and raw runs 4 to 7 beside it."""
    first = synthetic.write_raw_folder(
        str(tmp_path / 'first'), 'excavation', range(1, 6), change=with_split
    )
    second = synthetic.write_raw_folder(
        str(tmp_path / 'second'), 'excavation', range(4, 8), change=with_split
    )
    data = str(tmp_path / 'data')
    convert.convert(first, data, modes=5)
    return data, second


def test_new_runs_go_where_they_say_and_old_ones_stay(grown, tmp_path):
    data, second = grown
    before = files.read_json(f'{data}/metadata.json')
    records = {split: dataset.read_split(data, split) for split in before['cases']}
    space = Subspace.load(f'{data}/subspace.npz')
    after = append.append(second, data)

    assert after == files.read_json(f'{data}/metadata.json')
    assert after['dataset_split'] == {'train': [1, 2, 4, 6], 'valid': [3, 7], 'test': [5]}
    for key in ('vel_mean', 'acc_std', 'rigid_body_force_std', 'pca', 'bounds'):
        assert after[key] == before[key]
    for split, old in records.items():
        new = dataset.read_split(data, split)
        assert [run.key for run in new] == list(range(len(new)))
        for one, other in zip(old, new):
            np.testing.assert_array_equal(one.position, other.position)
            np.testing.assert_array_equal(one.force, other.force)
    # The run that came is the raw one, in the subspace that was there.
    raw = np.load(f'{second}/run_006.npz')
    run = dataset.read_split(data, 'train')[3]
    np.testing.assert_array_equal(run.force, raw['force'])
    np.testing.assert_allclose(
        run.position[:, run.n_rigid :], space.encode(raw['positions']), atol=1e-6
    )
    sample = particles.read_sample(data, 'train')
    kept = raw['positions'][:: sample.frame_stride, sample.indices]
    np.testing.assert_allclose(sample[3], kept, atol=sample.resolution / 2 + 1e-7)
    assert files.check_manifest(data)


def test_truncation_errors_are_those_of_all_runs(grown):
    data, second = grown
    after = append.append(second, data)
    modes = after['projection_floors']['modes']
    assert modes == [5]
    for split, values in after['projection_mse'].items():
        assert after['projection_floors'][split][0] == pytest.approx(np.mean(values), rel=1e-6)


def test_what_it_refuses_changes_nothing(grown, tmp_path):
    data, second = grown
    manifest = files.read_json(f'{data}/manifest.json')

    def refused(name, cases, text, change=with_split, scene='excavation'):
        raw = synthetic.write_raw_folder(str(tmp_path / name), scene, cases, change=change)
        with pytest.raises(ValueError, match=text):
            append.append(raw, data)
        assert files.read_json(f'{data}/manifest.json') == manifest

    refused('same', (4, 5), 'holds all 2 runs already')
    refused('unnamed', (6, 7), 'name no split', change=None)
    refused('other scene', (6,), 'of another scene', scene='wheel')

    def other_force(case, arrays):
        with_split(case, arrays)
        arrays['force'] = arrays['force'] + np.float32(1.0)

    refused('other content', (5, 6), 'case 5 with other content', change=other_force)
    (tmp_path / 'data' / 'edges.json').write_text('{}')
    refused('beside', (6,), r"not of the dataset \(\['edges.json'\]\)")


def test_runs_of_another_solver_version_do_not_replace_records(grown, tmp_path):
    data, _ = grown

    def newer(case, arrays):
        with_split(case, arrays, solver_version='next')
        arrays['force'] = arrays['force'] + np.float32(1.0)

    raw = synthetic.write_raw_folder(str(tmp_path / 'raw'), 'excavation', (5, 6), change=newer)
    force = dataset.read_split(data, 'test')[0].force
    with pytest.warns(UserWarning, match='solver version'):
        after = append.append(raw, data)
    assert after['dataset_split']['train'] == [1, 2, 4, 6]
    np.testing.assert_array_equal(dataset.read_split(data, 'test')[0].force, force)
    assert after['cases']['train'][-1]['solver_version'] == 'next'


def test_second_command_is_refused_while_the_first_one_works(grown, tmp_path, monkeypatch):
    data, second = grown
    third = synthetic.write_raw_folder(
        str(tmp_path / 'third'), 'excavation', (8,), change=with_split
    )
    encode, refusals = append.encode_runs, []

    def encode_meanwhile(*arguments):
        monkeypatch.undo()
        with pytest.raises(ValueError, match='process .* writes into this folder') as refusal:
            append.append(third, data)
        refusals.append(refusal)
        return encode(*arguments)

    monkeypatch.setattr(append, 'encode_runs', encode_meanwhile)
    append.append(second, data)
    after = append.append(third, data)
    assert len(refusals) == 1
    assert after['dataset_split'] == {'train': [1, 2, 4, 6], 'valid': [3, 7], 'test': [5, 8]}
    assert '.lock.json' not in os.listdir(data) and files.check_manifest(data)


def test_dataset_that_is_replaced_meanwhile_is_kept(grown, tmp_path, monkeypatch):
    data, second = grown
    third = synthetic.write_raw_folder(str(tmp_path / 'third'), 'excavation', (8, 9))
    encode = append.encode_runs

    def replace_meanwhile(*arguments):
        convert.convert(third, data, like=data, overwrite=True)
        return encode(*arguments)

    monkeypatch.setattr(append, 'encode_runs', replace_meanwhile)
    with pytest.raises(ValueError, match='was replaced while runs were added'):
        append.append(second, data)
    assert dataset.read_metadata(data)['dataset_split'] == {'test': [8, 9]}
    assert files.check_manifest(data) and '.lock.json' not in os.listdir(data)


def plain_runs(seed, count=4, bodies=None, lift=0.0, frames=24):
    """Runs of particles that go their own ways, all written as the cases 0, 1, ..."""
    rng = np.random.default_rng(seed)
    drift = 0.01 * np.sin(np.linspace(0, 2, frames))[:, None, None]
    for case in range(count):
        way = rng.normal(size=(1, 140, 3)) * [1, 0, 1]
        run = {'positions': synthetic.initial_soil() + drift * way, 'split': 'train'}
        if bodies is not None:
            points = np.random.default_rng(0).uniform(0.3, 0.6, (sum(bodies), 3)) + [0, lift, 0]
            run['rigid_positions'] = np.tile(points, (frames, 1, 1))
        yield run | {'case': case + 100 * seed}


def written(folder, runs, **settings):
    write_raw(str(folder), runs, dt=1 / 60, up_axis=1, **settings)
    return str(folder)


def test_run_of_a_held_case_with_other_soil_or_context_is_no_held_run(tmp_path):
    def changed(**arrays):
        return ({**run, **arrays} for run in plain_runs(0))

    for name, first, other in (
        ('soil', {}, {'positions': next(plain_runs(1))['positions']}),
        ('context', {'context': {'load': 1.0}}, {'context': {'load': 2.0}}),
    ):
        data = str(tmp_path / f'{name} data')
        raw = written(tmp_path / f'{name} first', changed(**first))
        convert.convert(raw, data, modes=3)
        with pytest.raises(ValueError, match='holds all 4 runs already'):
            append.append(raw, data)
        with pytest.raises(
            ValueError, match='holds case 0 with other content .*case id of its own'
        ):
            append.append(written(tmp_path / f'{name} other', changed(**first | other)), data)


def test_scene_stays_and_bounds_hold_both(tmp_path):
    def pair(*points):
        names = zip(('blade', 'wheel'), points)
        motion = {'rigid_motion': 'prescribed'}
        return {'bodies': [{'name': name, 'points': count, **motion} for name, count in names]}

    low, high = [[0.1, 0.9]] * 3, [[0.0, 0.88], [0.15, 1.3], [0.1, 0.9]]
    first = written(tmp_path / 'first', plain_runs(0, bodies=(9, 9)), bounds=low, **pair(9, 9))
    data = str(tmp_path / 'data')
    before = convert.convert(first, data, modes=3)
    other = written(tmp_path / 'other', plain_runs(1, bodies=(12, 6)), **pair(12, 6))
    with pytest.raises(ValueError, match='of another scene: its bodies'):
        append.append(other, data)
    with pytest.raises(ValueError, match='of another scene: its bodies'):
        convert.convert(other, str(tmp_path / 'new'), like=data)
    lifted = plain_runs(1, bodies=(9, 9), lift=0.5)
    higher = written(tmp_path / 'higher', lifted, bounds=high, **pair(9, 9))
    manifest = files.read_json(f'{higher}/manifest.json')
    manifest['scene']['gravity'] = [0.0, -9.81, 0.0]
    del manifest['scene']['up_axis']  # follows from gravity
    files.write_json(f'{higher}/manifest.json', manifest)
    expected = [[0.0, 0.9], [0.1, 1.3], [0.1, 0.9]]
    like = convert.convert(higher, str(tmp_path / 'new'), like=data)
    assert like['bounds'] == expected and like['scene'] == before['scene']
    with pytest.warns(UserWarning, match='up_axis is missing; 1'):
        after = append.append(higher, data)
    assert after['bounds'] == expected and after['scene'] == before['scene']


def test_particles_in_another_order_are_matched_on_demand(grown, tmp_path):
    data, _ = grown
    order = np.random.default_rng(3).permutation(140)

    def shuffled(case, arrays):
        with_split(case, arrays)
        arrays['positions'] = arrays['positions'][:, order]

    raw = synthetic.write_raw_folder(str(tmp_path / 'raw'), 'excavation', (6,), change=shuffled)
    held = Subspace.load(f'{data}/subspace.npz')
    with pytest.raises(ValueError, match='case 6: .*give --match_particles'):
        append.append(raw, data)
    append.append(raw, data, match_particles=True)
    run = dataset.read_split(data, 'train')[-1]
    positions = synthetic.make_run('excavation', 6)['positions']
    np.testing.assert_allclose(run.position[:, 20:], held.encode(positions), atol=1e-6)
