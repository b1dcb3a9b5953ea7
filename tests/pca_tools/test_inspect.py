"""Inspection: good datasets pass, each defect is named with its level."""

import dataclasses
import json
import os
import shutil

import numpy as np
import pytest

from pca_tools import convert, dataset, files, particles, subset
from pca_tools.inspect import Level, inspect_folder, report
from pca_tools.statistics import trivial_errors
from pca_tools.subspace import Subspace
from tests.pca_tools import synthetic
from tests.pca_tools.commands import REPOSITORY, run_command


@pytest.fixture
def copy(excavation, tmp_path):
    """A copy of the excavation dataset that may be changed."""
    return shutil.copytree(excavation, tmp_path / 'copy')


def change_metadata(folder, **changes):
    """Changes the metadata and lets the manifest follow."""
    path = os.path.join(folder, 'metadata.json')
    files.write_json(path, {**files.read_json(path), **changes})
    renew_manifest(folder)


def renew_manifest(folder):
    listed = {
        name: {}
        for name in os.listdir(folder)
        if name.endswith(('.tfrecord', '.npz')) or name == 'metadata.json'
    }
    files.write_manifest(str(folder), listed)


def change_runs(folder, split, change):
    runs = [change(i, run) for i, run in enumerate(dataset.read_split(str(folder), split))]
    dataset.write_split(dataset.split_path(str(folder), split), runs)
    renew_manifest(folder)


def texts(folder, level):
    found = inspect_folder(str(folder)).findings
    return ' | '.join(finding.text for finding in found if finding.level is level)


@pytest.mark.parametrize('name', ['excavation', 'wheel'])
def test_good_datasets_pass(name, request):
    inspection = inspect_folder(request.getfixturevalue(name))
    assert not inspection.failed, inspection.findings
    text = report(inspection)
    assert f'scene {name}' in text and '<- kept' in text and 'motion energy kept' in text
    assert len(inspection.runs) == 12 and inspection.n_soil == 140


def test_runs_that_the_modes_do_not_hold_are_named(copy):
    held = files.read_json(f'{copy}/metadata.json')
    assert 'these runs do something' not in texts(copy, Level.WARN)
    errors = held['projection_mse']
    usual = np.mean(errors['train'])
    errors['test'][0] = 30.0**2 * usual
    change_metadata(copy, projection_mse=errors)
    case, far = held['dataset_split']['test'][0], 1e3 * 30.0 * usual**0.5
    assert f'far more of case {case} of test ({far:.3g} mm): these runs' in texts(copy, Level.WARN)
    errors['train'][0] = 31.0**2 * usual  # training has seen as much
    change_metadata(copy, projection_mse=errors)
    assert 'these runs do something' not in texts(copy, Level.WARN)


def test_authors_folders_pass_with_their_defects_named(original):
    inspection = inspect_folder(original)
    assert not inspection.failed, inspection.findings
    warnings = texts(original, Level.WARN)
    for defect in (
        'no manifest.json',
        'begin with the same frame twice',
        'keys are [0], not the index',
        'it was drawn with replacement',
        'is a git-lfs pointer',
        'were fitted on all runs',
    ):
        assert defect in warnings
    if 'Excavation' in original:
        assert 'particles_rigid says 15 but 4 of 11 runs have 15, 7 of 11 runs have 20' in warnings
        assert 'eigenvalues of 200 runs' in warnings
        # seed-facts: the published floor of 8 modes is 0.158e-4 m^2
        assert 1e4 * inspection.floors[8] == pytest.approx(0.158, abs=0.001)
    else:
        assert '155 of 6005 values are negative' in warnings and 'complex128' in warnings
        assert 'eigenvalues of 243 runs' in warnings
    assert 'constant velocity' in report(inspection)


def test_command_line_exit_codes(excavation, tmp_path):
    good = run_command('pca_tools.inspect', '--modes=3', excavation)
    assert good.returncode == 0, good.stderr
    assert '0 ERROR' in good.stdout
    bad = run_command('pca_tools.inspect', str(tmp_path))
    assert bad.returncode == 1 and 'metadata.json: no such file' in bad.stdout
    usage = run_command('pca_tools.inspect')
    assert usage.returncode == 1 and usage.stderr.strip().endswith('DATASET')


def test_damaged_files(copy):
    path = os.path.join(copy, 'valid.tfrecord')
    with open(path, 'rb+') as file:
        file.truncate(os.path.getsize(path) - 3)
    errors = texts(copy, Level.ERROR)
    assert 'the manifest says' in errors and 'ends 3 bytes too early' in errors
    with open(path, 'wb') as file:
        file.write(b'version https://git-lfs.github.com/spec/v1\nsize 99\n')
    assert 'git-lfs pointer' in texts(copy, Level.ERROR)


