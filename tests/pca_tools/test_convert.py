"""Conversion of raw runs: what comes out, what is refused, and that nothing is half written."""

import json
import os

import numpy as np
import pytest

from pca_tools import append, convert, dataset, files, particles, subset
from pca_tools.inspect import inspect_folder
from pca_tools.metadata import SPLITS
from pca_tools.subspace import Subspace
from tests.pca_tools import synthetic
from tests.pca_tools.commands import call_command
from tests.pca_tools.synthetic import raw_of, write_raw_folder


def test_records_hold_the_raw_runs(excavation, raw_excavation):
    metadata = dataset.read_metadata(excavation)
    space = Subspace.load(f'{excavation}/subspace.npz')
    training = metadata['dataset_split']['train']
    assert metadata['pca']['digest'] == space.digest
    assert list(space.runs) == [str(case) for case in training]
    stacked = np.concatenate([raw_of(raw_excavation, c)['positions'] for c in training])
    np.testing.assert_allclose(space.mean, stacked.mean(0, dtype=np.float64), atol=1e-12)
    for split in SPLITS:
        runs, cases = dataset.read_split(excavation, split), metadata['dataset_split'][split]
        sample = particles.read_sample(excavation, split)
        assert len(sample) == len(cases) and sample.frame_stride == 4
        for index, (run, case) in enumerate(zip(runs, cases, strict=True)):
            raw = raw_of(raw_excavation, case)
            assert run.key == index and metadata['cases'][split][index]['case'] == case
            assert run.particle_type.tolist() == [3] * 20 + [6] * 8
            # the pose puts them there
            np.testing.assert_allclose(run.position[:, :20], raw['rigid_positions'], atol=2e-7)
            np.testing.assert_array_equal(run.rigid_pose, raw['pose'])
            np.testing.assert_array_equal(run.force, raw['force'])
            # twin: the definition, one frame and axis at a time
            frame, axis = 7, 1
            scores = (raw['positions'][frame, :, axis] - space.mean[:, axis]) @ space.components
            np.testing.assert_allclose(run.position[frame, 20:, axis], scores, atol=1e-6)
            residual = raw['positions'] - space.decode(run.position[:, 20:])
            # the scores are stored as float32
            assert metadata['projection_mse'][split][index] == pytest.approx(
                np.mean(residual**2), rel=1e-4
            )
            kept = raw['positions'][::4][:, sample.indices].astype(np.float64)
            assert sample[index].shape == kept.shape == (6, 140, 3)
            assert np.abs(sample[index] - kept).max() <= 2e-5


def test_metadata_has_the_keys_and_values_of_the_formats(wheel, raw_wheel, excavation):
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
    # the blade is kinematic, and so left out
    modes = np.stack([run.position[:, 20:] for run in dataset.read_split(excavation, 'train')])
    steps = np.diff(modes.astype(np.float64), axis=1).reshape(-1, 3)
    held = dataset.read_metadata(excavation)['vel_std']
    np.testing.assert_allclose(held, steps.std(0), rtol=1e-5)  # packed scores


def test_same_input_gives_the_same_bytes(raw_excavation, excavation, tmp_path):
    convert.convert(raw_excavation, str(tmp_path / 'again'))
    again = files.check_manifest(str(tmp_path / 'again'))
    assert again == files.check_manifest(excavation)


