"""A dataset with fewer training runs, against the larger one it comes from."""

import numpy as np
import pytest

from pca_tools import convert, dataset, files, particles, subset
from pca_tools.subspace import Subspace
from tests.pca_tools import synthetic
from tests.pca_tools.test_append import with_split


@pytest.fixture
def whole(tmp_path):
    """Cases 1, 2, 4, 6 in train, 3 and 7 in valid, 5 in test; 2 and 6 are lifts, 7 stops."""

    def change(case, arrays):
        with_split(case, arrays, kind={2: 'lift', 6: 'lift', 7: 'stops'}.get(case, 'grid'))

    raw = synthetic.write_raw_folder(
        str(tmp_path / 'raw'), 'excavation', range(1, 8), change=change
    )
    data = str(tmp_path / 'data')
    convert.convert(raw, data, modes=5)
    return data


@pytest.mark.parametrize(
    ('options', 'cases'),
    [
        ({'train_runs': 2}, [2, 6]),
        ({'kinds': ['lift']}, [2, 6]),
        ({'kinds': ['grid'], 'train_runs': 1}, [4]),
        ({'kinds': {'lift': 0, 'grid': 1}}, [2, 4, 6]),
        ({'kinds': {'lift': 1, 'grid': 2}, 'train_runs': 2}, [1, 6]),
        ({}, [1, 2, 4, 6]),
    ],
)
def test_runs_are_those_of_the_whole(whole, tmp_path, options, cases):
    out = str(tmp_path / 'few')
    few = subset.subset(whole, out, **options)
    base = files.read_json(f'{whole}/metadata.json')
    assert few['dataset_split'] == {'train': cases, 'valid': [3, 7], 'test': [5]}
    for key in (
        base.keys()
        - {'dataset_split', 'cases', 'projection_floors', 'frames_of_runs'}
        - {'projection_mse', 'projection_max_mm', 'motion_mse', 'motion_kept'}
    ):
        assert few[key] == base[key], key
    assert Subspace.load(f'{out}/subspace.npz').digest == base['pca']['digest']
    for split, mine in few['dataset_split'].items():
        records, all_records = (dataset.read_split(d, split) for d in (out, whole))
        sample, whole_sample = (particles.read_sample(d, split) for d in (out, whole))
        for place, case in enumerate(mine):
            old = base['dataset_split'][split].index(case)
            assert records[place].key == place
            np.testing.assert_array_equal(records[place].position, all_records[old].position)
            np.testing.assert_array_equal(records[place].force, all_records[old].force)
            np.testing.assert_array_equal(sample[place], whole_sample[old])
            assert few['projection_mse'][split][place] == base['projection_mse'][split][old]
    assert files.check_manifest(out)


def test_kinds_of_every_split(whole, tmp_path):
    out = str(tmp_path / 'grid')
    few = subset.subset(whole, out, kinds=['grid'], every_split=True)
    assert few['dataset_split'] == {'train': [1, 4], 'valid': [3], 'test': [5]}
    base = files.read_json(f'{whole}/metadata.json')
    assert few['projection_mse']['valid'] == base['projection_mse']['valid'][:1]
    record, *others = dataset.read_split(out, 'valid')
    assert not others and record.key == 0
    np.testing.assert_array_equal(record.position, dataset.read_split(whole, 'valid')[0].position)
    with pytest.raises(ValueError, match=r"valid, test without a run of \['lift'\]"):
        subset.subset(whole, str(tmp_path / 'lifts'), kinds=['lift'], every_split=True)
    with pytest.raises(ValueError, match='no kinds were named'):
        subset.subset(whole, str(tmp_path / 'none'), every_split=True)
    assert not (tmp_path / 'lifts').exists() and not (tmp_path / 'none').exists()


@pytest.mark.parametrize(
    ('options', 'words'),
    [
        ({'train_runs': 5}, 'such training runs: there are 4, 5 were asked for'),
        ({'kinds': ['grid'], 'train_runs': 3}, 'such training runs: there are 2, 3 were asked for'),
        ({'kinds': {'lift': 3}}, 'runs of the kind lift: there are 2, 3 were asked for'),
        ({'kinds': ['lift', 'sea']}, r"trains on no \['sea'\], only \['grid', 'lift'\]"),
    ],
)
def test_what_is_not_there_is_refused(whole, tmp_path, options, words):
    with pytest.raises(ValueError, match=words):
        subset.subset(whole, str(tmp_path / 'few'), **options)
    assert not (tmp_path / 'few').exists()


def test_kinds_of_the_command_line():
    assert subset.kinds_of([]) == {} and subset.kinds_of(['lift', 'grid:20']) == {
        'lift': 0,
        'grid': 20,
    }
    for texts in (['lift:'], ['lift:0'], ['lift:-2'], ['lift:x'], ['lift', 'lift:2']):
        with pytest.raises(ValueError, match='kinds are named once, as lift or grid:20, got lift'):
            subset.kinds_of(texts)


def test_a_finished_dataset_is_replaced_only_when_told(whole, tmp_path):
    out = str(tmp_path / 'few')
    subset.subset(whole, out, 1)
    with pytest.raises(ValueError, match='use --overwrite to replace it'):
        subset.subset(whole, out, 2)
    assert subset.subset(whole, out, 2, overwrite=True)['dataset_split']['train'] == [2, 6]


def test_runs_are_dealt_to_other_splits_with_all_that_is_known_of_them(whole, tmp_path):
    out = str(tmp_path / 'dealt')
    dealt = subset.deal(whole, out, {'train': [6, 0], 'valid': [4], 'test': [1, 5]})
    # Counted through train (1, 2, 4, 6), valid (3, 7) and test (5).
    assert dealt['dataset_split'] == {'train': [5, 1], 'valid': [3], 'test': [2, 7]}
    base = files.read_json(f'{whole}/metadata.json')
    old = [(split, place) for split in ('train', 'valid', 'test')
           for place in range(len(base['dataset_split'][split]))]  # fmt: skip
    for split, places in {'train': [6, 0], 'valid': [4], 'test': [1, 5]}.items():
        for new, place in enumerate(places):
            was, at = old[place]
            run, sample = (
                dataset.read_split(out, split)[new],
                particles.read_sample(out, split)[new],
            )
            np.testing.assert_array_equal(run.position, dataset.read_split(whole, was)[at].position)
            np.testing.assert_array_equal(sample, particles.read_sample(whole, was)[at])
            assert dealt['projection_mse'][split][new] == base['projection_mse'][was][at]
    assert Subspace.load(f'{out}/subspace.npz').digest == base['pca']['digest']
    assert files.check_manifest(out)
    with pytest.raises(ValueError):
        subset.deal(whole, out, {'train': [0]})


def test_dataset_that_trains_on_nothing(whole, tmp_path):
    raw = synthetic.write_raw_folder(str(tmp_path / 'new'), 'excavation', (8, 9))
    tested = str(tmp_path / 'tested')
    convert.convert(raw, tested, like=whole)
    with pytest.raises(ValueError, match=r"has no training runs to choose from, only \['test'\]"):
        subset.subset(tested, str(tmp_path / 'few'))
    dealt = subset.deal(tested, str(tmp_path / 'dealt'), {'train': [1], 'test': [0]})
    assert dealt['dataset_split'] == {'train': [9], 'test': [8]}