def test_nan_and_wrong_counts_are_located(copy):
    change_metadata(copy, mode_number=7)
    errors = texts(copy, Level.ERROR)
    assert 'train.tfrecord: record 9: has 8 mode nodes' in errors
    assert 'mode_number is 8, the metadata says 7' in errors


def test_statistics_divided_by_dt(copy):
    held = dataset.read_metadata(str(copy))
    faster = {key: (np.array(held[key]) * 60).tolist() for key in ('vel_mean', 'vel_std')}
    change_metadata(copy, **faster)
    assert 'vel_std is [' in texts(copy, Level.ERROR)
    # a folder that does not say which cases its statistics are of, as the authors'
    path = os.path.join(copy, 'metadata.json')
    held = {key: value for key, value in files.read_json(path).items() if key != 'cases'}
    files.write_json(path, held)
    renew_manifest(copy)
    assert 'vel_std is 60 times that of the training records (1 / dt is 60)' in texts(
        copy, Level.ERROR
    )


def test_statistics_are_those_of_the_runs_that_were_there_first(excavation, copy, tmp_path):
    few = str(tmp_path / 'few')
    subset.subset(excavation, few, train_runs=3)
    assert not texts(few, Level.ERROR)
    assert 'training records in size: they are of the 10 runs that the subspace' in texts(
        few, Level.OK
    )
    held = dataset.read_metadata(few)
    change_metadata(few, vel_std=(np.array(held['vel_std']) * 60).tolist())
    assert ' times that of the training records (1 / dt is 60)' in texts(few, Level.ERROR)


@pytest.mark.parametrize('name', ['excavation_v2', 'wheel_v2'])
def test_shipped_datasets_that_grew_pass(name):
    inspection = inspect_folder(str(REPOSITORY / 'datasets' / name))
    assert not inspection.failed, inspection.findings


def test_runs_of_fewer_frames_than_a_model_is_given(tmp_path):
    raw = synthetic.write_raw_folder(str(tmp_path / 'raw'), 'excavation', range(1, 6), frames=5)
    data = str(tmp_path / 'data')
    convert.convert(raw, data, modes=3)
    assert 'train: 3 runs of 6 frames or fewer' in report(inspect_folder(data))


def test_dt_and_units(copy):
    change_metadata(copy, dt=60.0)
    assert 'is it in frames per second?' in texts(copy, Level.ERROR)
    change_metadata(copy, dt=2e-4)
    assert 'dt or the unit of length is wrong' in texts(copy, Level.ERROR)


def test_zero_deviation_still_run_and_no_force(copy):
    change_metadata(copy, vel_std=[0.0, 1.0, 1.0])
    assert 'vel_std is 0 at [0]' in texts(copy, Level.WARN)

    def freeze(index, run):
        position = np.broadcast_to(run.position[:1], run.position.shape).copy()
        return dataclasses.replace(run, position=position, force=np.zeros_like(run.force))

    change_runs(copy, 'valid', freeze)
    warnings = texts(copy, Level.WARN)
    assert "nothing moves from first to last frame in the records ['valid 0']" in warnings
    assert '1 runs have no force' in warnings
    assert '1 of 12 runs begin with the same frame twice' in warnings


def test_duplicates_in_and_between_splits(copy):
    runs = dataset.read_split(str(copy), 'train')
    change_runs(copy, 'train', lambda index, run: runs[0] if index == 4 else run)
    assert 'the same run lies in the file more than once: train 0 = train 4' in texts(
        copy, Level.WARN
    )
    change_runs(copy, 'test', lambda index, run: runs[0])
    assert 'the same run lies in different splits: train 0 = train 4 = test 0' in texts(
        copy, Level.ERROR
    )


def test_leaking_cases(copy):
    held = dataset.read_metadata(str(copy))
    split = {**held['dataset_split'], 'test': held['dataset_split']['train'][:1]}
    change_metadata(copy, dataset_split=split)
    assert 'are in train and test' in texts(copy, Level.ERROR)
    cases = {**held['cases'], 'test': held['cases']['train'][:1]}
    change_metadata(copy, cases=cases)
    assert 'which are not training runs' in texts(copy, Level.ERROR)