def test_new_runs_in_an_old_subspace(wheel, raw_wheel, excavation, tmp_path):
    raw, new = write_raw_folder(tmp_path / 'raw', 'wheel', [31, 32]), str(tmp_path / 'new')
    metadata = convert.convert(raw, new, like=wheel)
    base = dataset.read_metadata(wheel)
    assert metadata['dataset_split'] == {'test': [31, 32]}
    assert metadata['vel_std'] == base['vel_std'] and metadata['pca'] == base['pca']
    run = dataset.read_split(new, 'test')[1]
    expected = Subspace.load(f'{wheel}/subspace.npz').encode(raw_of(raw, 32)['positions'])
    np.testing.assert_allclose(run.position[:, 16:], expected, atol=1e-6)
    first, second = (particles.read_sample(folder, 'test') for folder in (wheel, new))
    np.testing.assert_array_equal(first.indices, second.indices)
    np.testing.assert_array_equal(first.rest, second.rest)
    with pytest.raises(ValueError, match='was trained on the cases'):
        convert.convert(raw_wheel, str(tmp_path / 'no'), like=wheel)
    with pytest.raises(ValueError, match='is of another scene: its name'):
        convert.convert(raw_wheel, str(tmp_path / 'no'), like=excavation)
    raw = write_raw_folder(
        tmp_path / 'rolled', 'wheel', [35],
        change=lambda case, arrays: arrays.update(positions=np.roll(arrays['positions'], 1, 1)),
    )  # fmt: skip
    with pytest.raises(ValueError, match='case 35: .* particles start .*not the same order'):
        convert.convert(raw, str(tmp_path / 'no'), like=wheel)
    # case numbers count anew in each kind
    known = int(base['pca']['fitted_on'][0])
    raw = write_raw_folder(tmp_path / 'smooth', 'wheel', [known], kind='smooth')
    metadata = convert.convert(raw, str(tmp_path / 'driven'), like=wheel)
    assert metadata['cases']['test'][0]['kind'] == 'smooth'
    # runs that name a split go there
    raw = write_raw_folder(tmp_path / 'named', 'wheel', [33, 34], split='train')
    metadata = convert.convert(raw, str(tmp_path / 'more'), like=wheel)
    assert metadata['dataset_split'] == {'train': [33, 34]}
    assert not (tmp_path / 'no').exists()


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
    (tmp_path / 'file').write_text('')
    with pytest.raises(OSError, match='cannot write .*file/new/out: Not a directory'):
        convert.convert('no raw runs yet', str(tmp_path / 'file' / 'new' / 'out'))
    with pytest.raises(FileNotFoundError, match='no such folder of raw runs'):
        convert.convert('no raw runs yet', str(tmp_path / 'new' / 'out'))
    assert sorted(os.listdir(tmp_path)) == ['file', 'out']


@pytest.mark.parametrize(
    'change, text',
    [
        (lambda a: a.update(positions=a['positions'][:, :100]),
         r'run_003.npz: has .* \(100, False, True, None\), the runs before'),
        (lambda a: a.update(positions=a['positions'][:, ::-1]),
         'case 3: its particles start .*not the same order'),
        (lambda a: a.update(torque=a['force']), r'\(140, True, True, None\), the runs before'),
    ],
)  # fmt: skip
def test_runs_of_another_bin_are_named_and_leave_nothing(tmp_path, change, text):
    raw = write_raw_folder(
        tmp_path / 'raw', 'wheel', range(1, 5),
        change=lambda case, arrays: change(arrays) if case == 3 else None,
    )  # fmt: skip
    # all but case 3 train, so that it is the others that say what a column is
    with pytest.raises(ValueError, match=text):
        convert.convert(raw, str(tmp_path / 'out'), hold_out=[3])
    assert os.listdir(tmp_path) == ['raw']


def test_runs_name_their_own_split(tmp_path):
    named = {1: 'test', 2: 'train', 3: 'valid', 4: 'train', 5: 'train', 6: 'test'}
    raw = write_raw_folder(tmp_path / 'raw', 'wheel', range(1, 7), split=named.get)
    metadata = convert.convert(raw, str(tmp_path / 'named'), hold_out=[5])
    assert metadata['dataset_split'] == {'train': [2, 4], 'valid': [3], 'test': [1, 5, 6]}
    assert metadata['pca']['fitted_on'] == ['2', '4']
    other = convert.convert(raw, str(tmp_path / 'dealt'), split=(0.8, 0.1, 0.1))
    assert len(other['dataset_split']['train']) == 4
    for cases, text in (
        ({**named, 2: 'training', 4: None}, r"2 of 6 cases name no split .*2: 'training', 4: None"),
        (dict.fromkeys(named, 'test'), 'no case names train'),
    ):
        raw = write_raw_folder(tmp_path / 'raw', 'wheel', range(1, 7), split=cases.get)
        with pytest.raises(ValueError, match=text):
            convert.convert(raw, str(tmp_path / 'bad'))


