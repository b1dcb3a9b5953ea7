"""Conversion of raw runs: what comes out, what is refused, and that nothing is half written."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from pca_tools import convert, dataset, files
from pca_tools.metadata import SPLITS
from pca_tools.raw_runs import RawRuns
from pca_tools.splits import split_cases
from pca_tools.subspace import Subspace
from tests.pca_tools import synthetic
from tests.pca_tools.commands import REPOSITORY, run_command


def raw_of(folder, case):
    return np.load(f'{folder}/run_{case:03d}.npz')


@pytest.mark.parametrize('count, sizes', [(200, (160, 20, 20)), (40, (32, 4, 4)), (5, (3, 1, 1))])
def test_split_deals_every_case_once(count, sizes):
    cases = [f'case {index}' for index in range(count)]
    parts = split_cases(cases, (0.8, 0.1, 0.1), seed=3)
    assert tuple(len(parts[name]) for name in SPLITS) == sizes
    assert sorted(sum(parts.values(), [])) == list(range(count))
    assert split_cases(cases, (0.8, 0.1, 0.1), seed=3) == parts
    if count > 10:
        assert split_cases(cases, (0.8, 0.1, 0.1), seed=4) != parts


def test_held_out_cases_are_tested():
    cases = list(range(100, 140))
    parts = split_cases(cases, (0.8, 0.1, 0.1), 0, ['101', '139'])
    assert {1, 39} <= set(parts['test']) and len(parts['test']) == 4
    many = split_cases(cases, (0.8, 0.1, 0.1), 0, cases[:7])
    assert many['test'] == list(range(7)) and len(many['valid']) == 4
    assert split_cases(cases, (1.0, 0.0, 0.0), 0) == {
        'train': list(range(40)), 'valid': [], 'test': []
    }  # fmt: skip


@pytest.mark.parametrize(
    'fractions, hold_out, text',
    [
        ((0.8, 0.1), (), 'must be 3 shares that sum to 1'),
        ((0.8, 0.1, 0.2), (), 'must be 3 shares that sum to 1'),
        ((0.8, 0.1, 0.1), (7,), r"hold_out names \['7'\]"),
        ((0.8, 0.1, 0.1), (0, 1), 'do not fill the shares'),
    ],
)
def test_impossible_splits(fractions, hold_out, text):
    with pytest.raises(ValueError, match=text):
        split_cases([0, 1, 2], fractions, 0, hold_out)


def test_records_hold_the_raw_runs(excavation, raw_excavation):
    metadata = dataset.read_metadata(excavation)
    space = Subspace.load(f'{excavation}/subspace.npz')
    assert metadata['pca']['digest'] == space.digest
    for split in SPLITS:
        runs, cases = dataset.read_split(excavation, split), metadata['dataset_split'][split]
        for index, (run, case) in enumerate(zip(runs, cases, strict=True)):
            raw = raw_of(raw_excavation, case)
            assert run.key == index
            assert run.particle_type.tolist() == [3] * 20 + [6] * 8
            # the pose puts them there
            np.testing.assert_allclose(run.position[:, :20], raw['rigid_positions'], atol=2e-7)
            np.testing.assert_array_equal(run.rigid_pose, raw['pose'])
            np.testing.assert_array_equal(run.force, raw['force'])
            # twin: the definition, one frame and axis at a time
            frame, axis = 7, 1
            scores = (raw['positions'][frame, :, axis] - space.mean[:, axis]) @ space.components
            np.testing.assert_allclose(run.position[frame, 20:, axis], scores, atol=1e-6)
            assert metadata['cases'][split][index]['case'] == case
            residual = raw['positions'] - space.decode(run.position[:, 20:])
            # the scores are stored as float32
            assert metadata['projection_mse'][split][index] == pytest.approx(
                np.mean(residual**2), rel=1e-4
            )


def test_metadata_has_the_keys_and_values_of_the_formats(wheel, raw_wheel):
    metadata = dataset.read_metadata(wheel)
    runs = dataset.read_split(wheel, 'train')
    assert metadata['sequence_length'] == 23 and metadata['frames_stored'] == 24
    assert metadata['particles_rigid'] == 16 and metadata['mode_number'] == 8
    assert metadata['scene'] == synthetic.scene('wheel')
    assert metadata['n_soil'] == 140 and metadata['dim'] == 3 and metadata['schema_version'] == 1
    assert metadata['pca']['mean'] == 'scalar'
    # twin of the statistics: nothing is kinematic on the wheel
    x = np.stack([run.position for run in runs]).astype(np.float64)
    v, a = np.diff(x, axis=1), np.diff(np.diff(x, axis=1), axis=1)
    for key, values in (('vel', v), ('acc', a), ('rigid_body_force', [r.force for r in runs])):
        flat = np.reshape(values, (-1, 3)).astype(np.float64)
        np.testing.assert_allclose(metadata[f'{key}_mean'], flat.mean(0), rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(metadata[f'{key}_std'], flat.std(0), rtol=1e-9)
    context = np.array([run.step_context[0] for run in runs])
    np.testing.assert_allclose(metadata['context_mean'], context.mean(0), rtol=1e-6)
    case = metadata['dataset_split']['train'][2]
    expected = json.loads(str(raw_of(raw_wheel, case)['parameters']))['context']
    np.testing.assert_allclose(runs[2].step_context, [list(expected.values())] * 24, rtol=1e-6)


def test_statistics_leave_out_kinematic_nodes(excavation):
    metadata = dataset.read_metadata(excavation)
    modes = np.stack([run.position[:, 20:] for run in dataset.read_split(excavation, 'train')])
    steps = np.diff(modes.astype(np.float64), axis=1).reshape(-1, 3)
    np.testing.assert_allclose(metadata['vel_std'], steps.std(0), rtol=1e-5)  # packed scores


def test_subspace_knows_only_training_runs(excavation, raw_excavation):
    metadata = dataset.read_metadata(excavation)
    space = Subspace.load(f'{excavation}/subspace.npz')
    training = metadata['dataset_split']['train']
    assert list(space.runs) == [str(case) for case in training]
    stacked = np.concatenate([raw_of(raw_excavation, c)['positions'] for c in training])
    np.testing.assert_allclose(space.mean, stacked.mean(0, dtype=np.float64), atol=1e-12)
    assert metadata['pca']['projection_floor'] == pytest.approx(
        np.mean(metadata['projection_mse']['train']), rel=1e-6
    )


def test_full_error_is_score_error_plus_truncated_part(excavation, raw_excavation):
    metadata = dataset.read_metadata(excavation)
    space = Subspace.load(f'{excavation}/subspace.npz')
    run = dataset.read_split(excavation, 'test')[0]
    truth = raw_of(raw_excavation, metadata['dataset_split']['test'][0])['positions']
    scores = run.position[:, 20:].astype(np.float64)
    predicted = scores + np.random.default_rng(0).normal(0, 0.02, scores.shape)
    full = np.mean((space.decode(predicted) - truth) ** 2)
    inside = np.mean(np.sum((predicted - scores) ** 2, axis=(1, 2))) / (3 * metadata['n_soil'])
    # the scores are stored as float32: the cross term is their rounding, 3e-8 of 1 m
    assert full == pytest.approx(inside + metadata['projection_mse']['test'][0], rel=1e-5)


def test_same_input_gives_the_same_bytes(raw_excavation, excavation, tmp_path):
    convert.convert(raw_excavation, str(tmp_path / 'again'))
    again = files.check_manifest(str(tmp_path / 'again'))
    assert again == files.check_manifest(excavation)


def test_new_runs_in_an_old_subspace(wheel, tmp_path):
    raw = synthetic.write_raw_folder(str(tmp_path / 'raw'), 'wheel', [31, 32])
    metadata = convert.convert(raw, str(tmp_path / 'new'), like=wheel)
    base = dataset.read_metadata(wheel)
    assert metadata['dataset_split'] == {'test': [31, 32]}
    assert metadata['vel_std'] == base['vel_std'] and metadata['pca'] == base['pca']
    space = Subspace.load(f'{wheel}/subspace.npz')
    runs = dataset.read_split(str(tmp_path / 'new'), 'test')
    expected = space.encode(raw_of(raw, 32)['positions'])
    np.testing.assert_allclose(runs[1].position[:, 16:], expected, atol=1e-6)


def test_like_refuses_trained_cases_and_other_scenes(wheel, excavation, raw_wheel, tmp_path):
    with pytest.raises(ValueError, match='was trained on the cases'):
        convert.convert(raw_wheel, str(tmp_path / 'new'), like=wheel)
    with pytest.raises(ValueError, match='is of another scene: its name'):
        convert.convert(raw_wheel, str(tmp_path / 'new'), like=excavation)
    assert not os.listdir(tmp_path)


def test_occupied_output_is_left_alone(raw_excavation, tmp_path):
    output = tmp_path / 'out'
    output.mkdir()
    (output / 'thesis.txt').write_text('mine')
    with pytest.raises(ValueError, match='not empty and not a finished dataset'):
        convert.convert(raw_excavation, str(output), overwrite=True)
    (output / 'thesis.txt').unlink()
    convert.convert(raw_excavation, str(output))  # an empty folder is filled
    with pytest.raises(ValueError, match='use --overwrite'):
        convert.convert(raw_excavation, str(output))
    convert.convert(raw_excavation, str(output), modes=5, overwrite=True)
    assert dataset.read_metadata(str(output))['mode_number'] == 5
    (output / 'edges.json').write_text('{}')
    with pytest.raises(ValueError, match=r"not of the dataset \(\['edges.json'\]\)"):
        convert.convert(raw_excavation, str(output), overwrite=True)
    assert sorted(os.listdir(tmp_path)) == ['out']


def nan_at(case, frame, particle):
    def change(current, arrays):
        if current == case:
            arrays['positions'][frame, particle, 0] = np.nan

    return change


def fewer_particles(current, arrays):
    if current == 3:
        arrays['positions'] = arrays['positions'][:, :100]


def shuffled_particles(current, arrays):
    if current == 3:
        order = np.random.default_rng(0).permutation(140)
        arrays['positions'] = arrays['positions'][:, order]


def no_force(current, arrays):
    del arrays['force']


def short_force(current, arrays):
    arrays['force'] = arrays['force'][1:]


def no_context(current, arrays):
    arrays['parameters'] = np.array('{"case": 1}')


@pytest.mark.parametrize(
    'change, text',
    [
        (nan_at(4, 9, 17), 'run_004.npz: positions holds 1 NaN .* frame 9, point 17'),
        (fewer_particles, r'run_003.npz: has .* \(100, False, True\), the runs before'),
        (shuffled_particles, 'case 3: its particles start .*not the same order'),
        (no_force, r"run_00..npz: lacks the arrays \['force'\]"),
        (short_force, r'force has shape \(23, 3\), float32 for 24 frames'),
        (no_context, 'parameters must be a JSON object with context'),
    ],
)
def test_bad_raw_runs_are_named_and_leave_nothing(tmp_path, change, text):
    raw = synthetic.write_raw_folder(str(tmp_path / 'raw'), 'wheel', range(1, 6), change=change)
    # all but case 3 train, so that it is the others that say what a column is
    with pytest.raises(ValueError, match=text):
        convert.convert(raw, str(tmp_path / 'out'), hold_out=[3])
    assert os.listdir(tmp_path) == ['raw']


def test_raw_folder_against_its_manifest(tmp_path):
    with pytest.raises(FileNotFoundError, match='no such folder of raw runs'):
        RawRuns(str(tmp_path / 'nowhere'))
    with pytest.raises(FileNotFoundError, match='manifest.json'):
        RawRuns(str(tmp_path))
    raw = synthetic.write_raw_folder(str(tmp_path / 'raw'), 'excavation', [1, 2])
    path = f'{raw}/run_002.npz'
    with open(path, 'rb') as file:
        data = file.read()
    with open(path, 'wb') as file:
        file.write(data[:-100])
    with pytest.raises(ValueError, match='run_002.npz: differs from the manifest'):
        list(RawRuns(raw))
    os.remove(path)
    with pytest.raises(FileNotFoundError, match='run_002.npz'):
        list(RawRuns(raw))
    manifest = files.read_json(f'{raw}/manifest.json')
    for change, text in (
        ({'runs': []}, 'lists no runs'),
        ({'runs': manifest['runs'][:1] * 2}, r'lists the cases \[1\] more than once'),
        ({'scene': {'name': 'x'}}, 'lacks .*rigid_motion'),
        ({'runs': [{'file': 'run_001.npz', 'case': 1}]}, 'a run is listed as .*sha256'),
    ):
        files.write_json(f'{raw}/manifest.json', {**manifest, **change})
        with pytest.raises(ValueError, match=text):
            RawRuns(raw)
    files.write_json(f'{raw}/manifest.json', {'files': {}})
    with pytest.raises(ValueError, match='is not a manifest of raw runs'):
        RawRuns(raw)


def test_command_line(raw_excavation, tmp_path):
    output = str(tmp_path / 'out')
    arguments = ['pca_tools.convert', f'--raw_path={raw_excavation}', f'--output_path={output}']
    done = run_command(*arguments, '--hold_out=3,4', '--num_modes=6')
    assert done.returncode == 0, done.stderr
    assert f'{output}: scene excavation, N = 140, R = 20, r = 6, T = 24' in done.stdout
    assert dataset.read_metadata(output)['dataset_split']['test'] == [3, 4]
    again = run_command(*arguments)
    assert again.returncode == 1
    assert again.stderr.strip().endswith('use --overwrite to replace it')
    assert 'Traceback' not in again.stderr


@pytest.mark.parametrize(
    ('arguments', 'text'),
    [
        (['--hold_out', '3', '5', '7'], "unexpected arguments ['5', '7']"),
        (['--like=there', '--num_modes=4', '--split=1,0,0'], '--num_modes, --split do not go'),
        (['--like=there', '--hold_out=3', '--seed=1'], '--seed, --hold_out do not go with --like'),
    ],
)
def test_command_takes_nothing_that_it_does_not_heed(tmp_path, arguments, text):
    out = f'--output_path={tmp_path}/out'
    done = run_command('pca_tools.convert', '--raw_path=nowhere', out, *arguments)
    assert done.returncode == 1 and text in done.stdout + done.stderr
    assert 'Traceback' not in done.stderr and not os.listdir(tmp_path)


def test_output_that_cannot_be_made_is_refused_before_the_work(raw_excavation, tmp_path):
    (tmp_path / 'file').write_text('')
    with pytest.raises(OSError, match='cannot write .*file/new/out: Not a directory'):
        convert.convert('no raw runs yet', str(tmp_path / 'file' / 'new' / 'out'))
    with pytest.raises(FileNotFoundError, match='no such folder of raw runs'):
        convert.convert('no raw runs yet', str(tmp_path / 'new' / 'out'))
    assert os.listdir(tmp_path) == ['file']


def test_help_shows_the_examples():
    done = run_command('pca_tools.convert', '--help')
    assert done.returncode == 0
    assert 'python -m pca_tools.convert --raw_path=' in done.stdout
    assert '--centering: <configuration|scalar>' in done.stdout


def test_maths_is_free_of_tensorflow():
    modules = ('files', 'metadata', 'subspace', 'rigid_fit', 'dataset', 'convert', 'inspect')
    imports = ', '.join(f'pca_tools.{name}' for name in modules)
    code = f'import {imports}, sys; sys.exit("tensorflow" in sys.modules)'
    done = subprocess.run(
        [sys.executable, '-c', code], cwd=REPOSITORY, check=False, capture_output=True
    )
    assert done.returncode == 0
