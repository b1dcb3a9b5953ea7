"""Cross-validation: folds that judge every run once, and a table from known errors."""

import os
import types

import numpy as np
import pytest

from pca_tools import convert, dataset, files
from reports import cross_validation
from reports.protocol import rollouts
from tests.learning_to_simulate import synthetic
from tests.pca_tools import synthetic as raw_runs


@pytest.mark.parametrize(('n_run', 'n_fold', 'n_valid'), [(11, 4, 2), (12, 4, 3), (3, 3, 1)])
def test_each_run_is_judged_once_and_never_trains_where_it_is(n_run, n_fold, n_valid):
    folds = cross_validation.deal(n_run, n_fold, n_valid)
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
        cross_validation.deal(n_run, n_fold, n_valid)


@pytest.fixture
def records(tmp_path):
    """A folder as the authors' are: records and metadata, no manifest."""
    folder = synthetic.write_dataset(tmp_path / 'records', n_run=6)
    if os.path.exists(os.path.join(folder, files.MANIFEST_NAME)):
        os.remove(os.path.join(folder, files.MANIFEST_NAME))
    return folder


def test_folds_hold_the_runs_of_all_splits(records, tmp_path):
    whole = [
        run for split in ('train', 'valid', 'test') for run in dataset.read_split(records, split)
    ]
    work = str(tmp_path / 'work')
    folders = cross_validation.make_folds(records, 2, 1, work)
    judged = [run for folder in folders for run in dataset.read_split(folder, 'test')]
    assert len(judged) == len(whole)
    for run in judged:
        assert any(np.array_equal(run.position, other.position) for other in whole)
    trained = dataset.read_split(folders[0], 'train') + dataset.read_split(folders[0], 'valid')
    for run in dataset.read_split(folders[0], 'test'):
        assert not any(np.array_equal(run.position, other.position) for other in trained)
    assert cross_validation.make_folds(records, 2, 1, work) == folders
    with pytest.raises(ValueError, match='other runs or another number'):
        cross_validation.make_folds(records, 3, 1, work)


def test_folds_of_a_converted_dataset_are_datasets(tmp_path):
    raw = raw_runs.write_raw_folder(str(tmp_path / 'raw'), 'excavation', range(1, 8))
    data, work = str(tmp_path / 'data'), str(tmp_path / 'work')
    convert.convert(raw, data, modes=3)
    folders = cross_validation.make_folds(data, 3, 1, work)
    cases = [dataset.read_metadata(folder)['dataset_split'] for folder in folders]
    assert sorted(case for fold in cases for case in fold['test']) == list(range(1, 8))
    for folder, fold in zip(folders, cases, strict=True):
        assert files.check_manifest(folder)
        assert sorted(case for part in fold.values() for case in part) == list(range(1, 8))
    os.remove(os.path.join(work, 'folds.json'))  # as if the call had been killed before
    assert cross_validation.make_folds(data, 3, 1, work) == folders


def test_the_table_counts_wins_and_means_by_seed(tmp_path):
    def runs(soils, forces):
        return [
            {'soil_mse': s, 'force_relative_l2': f, 'force_mpe': -100 * f}
            for s, f in zip(soils, forces, strict=True)
        ]

    trivial = {'stay_still': runs([2e-4, 2e-4], [1, 1]),
               'constant_velocity': runs([1e-4, 4e-4], [1, 1])}  # fmt: skip
    seeds = [{'model': runs([0.5e-4, 3e-4], [0.1, 0.3])} | trivial,
             {'model': runs([0.5e-4, 1e-4], [0.2, 0.2])} | trivial]  # fmt: skip
    row = {'data': 'a', 'method': 'pcg', 'folds': 2, 'seeds': seeds}
    path = str(tmp_path / 'cv.json')
    files.write_json(path, {'schema_version': 1, 'rows': {'a pcg': row}})
    lines = cross_validation.table(path).splitlines()
    assert lines[2].startswith('| a, 2 | *persistence* |  | 2 | 2 |')
    soil = '1.25 (0.75 to 1.75)'
    cells = f'| a, 2 | pcg (2 seeds) | 1 | {soil} | {soil} | wins 1.5 (1 to 2) of 2 | 0.2 | 20 |'
    assert lines[-1] == cells


def test_every_run_is_predicted_by_a_model_of_its_fold(records, tmp_path, monkeypatch):
    """Trainings and rollouts, which have tests of their own, are replaced by what was asked."""
    trained = {}

    def train(data_path, model_path, training):
        trained[model_path] = (data_path, training)

    def roll_out(data_path, model_path, split, folder):
        assert trained[model_path][0] == data_path and split == 'test'
        output = os.path.join(folder, os.path.basename(model_path))
        os.makedirs(output)
        runs = [
            {'soil_mse': float(run.position.mean())} for run in dataset.read_split(data_path, split)
        ]
        files.write_json(os.path.join(output, 'metrics.json'), {'runs': {'model': runs}})
        return output

    monkeypatch.setattr(rollouts, 'train', train)
    monkeypatch.setattr(rollouts, 'roll_out', roll_out)
    work = str(tmp_path / 'work')
    folders = cross_validation.make_folds(records, 3, 1, work)
    for seed in range(2):
        found = cross_validation.measure(folders, 'pcg --modes=2', seed, work)
        expected = [
            float(run.position.mean()) for f in folders for run in dataset.read_split(f, 'test')
        ]
        assert [run['soil_mse'] for run in found['model']] == expected
    flags = [training for _, training in trained.values()]
    assert flags == [
        ['--preset=pcg', '--modes=2', f'--seed={seed}'] for seed in range(2) for _ in range(3)
    ]
    cross_validation.measure(folders, 'path_ridge --max_samples=60', 0, work)
    assert trained.popitem()[1][1] == ['--preset=path_ridge', '--max_samples=60']
    with pytest.raises(ValueError, match='unknown preset'):
        cross_validation.measure(folders, 'pgc', 0, work)


def test_what_draws_nothing_is_trained_once(records, tmp_path, monkeypatch):
    """Whatever --num_seeds says; two folds each."""
    asked = []

    def measure(folders, method, seed, work_path):
        asked.append((method, seed))
        run = {'soil_mse': 1e-4, 'force_relative_l2': 0.5, 'force_mpe': 1.0}
        return dict.fromkeys(('model', 'stay_still', 'constant_velocity'), [run] * 6)

    monkeypatch.setattr(cross_validation, 'measure', measure)
    values = types.SimpleNamespace(
        data_path=records, work_path=str(tmp_path / 'work'), num_folds=2, num_valid=1, num_seeds=2,
        train=['path_ridge_few_runs', 'pcg'], output_path=str(tmp_path / 'found.json'),
    )  # fmt: skip
    with pytest.raises(ValueError, match='unknown preset'):  # before anything is done
        cross_validation.main(types.SimpleNamespace(**vars(values) | {'train': ['pcg', 'pgc']}), [])
    assert not asked and not os.path.exists(values.work_path)
    cross_validation.main(values, [])
    assert asked == [('path_ridge_few_runs', 0), ('pcg', 0), ('pcg', 1)]
    rows = files.read_json(values.output_path)['rows']
    assert [len(row['seeds']) for row in rows.values()] == [1, 2]
