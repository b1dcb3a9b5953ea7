"""Folds that judge every run once, sizes, and their documents: trainings are left out."""

import os
import types

import pytest

from pca_tools import convert, dataset, files
from reports.protocol import __main__ as command
from reports.protocol import parts
from tests.pca_tools import synthetic as raw_runs
from tests.reports.protocol import known


@pytest.mark.parametrize(('n_run', 'n_fold', 'n_valid'), [(11, 4, 2), (12, 4, 3), (3, 3, 1)])
def test_each_run_is_judged_once_and_never_trains_where_it_is(n_run, n_fold, n_valid):
    folds = parts.deal(n_run, n_fold, n_valid)
    assert sorted(run for fold in folds for run in fold['test']) == list(range(n_run))
    for fold in folds:
        assert sorted(run for part in fold.values() for run in part) == list(range(n_run))
        assert len(fold['valid']) == n_valid


@pytest.mark.parametrize(
    ('n_run', 'n_fold', 'n_valid', 'said'),
    [(3, 4, 1, '4 folds of 3'), (4, 1, 1, '1 folds'), (4, 2, 2, '2 runs of 2')],
)
def test_refuses_folds_that_leave_nothing_to_train(n_run, n_fold, n_valid, said):
    with pytest.raises(ValueError, match=said):
        parts.deal(n_run, n_fold, n_valid)


@pytest.fixture
def data(tmp_path):
    raw = raw_runs.write_raw_folder(str(tmp_path / 'raw'), 'excavation', range(1, 8))
    convert.convert(raw, str(tmp_path / 'mine'), modes=3)
    return str(tmp_path / 'mine')


def test_folds_are_datasets_that_hold_the_runs_of_all_splits(data, tmp_path):
    work = str(tmp_path / 'work')
    folders = parts.folds(data, 3, 1, work)
    cases = [dataset.read_metadata(folder)['dataset_split'] for folder in folders]
    assert sorted(case for fold in cases for case in fold['test']) == list(range(1, 8))
    for folder, fold in zip(folders, cases, strict=True):
        assert files.check_manifest(folder)
        assert sorted(case for part in fold.values() for case in part) == list(range(1, 8))
    os.remove(os.path.join(work, 'folds.json'))  # as if the call had been killed before
    assert parts.folds(data, 3, 1, work) == folders
    with pytest.raises(ValueError, match='other runs or another number'):
        parts.folds(data, 2, 1, work)


def test_a_size_is_a_dataset_with_the_same_test_runs(data, tmp_path):
    path = parts.of_size(data, 2, str(tmp_path / 'work'))
    assert os.path.basename(path) == 'mine_2' and len(dataset.read_split(path, 'train')) == 2
    assert (
        dataset.read_metadata(path)['dataset_split']['test']
        == (dataset.read_metadata(data)['dataset_split']['test'])
    )
    assert parts.of_size(data, 2, str(tmp_path / 'work')) == path
    with pytest.raises(ValueError, match='7'):
        parts.of_size(data, 7, str(tmp_path / 'work'))


def test_the_document_of_folds_has_every_run_of_every_seed():
    one, other = (known.document(7, scale) | {'schema_version': 1, 'scene': 's', 'record': {}}
                  for scale in (1.0, 2.0))  # fmt: skip
    for document in (one, other):
        for method in document['methods']:
            method['baseline'] = method['name'] == 'path ridge'
    found = parts.joined([one, other])
    assert found['folds'] == 2 and len(found['runs']['test']) == 6
    first = found['methods'][0]['seeds'][0]['runs']['test']
    assert [run['soil_mm'] for run in first] == [2.0, 4.0, 99.0, 4.0, 8.0, 198.0]


@pytest.mark.parametrize(
    'given, reason',
    [
        ({'sizes': ['many']}, r"--sizes are numbers of training runs, got \['many'\]"),
        ({'folds': 3, 'model': ['a=b']}, '--train is needed alone'),
        ({'folds': 3, 'train': []}, '--train is needed alone'),
        ({'folds': 3, 'sizes': ['7']}, 'one of them'),
    ],
)
def test_parts_want_trainings(tmp_path, given, reason):
    values = {'sizes': [], 'folds': 0, 'model': [], 'train': ['mlp'], 'data_path': []}
    with pytest.raises(ValueError, match=reason):
        command.main(types.SimpleNamespace(**values | given, output_path=str(tmp_path)), [])
