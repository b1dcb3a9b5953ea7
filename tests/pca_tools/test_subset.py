"""A dataset with fewer training runs, against the larger one it comes from."""

import numpy as np
import pytest

from pca_tools import convert, dataset, files, subset
from pca_tools.heights import Heights
from pca_tools.particles import ParticleSample
from pca_tools.subspace import Subspace
from tests.pca_tools.test_heights import raw_folder


@pytest.fixture(scope='module')
def whole(tmp_path_factory):
    """Cases 1, 2, 4, 6 in train, 3 and 7 in valid, 5 in test; 2 and 6 are lifts, 7 stops."""
    folder = tmp_path_factory.mktemp('whole')
    raw = raw_folder(
        folder / 'raw', range(1, 8),
        split=lambda case: {3: 'valid', 5: 'test', 7: 'valid'}.get(case, 'train'),
        kind=lambda case: {2: 'lift', 6: 'lift', 7: 'stops'}.get(case, 'grid'),
    )  # fmt: skip
    convert.convert(raw, str(folder / 'data'), modes=5)
    return str(folder / 'data')


KEYS = ('projection_mse', 'projection_max_mm', 'motion_kept', 'cases')


def check_runs(out, whole):
    """All that is known of each run is what the whole dataset holds of it."""
    few, base = (files.read_json(f'{folder}/metadata.json') for folder in (out, whole))
    assert Subspace.load(f'{out}/subspace.npz').digest == base['pca']['digest']
    held = {}  # case -> what the whole dataset says of it
    for split, cases in base['dataset_split'].items():
        series = [kind.read(whole, split) for kind in (ParticleSample, Heights)]
        for place, (case, record) in enumerate(zip(cases, dataset.read_split(whole, split))):
            known = {key: base[key][split][place] for key in KEYS}
            held[case] = record, [kept[place] for kept in series], known
    for split, cases in few['dataset_split'].items():
        series = [kind.read(out, split) for kind in (ParticleSample, Heights)]
        for place, (case, run) in enumerate(zip(cases, dataset.read_split(out, split))):
            record, kept, known = held[case]
            assert run.key == place
            np.testing.assert_array_equal(run.position, record.position)
            np.testing.assert_array_equal(run.force, record.force)
            for values, wanted in zip(series, kept):
                np.testing.assert_array_equal(values[place], wanted)
            assert {key: few[key][split][place] for key in KEYS} == known
    for key in ('vel_mean', 'acc_std', 'scene', 'bounds', 'sequence_length', 'pca'):
        assert few[key] == base[key], key
    assert files.check_manifest(out)


@pytest.mark.parametrize(
    ('options', 'cases'),
    [
        ({'train_runs': 2}, [2, 6]),
        ({'kinds': ['grid'], 'train_runs': 1}, [4]),
        ({'kinds': ['grid'], 'every_split': True}, [1, 4]),
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
        ({'train_runs': 5}, 'has 4 such training runs, not 5'),
        ({'kinds': ['grid'], 'train_runs': 3}, 'has 2 such training runs, not 3'),
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
    raw = raw_folder(tmp_path / 'raw', (8, 9), split=None)
    tested = str(tmp_path / 'tested')
    convert.convert(raw, tested, like=whole)
    with pytest.raises(ValueError, match=r"has no training runs to choose from, only \['test'\]"):
        subset.subset(tested, str(tmp_path / 'few'))
    dealt = subset.deal(tested, str(tmp_path / 'dealt'), {'train': [1], 'test': [0]})
    assert dealt['dataset_split'] == {'train': [9], 'test': [8]}
