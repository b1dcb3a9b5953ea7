"""Inspection: good datasets pass, each defect is named with its level."""

import dataclasses
import json
import os
import re
import shutil

import numpy as np
import pytest

from pca_tools import convert, dataset, files, inspect, subset
from pca_tools.inspect import ERROR, OK, WARN, inspect_folder, report
from tests.pca_tools.commands import REPOSITORY, call_command
from tests.pca_tools.synthetic import write_raw_folder


@pytest.fixture
def copy(excavation, tmp_path):
    """A copy of the excavation dataset that may be changed."""
    return str(shutil.copytree(excavation, tmp_path / 'copy'))


def renew_manifest(folder):
    names = [n for n in os.listdir(folder) if n.endswith(('.tfrecord', '.npz', 'metadata.json'))]
    files.write_manifest(folder, {name: {} for name in names})


def change_metadata(folder, **changes):
    """Changes the metadata, `...` takes a key out, and lets the manifest follow."""
    path = os.path.join(folder, 'metadata.json')
    held = {**files.read_json(path), **changes}
    files.write_json(path, {key: value for key, value in held.items() if value is not ...})
    renew_manifest(folder)


def change_runs(folder, split, change):
    runs = [change(i, run) for i, run in enumerate(dataset.read_split(folder, split))]
    dataset.write_split(dataset.split_path(folder, split), runs)
    renew_manifest(folder)


def told(folder):
    """Level -> all that an inspection says on it."""
    texts = {level: [] for level in (OK, WARN, ERROR)}
    for level, text in inspect_folder(folder).findings:
        texts[level].append(text)
    return {level: ' | '.join(found) for level, found in texts.items()}


@pytest.mark.parametrize('name', ['excavation', 'wheel'])
def test_good_datasets_pass(name, request):
    inspection = inspect_folder(request.getfixturevalue(name))
    assert not inspection.failed, inspection.findings
    text = report(inspection)
    for part in (f'scene {name}', 'motion energy kept'):
        assert part in text
    assert 'particle samples (140 particles, every 4 frames, to 0.02 mm)' in text
    assert len(inspection.runs) == 6 and inspection.n_soil == 140


def test_runs_that_the_modes_do_not_hold_are_named(copy):
    held = files.read_json(f'{copy}/metadata.json')
    usual = np.mean(held['projection_mse']['train'])
    errors = held['projection_mse'] | {'valid': [usual], 'test': [usual]}
    change_metadata(copy, projection_mse=errors)
    assert 'these runs do something' not in told(copy)[WARN]
    errors['test'][0] = 30.0**2 * usual
    change_metadata(copy, projection_mse=errors)
    case, far = held['dataset_split']['test'][0], 1e3 * 30.0 * usual**0.5
    assert f'far more of case {case} of test ({far:.3g} mm): these runs' in told(copy)[WARN]
    errors['train'][0] = 31.0**2 * usual  # training has seen as much
    change_metadata(copy, projection_mse=errors)
    assert 'these runs do something' not in told(copy)[WARN]


def test_authors_folders_pass_with_their_defects_named(original):
    inspection = inspect_folder(original)
    assert not inspection.failed, inspection.findings
    warnings = told(original)[WARN]
    for defect in (
        'no manifest.json', 'begin with the same frame twice', 'keys are [0], not the index',
        'drawn with replacement', 'is a git-lfs pointer',
    ):  # fmt: skip
        assert defect in warnings
    if 'Excavation' in original:
        assert 'particles_rigid says 15 but 4 of 11 runs have 15, 7 of 11 runs have 20' in warnings
    assert inspection.n_soil == (4880 if 'Excavation' in original else 6005)


def test_exit_codes(excavation, tmp_path, capsys):
    assert inspect.main(None, [excavation]) == 0
    assert '0 ERROR' in capsys.readouterr().out
    bad = call_command('pca_tools.inspect', str(tmp_path))
    assert bad.returncode == 1 and 'metadata.json: no such file' in bad.stdout


def test_damaged_and_missing_files(copy, wheel):
    path = os.path.join(copy, 'valid.tfrecord')
    with open(path, 'rb+') as file:
        file.truncate(os.path.getsize(path) - 3)
    errors = told(copy)[ERROR]
    assert 'the manifest says' in errors and 'ends 3 bytes too early' in errors
    with open(path, 'wb') as file:
        file.write(b'version https://git-lfs.github.com/spec/v1\nsize 99\n')
    assert 'git-lfs pointer' in told(copy)[ERROR]
    os.remove(path)
    shutil.copy(f'{wheel}/subspace.npz', os.path.join(copy, 'subspace.npz'))
    shutil.copy(f'{copy}/particles_test.npz', f'{copy}/particles_train.npz')
    renew_manifest(copy)
    _, warnings, errors = told(copy).values()
    assert 'there is no valid.tfrecord' in warnings and 'digest is' in errors
    assert 'particles_train.npz: holds other runs than train.tfrecord' in errors
    os.remove(os.path.join(copy, 'subspace.npz'))
    with open(f'{copy}/particles_train.npz', 'wb') as file:
        file.write(b'PK')
    errors = told(copy)[ERROR]
    assert 'subspace.npz: no such file' in errors and 'particles_train.npz: is not a' in errors
    with open(os.path.join(copy, 'metadata.json'), 'w', encoding='utf-8') as file:
        json.dump({'dim': 3}, file)
    inspection = inspect_folder(copy)
    assert inspection.failed and 'lacks bounds' in report(inspection)