def test_floors_are_the_errors_of_so_many_modes(wheel, raw_wheel, tmp_path):
    floors = dataset.read_metadata(wheel)['projection_floors']
    assert floors['modes'] == [8, 16, 24, 48]
    other = convert.convert(raw_wheel, str(tmp_path / 'more'), modes=16, centering='scalar')
    for split in SPLITS:
        for metadata, place in ((dataset.read_metadata(wheel), 0), (other, 1)):
            measured = np.mean(metadata['projection_mse'][split])
            assert floors[split][place] == pytest.approx(measured, rel=1e-6)


def test_subspace_of_some_frames(raw_excavation, tmp_path):
    metadata = convert.convert(raw_excavation, str(tmp_path / 'out'), modes=5, frame_stride=4)
    space = Subspace.load(f'{tmp_path}/out/subspace.npz')
    assert space.n_rows == 3 * 6 * 4 and metadata['pca']['frame_stride'] == 4
    runs = [raw_of(raw_excavation, int(case))['positions'] for case in space.runs]
    frames = np.concatenate([run[::4] for run in runs]).astype(np.float64)
    rows = (frames - frames.mean(0)).transpose(0, 2, 1).reshape(-1, 140)
    values = np.linalg.svd(rows, compute_uv=False)
    np.testing.assert_allclose(space.singular_values[:20], values[:20], rtol=1e-9)
    with pytest.raises(ValueError, match='frame_stride is 0'):
        convert.convert(raw_excavation, str(tmp_path / 'no'), frame_stride=0)


def machine_run(case, arrays):
    """Gives case 2 a free body, cases 3 and 4 longer runs, all a torque and changing context."""
    rng = np.random.default_rng(case)
    if case == 2:
        for name, shape in (('target', (3,)), ('external', (3,)), ('subframe_force', (4, 3))):
            arrays[name] = rng.normal(size=(24, *shape)).astype(np.float32)
    if case in (3, 4):
        for name in ('positions', 'rigid_positions', 'force', 'pose'):
            arrays[name] = np.concatenate([arrays[name], arrays[name][::-case]])
    arrays['torque'] = rng.normal(size=arrays['force'].shape).astype(np.float32)
    arrays['step_context'] = arrays['torque'] + np.float32(case)
    arrays['something_new'] = np.zeros(3)


@pytest.mark.parametrize('packed', [True, False])
def test_free_bodies_and_runs_of_other_lengths_go_in_and_out(tmp_path, packed):
    """As the data of record: kinds, machine, tool and soil, converted, appended, chosen from."""
    mass = {'mass_kg': [20.0, 20.0, 1.0]}
    raw, more = (
        write_raw_folder(
            tmp_path / name, 'wheel', cases, change=machine_run, tool={'width_m': 0.3},
            split=lambda case: {2: 'valid', 5: 'test'}.get(case, 'train'),
            kind=lambda case: 'pressed' if case == 2 else 'smooth',
            machine=lambda case: mass if case == 2 else None,
            bulk_density_kg_m3=lambda case: 1600.0 + case, solver_version='5',
        )
        for name, cases in (('raw', range(1, 5)), ('more', (5, 6)))
    )  # fmt: skip
    grown, few = str(tmp_path / 'grown'), str(tmp_path / 'few')
    first = convert.convert(raw, grown, modes=4, packed=packed)
    torques = np.concatenate([raw_of(raw, case)['torque'] for case in (1, 3, 4)]).astype(float)
    np.testing.assert_allclose(first['rigid_body_torque_std'], torques.std(0), rtol=1e-9)
    append.append(more, grown)
    metadata = subset.subset(grown, few, train_runs=3)
    assert metadata['dataset_split'] == {'train': [1, 4, 6], 'valid': [2], 'test': [5]}
    assert metadata['frames_of_runs'] == {'train': [24, 30, 24], 'valid': [24], 'test': [24]}
    held = metadata['cases']['valid'][0]
    assert held['machine'] == mass and (held['kind'], held['solver_version']) == ('pressed', '5')
    assert metadata['cases']['train'][1]['bulk_density_kg_m3'] == 1604.0
    for folder in (grown, few):
        for split in SPLITS:
            cases = dataset.read_metadata(folder)['dataset_split'][split]
            for case, run in zip(cases, dataset.read_split(folder, split), strict=True):
                arrays = raw_of(more if case > 4 else raw, case)
                assert run.n_frames == len(arrays['positions'])
                rigid = run.position[:, : run.n_rigid]
                np.testing.assert_allclose(rigid, arrays['rigid_positions'], atol=2e-7)
                for name in dataset.FRAME_SERIES:
                    key, values = name.removeprefix('rigid_'), getattr(run, name)
                    if key in arrays:
                        np.testing.assert_array_equal(values, arrays[key])
                    else:
                        assert values is None
        assert not inspect_folder(folder).failed
    assert metadata.get('packed', False) is packed


