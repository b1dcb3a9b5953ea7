"""A dataset with fewer training runs, against the larger one it comes from."""

import numpy as np
import pytest

from pca_tools import convert, dataset, files, particles, subset
from pca_tools.metadata import SPLITS
from pca_tools.subspace import Subspace
from tests.pca_tools.synthetic import write_raw_folder


@pytest.fixture(scope='module')
def whole(tmp_path_factory):
    """Cases 1, 2, 4, 6 in train, 3 and 7 in valid, 5 in test; 2 and 6 are lifts, 7 stops."""
    folder = tmp_path_factory.mktemp('whole')
    raw = write_raw_folder(
        folder / 'raw', 'excavation', range(1, 8),
        split=lambda case: {3: 'valid', 5: 'test', 7: 'valid'}.get(case, 'train'),
        kind=lambda case: {2: 'lift', 6: 'lift', 7: 'stops'}.get(case, 'grid'),
    )  # fmt: skip
    convert.convert(raw, str(folder / 'data'), modes=5)
    return str(folder / 'data')


def check_runs(out, whole):
    """All that is known of each run is what the whole dataset holds of it."""
    few, base = (files.read_json(f'{folder}/metadata.json') for folder in (out, whole))
    places = {case: (s, i) for s in SPLITS for i, case in enumerate(base['dataset_split'][s])}
    assert Subspace.load(f'{out}/subspace.npz').digest == base['pca']['digest']
    for split, cases in few['dataset_split'].items():
        records, sample = dataset.read_split(out, split), particles.read_sample(out, split)
        for place, case in enumerate(cases):
            was, old = places[case]
            record = dataset.read_split(whole, was)[old]
            assert records[place].key == place
            np.testing.assert_array_equal(records[place].position, record.position)
            np.testing.assert_array_equal(records[place].force, record.force)
            np.testing.assert_array_equal(sample[place], particles.read_sample(whole, was)[old])
            for key in ('projection_mse', 'projection_max_mm', 'motion_kept', 'cases'):
                assert few[key][split][place] == base[key][was][old]
    for key in ('vel_mean', 'acc_std', 'scene', 'bounds', 'sequence_length', 'pca'):
        assert few[key] == base[key], key
    assert files.check_manifest(out)


@pytest.mark.parametrize(
    ('options', 'cases'),
    [
        ({'train_runs': 2}, [2, 6]),
        ({'kinds': ['lift']}, [2, 6]),
        ({'kinds': ['grid'], 'train_runs': 1}, [4]),
        ({'kinds': ['grid'], 'every_split': True}, [1, 4]),
        ({}, [1, 2, 4, 6]),
    ],
)
def test_runs_are_those_of_the_whole(whole, tmp_path, options, cases):
    few = subset.subset(whole, str(tmp_path / 'few'), **options)
    valid = [3] if 'every_split' in options else [3, 7]
    assert few['dataset_split'] == {'train': cases, 'valid': valid, 'test': [5]}
    check_runs(str(tmp_path / 'few'), whole)


def test_runs_are_dealt_to_other_splits_with_all_that_is_known_of_them(whole, tmp_path):
    # Counted through train (1, 2, 4, 6), valid (3, 7) and test (5).
    places = {'train': [6, 0], 'valid': [4], 'test': [1, 5]}
    dealt = subset.deal(whole, str(tmp_path / 'dealt'), places)
    assert dealt['dataset_split'] == {'train': [5, 1], 'valid': [3], 'test': [2, 7]}
    check_runs(str(tmp_path / 'dealt'), whole)
    with pytest.raises(ValueError, match='use --overwrite'):
        subset.deal(whole, str(tmp_path / 'dealt'), {'train': [0]})
    assert subset.subset(whole, str(tmp_path / 'dealt'), 1, overwrite=True)


@pytest.mark.parametrize(
    ('options', 'words'),
    [
        ({'train_runs': 5}, 'such training runs: there are 4, 5 were asked for'),
        ({'kinds': ['grid'], 'train_runs': 3}, 'such training runs: there are 2, 3 were asked for'),
        ({'kinds': ['lift', 'sea']}, r"trains on no \['sea'\], only \['grid', 'lift'\]"),
        ({'kinds': ['lift'], 'every_split': True}, r"valid, test without a run of \['lift'\]"),
        ({'every_split': True}, 'no kinds were named'),
    ],
)
def test_what_is_not_there_is_refused(whole, tmp_path, options, words):
    with pytest.raises(ValueError, match=words):
        subset.subset(whole, str(tmp_path / 'few'), **options)
    assert not (tmp_path / 'few').exists()


def test_dataset_that_trains_on_nothing(whole, tmp_path):
    raw, tested = write_raw_folder(tmp_path / 'raw', 'excavation', (8, 9)), str(tmp_path / 'tested')
    convert.convert(raw, tested, like=whole)
    with pytest.raises(ValueError, match=r"has no training runs to choose from, only \['test'\]"):
        subset.subset(tested, str(tmp_path / 'few'))
    dealt = subset.deal(tested, str(tmp_path / 'dealt'), {'train': [1], 'test': [0]})
    assert dealt['dataset_split'] == {'train': [9], 'test': [8]}
