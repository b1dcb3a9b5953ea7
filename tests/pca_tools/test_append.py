"""A dataset that grows part by part, against one conversion of all runs."""

import json

import numpy as np
import pytest

from pca_tools import append, convert, dataset, files, particles
from pca_tools.subspace import Subspace
from tests.pca_tools import synthetic

SPLITS = {1: 'train', 2: 'train', 3: 'valid', 4: 'train', 5: 'test', 6: 'train', 7: 'valid'}


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

    refused('other content', (5, 6), 'case 5 with another path or force', change=other_force)


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