def test_conversion_says_what_cannot_be_trained_without_a_pose(tmp_path):
    raw = write_raw_folder(
        tmp_path / 'raw', 'excavation', range(5), change=lambda case, arrays: arrays.pop('pose')
    )
    with pytest.warns(UserWarning, match='no `pose` .* the soil field cannot'):
        metadata = convert.convert(raw, str(tmp_path / 'out'), modes=3)
    run = dataset.read_split(str(tmp_path / 'out'), 'train')[0]
    body = raw_of(raw, metadata['dataset_split']['train'][0])['rigid_positions']
    np.testing.assert_array_equal(run.position[:, :20], body)


def test_command_takes_nothing_that_it_does_not_heed(tmp_path):
    for more, text in (
        (['--hold_out', '3', '5', '7'], "unexpected arguments ['5', '7']"),
        (['--like=there', '--num_modes=4', '--hold_out=3'], '--num_modes, --hold_out do not go'),
    ):
        out = f'--output_path={tmp_path}/out'
        done = call_command('pca_tools.convert', '--raw_path=nowhere', out, *more)
        assert done.returncode == 1 and text in done.stdout + done.stderr
        assert 'Traceback' not in done.stderr and not os.listdir(tmp_path)


SHARES = (0.8, 0.1, 0.1)


@pytest.mark.parametrize('count, sizes', [(200, (160, 20, 20)), (40, (32, 4, 4)), (5, (3, 1, 1))])
def test_split_deals_every_case_once(count, sizes):
    cases = [f'case {index}' for index in range(count)]
    parts = convert.split_cases(cases, SHARES, seed=3)
    assert tuple(len(parts[name]) for name in SPLITS) == sizes
    assert sorted(sum(parts.values(), [])) == list(range(count))
    assert convert.split_cases(cases, SHARES, seed=3) == parts
    assert count < 10 or convert.split_cases(cases, SHARES, seed=4) != parts


def test_held_out_cases_are_tested():
    cases = list(range(100, 140))
    parts = convert.split_cases(cases, SHARES, 0, ['101', '139'])
    assert {1, 39} <= set(parts['test']) and len(parts['test']) == 4
    many = convert.split_cases(cases, SHARES, 0, cases[:7])
    assert many['test'] == list(range(7)) and len(many['valid']) == 4
    whole = convert.split_cases(cases, (1.0, 0.0, 0.0), 0)
    assert whole == {'train': list(range(40)), 'valid': [], 'test': []}
    for fractions, hold_out, text in (
        ((0.8, 0.1), (), 'must be 3 shares that sum to 1'),
        ((0.8, 0.1, 0.2), (), 'must be 3 shares that sum to 1'),
        (SHARES, (7,), r"hold_out names \['7'\]"),
        (SHARES, (100, 101), 'do not fill the shares'),
    ):
        with pytest.raises(ValueError, match=text):
            convert.split_cases(cases[:3], fractions, 0, hold_out)