def test_body_that_bends_or_has_the_wrong_type(copy):
    def bend(index, run):
        run.position[10:, 0, 1] += 0.05
        return run

    change_runs(copy, 'valid', bend)
    assert 'the rigid body changes its shape' in texts(copy, Level.ERROR)

    def retype(index, run):
        return dataclasses.replace(run, particle_type=np.array([0] * 20 + [6] * 8))

    change_runs(copy, 'test', retype)
    assert '1 runs have rigid nodes that are not of type 3' in texts(copy, Level.ERROR)


def test_subspace_of_another_fit(copy, wheel):
    shutil.copy(f'{wheel}/subspace.npz', os.path.join(copy, 'subspace.npz'))
    renew_manifest(copy)
    assert 'digest is' in texts(copy, Level.ERROR)
    os.remove(os.path.join(copy, 'subspace.npz'))
    assert 'subspace.npz: no such file' in texts(copy, Level.ERROR)


def test_missing_split_and_foreign_metadata(copy):
    os.remove(os.path.join(copy, 'test.tfrecord'))
    assert 'there is no test.tfrecord' in texts(copy, Level.WARN)
    with open(os.path.join(copy, 'metadata.json'), 'w', encoding='utf-8') as file:
        json.dump({'dim': 3}, file)
    inspection = inspect_folder(str(copy))
    assert inspection.failed and 'lacks bounds' in report(inspection)


def test_trivial_errors_against_particles(excavation, raw_excavation):
    """In the subspace, squared score errors / (3 N) are mean squared particle errors."""
    metadata = dataset.read_metadata(excavation)
    space = Subspace.load(f'{excavation}/subspace.npz')
    run = dataset.read_split(excavation, 'valid')[0]
    particles = space.decode(run.position[:, run.n_rigid :])
    found = trivial_errors(run, metadata['n_soil'])
    velocity = particles[5] - particles[4]
    still, constant = [], []
    for frame in range(6, len(particles)):
        still.append(np.mean((particles[5] - particles[frame]) ** 2))
        straight = particles[5] + (frame - 5) * velocity
        constant.append(np.mean((straight - particles[frame]) ** 2))
    assert found['stay_still'] == pytest.approx(np.mean(still), rel=1e-9)
    assert found['constant_velocity'] == pytest.approx(np.mean(constant), rel=1e-9)


def test_trivial_errors_of_the_authors_records(original):
    """Seed-facts 9: constant velocity on `valid` 2.57e-4 (excavation) and 0.0063e-4 m^2 (wheel)."""
    n_soil, expected = (4880, 2.57e-4) if 'Excavation' in original else (6005, 0.0063e-4)
    errors = [
        trivial_errors(run, n_soil)['constant_velocity']
        for run in dataset.read_split(original, 'valid')
    ]
    assert np.mean(errors) == pytest.approx(expected, rel=5e-3)


def of_kind(case, arrays):
    parameters = json.loads(str(arrays['parameters']))
    parameters['kind'] = 'grid' if case % 3 else 'lift'
    arrays['parameters'] = np.array(json.dumps(parameters))


def test_report_by_kind(tmp_path):
    raw = synthetic.write_raw_folder(
        str(tmp_path / 'raw'), 'excavation', range(1, 13), change=of_kind
    )
    metadata = convert.convert(raw, str(tmp_path / 'out'))
    text = report(inspect_folder(str(tmp_path / 'out')))
    rows = [line.split() for line in text.splitlines()]
    train = [case['kind'] for case in metadata['cases']['train']]
    lift = next(row for row in rows if row[:1] == ['lift'] and '%)' in row)
    assert lift[1] == str(train.count('lift'))
    floors = next(i for i, row in enumerate(rows) if row[:3] == ['RMS', 'that', 'modes'])
    assert rows[floors][-4:] == ['8', '16', '24', '48']
    assert 'particle samples (140 particles, every 4 frames, to 0.02 mm)' in text


def test_sample_of_other_runs_is_an_error(excavation, tmp_path):
    folder = shutil.copytree(excavation, tmp_path / 'copy')
    shutil.copy(folder / 'particles_test.npz', folder / 'particles_train.npz')
    listed = {name: {} for name in os.listdir(folder) if name != 'manifest.json'}
    files.write_manifest(str(folder), listed)
    found = [finding.text for finding in inspect_folder(str(folder)).findings]
    assert any('particles_train.npz: holds other runs than train.tfrecord' in t for t in found)
    (folder / 'particles_train.npz').write_bytes(b'PK')
    assert inspect_folder(str(folder)).failed
    assert len(particles.read_sample(excavation, 'train')) == 10