def test_statistics_divided_by_dt(copy, excavation, tmp_path):
    std, few = dataset.read_metadata(copy)['vel_std'], str(tmp_path / 'few')
    faster = [60 * value for value in std]
    change_metadata(copy, vel_std=faster)
    assert 'vel_std is [' in told(copy)[ERROR]
    # a folder that does not say which cases its statistics are of, as the authors'
    text = 'vel_std is 60 times that of the training records (1 / dt is 60)'
    change_metadata(copy, cases=...)
    assert text in told(copy)[ERROR]
    # statistics are those of the runs that were there first
    subset.subset(excavation, few, train_runs=3)
    fine, _, errors = told(few).values()
    assert not errors
    assert 'training records in size: they are of the 4 runs that the subspace' in fine
    change_metadata(few, vel_std=faster)
    assert ' times that of the training records (1 / dt is 60)' in told(few)[ERROR]


def test_torque_of_some_runs_and_without_statistics(copy):
    change_runs(
        copy, 'train', lambda i, run: dataclasses.replace(run, torque=run.force if i < 2 else None)
    )
    text = report(inspect_folder(copy))
    assert 'records have rigid_body_torque_std [' in text and ', 0 ERROR' in text
    assert 'torque (2 runs)' in text


@pytest.mark.parametrize('name', ['excavation', 'excavation_wide', 'wheel'])
def test_shipped_datasets_pass(name):
    inspection = inspect_folder(str(REPOSITORY / 'datasets' / name))
    assert not inspection.failed, inspection.findings


@pytest.mark.parametrize(
    ('changes', 'level', 'text'),
    [
        ({'dt': 60.0}, ERROR, 'is it in frames per second'),
        ({'dt': 2e-4}, ERROR, 'dt or the unit of length is wrong'),
        ({'mode_number': 7}, ERROR, 'record 3: has 8 mode nodes .*mode_number is 8, .* says 7'),
        ({'vel_std': [0.0, 1.0, 1.0]}, WARN, r'vel_std is 0 at \[0\]'),
    ],
)
def test_metadata_of_other_data(copy, changes, level, text):
    change_metadata(copy, **changes)
    assert re.search(text, told(copy)[level])


def test_still_runs_bent_bodies_and_wrong_types(copy):
    def freeze(index, run):
        position = np.broadcast_to(run.position[:1], run.position.shape).copy()
        return dataclasses.replace(run, position=position, force=np.zeros_like(run.force))

    def bend(index, run):
        run.position[10:, 0, 1] += 0.05 * (index == 3)
        return run

    def retype(index, run):
        return dataclasses.replace(run, particle_type=np.array([0] * 20 + [6] * 8))

    change_runs(copy, 'valid', freeze)
    change_runs(copy, 'train', bend)
    change_runs(copy, 'test', retype)
    _, warnings, errors = told(copy).values()
    assert "nothing moves from first to last frame in ['valid 0']" in warnings
    assert '1 runs have no force' in warnings
    assert '1 of 6 runs begin with the same frame twice' in warnings
    assert 'the rigid body changes its shape' in errors
    assert '1 runs have rigid nodes that are not of type 3' in errors


def test_duplicates_and_leaking_cases(copy):
    runs = dataset.read_split(copy, 'train')
    change_runs(copy, 'train', lambda index, run: runs[0] if index == 3 else run)
    same = 'the same run lies in the file more than once: train 0 = train 3'
    assert same in told(copy)[WARN]
    change_runs(copy, 'test', lambda index, run: runs[0])
    held = dataset.read_metadata(copy)
    leak = {
        key: {**held[key], 'test': held[key]['train'][:1]} for key in ('dataset_split', 'cases')
    }
    change_metadata(copy, **leak)
    errors = told(copy)[ERROR]
    assert 'the same run lies in different splits: train 0 = train 3 = test 0' in errors
    assert 'are in train and test' in errors and 'which are not training runs' in errors


def test_report_by_kind(tmp_path):
    raw = write_raw_folder(
        tmp_path / 'raw', 'excavation', range(1, 7), frames=5,
        kind=lambda case: 'grid' if case % 3 else 'lift',
    )  # fmt: skip
    metadata = convert.convert(raw, str(tmp_path / 'out'))
    text = report(inspect_folder(str(tmp_path / 'out')))
    rows = [[cell.strip() for cell in line.split('|')] for line in text.splitlines()]
    train = [case['kind'] for case in metadata['cases']['train']]
    lift = next(row for row in rows if row[1:2] == ['lift'])
    assert lift[2].split()[0] == str(train.count('lift')) and lift[2].endswith('%)')
