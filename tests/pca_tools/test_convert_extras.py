"""Conversion: what runs may carry beside positions, splits that they name, floors, frame stride."""

import json

import numpy as np
import pytest

from pca_tools import append, convert, dataset, subset
from pca_tools.inspect import inspect_folder
from pca_tools.metadata import SPLITS
from pca_tools.subspace import Subspace
from tests.pca_tools import synthetic


def raw_of(folder, case):
    return np.load(f'{folder}/run_{case:03d}.npz')


def with_pose(case, arrays):
    frames = len(arrays['positions'])
    rng = np.random.default_rng(case)
    arrays['torque'] = rng.normal(size=(frames, 3)).astype(np.float32)
    turn = 0.01 * np.arange(frames)
    arrays['pose'] = np.concatenate(
        [rng.normal(size=(frames, 3)), np.cos(turn)[:, None], np.zeros((frames, 2)),
         np.sin(turn)[:, None]], axis=1,
    ).astype(np.float32)  # fmt: skip
    arrays['something_new'] = np.zeros(3)


def test_torque_and_pose_travel_with_the_records(tmp_path):
    raw = synthetic.write_raw_folder(
        str(tmp_path / 'raw'), 'excavation', range(1, 7), change=with_pose
    )
    metadata = convert.convert(raw, str(tmp_path / 'out'))
    case = metadata['dataset_split']['train'][1]
    run = dataset.read_split(str(tmp_path / 'out'), 'train')[1]
    np.testing.assert_array_equal(run.torque, raw_of(raw, case)['torque'])
    np.testing.assert_array_equal(run.rigid_pose, raw_of(raw, case)['pose'])
    torques = [raw_of(raw, case)['torque'] for case in metadata['dataset_split']['train']]
    np.testing.assert_allclose(
        metadata['rigid_body_torque_std'], np.concatenate(torques).astype(float).std(0), rtol=1e-9
    )

    def some(case, arrays):
        if case == 3:
            with_pose(case, arrays)

    raw = synthetic.write_raw_folder(str(tmp_path / 'raw'), 'excavation', range(1, 7), change=some)
    with pytest.raises(ValueError, match=r'torque, pose\) .*True, True\), the runs before it'):
        convert.convert(raw, str(tmp_path / 'other'), hold_out=[3])


def test_context_that_changes_in_time_is_that_of_the_frames(tmp_path):
    def load_grows(case, arrays):
        frames = len(arrays['positions'])
        arrays['step_context'] = np.linspace([9.81, 30, case], [9.81, 30, 2 * case], frames).astype(
            np.float32
        )

    raw = synthetic.write_raw_folder(str(tmp_path / 'raw'), 'wheel', range(1, 7), change=load_grows)
    metadata = convert.convert(raw, str(tmp_path / 'out'))
    for run, case in zip(
        dataset.read_split(str(tmp_path / 'out'), 'train'), metadata['dataset_split']['train']
    ):
        np.testing.assert_array_equal(run.step_context, raw_of(raw, case)['step_context'])
    raw = synthetic.write_raw_folder(
        str(tmp_path / 'raw'), 'wheel', range(1, 7),
        change=lambda case, arrays: arrays.update(step_context=np.zeros((24, 2), np.float32)),
    )  # fmt: skip
    with pytest.raises(ValueError, match=r'step_context has shape \(24, 2\).* of 3 values'):
        convert.convert(raw, str(tmp_path / 'other'))


def name_split(splits):
    def change(case, arrays):
        parameters = json.loads(str(arrays['parameters']))
        if splits.get(case):
            parameters['split'] = splits[case]
        arrays['parameters'] = np.array(json.dumps(parameters))

    return change


def test_runs_name_their_own_split(tmp_path):
    named = {1: 'test', 2: 'train', 3: 'valid', 4: 'train', 5: 'train', 6: 'test'}
    raw = synthetic.write_raw_folder(
        str(tmp_path / 'raw'), 'wheel', range(1, 7), change=name_split(named)
    )
    metadata = convert.convert(raw, str(tmp_path / 'named'), hold_out=[5])
    assert metadata['dataset_split'] == {'train': [2, 4], 'valid': [3], 'test': [1, 5, 6]}
    assert metadata['pca']['fitted_on'] == ['2', '4']
    other = convert.convert(raw, str(tmp_path / 'dealt'), split=(0.8, 0.1, 0.1))
    assert len(other['dataset_split']['train']) == 4
    for cases, text in (
        ({**named, 2: 'training', 4: None}, r"2 of 6 cases name no split .*2: 'training', 4: None"),
        (dict.fromkeys(named, 'test'), 'no case names train'),
    ):
        raw = synthetic.write_raw_folder(
            str(tmp_path / 'raw'), 'wheel', range(1, 7), change=name_split(cases)
        )
        with pytest.raises(ValueError, match=text):
            convert.convert(raw, str(tmp_path / 'bad'))


def test_floors_are_the_errors_of_so_many_modes(raw_wheel, tmp_path):
    metadata = convert.convert(raw_wheel, str(tmp_path / 'eight'), modes=8)
    floors = metadata['projection_floors']
    assert floors['modes'] == [8, 16, 24, 48]
    for count in (8, 16):
        other = convert.convert(raw_wheel, str(tmp_path / f'm{count}'), modes=count)
        for split in SPLITS:
            measured = np.mean(other['projection_mse'][split])
            assert floors[split][floors['modes'].index(count)] == pytest.approx(measured, rel=1e-6)
    assert (
        floors['modes'][-1] == 48 and Subspace.load(f'{tmp_path}/eight/subspace.npz').n_modes == 8
    )


def test_subspace_of_some_frames(raw_excavation, tmp_path):
    metadata = convert.convert(raw_excavation, str(tmp_path / 'out'), modes=5, frame_stride=4)
    space = Subspace.load(f'{tmp_path}/out/subspace.npz')
    assert space.n_rows == 3 * 6 * 10 and metadata['pca']['frame_stride'] == 4
    runs = [raw_of(raw_excavation, int(case))['positions'] for case in space.runs]
    frames = np.concatenate([run[::4] for run in runs]).astype(np.float64)
    rows = (frames - frames.mean(0)).transpose(0, 2, 1).reshape(-1, 140)
    values = np.linalg.svd(rows, compute_uv=False)
    np.testing.assert_allclose(space.singular_values[:20], values[:20], rtol=1e-9)
    with pytest.raises(ValueError, match='frame_stride is 0'):
        convert.convert(raw_excavation, str(tmp_path / 'no'), frame_stride=0)


def test_case_numbers_count_anew_in_each_kind(excavation, tmp_path):
    def driven(case, arrays):
        parameters = json.loads(str(arrays['parameters'])) | {'kind': 'smooth'}
        arrays['parameters'] = np.array(json.dumps(parameters))

    known = int(dataset.read_metadata(excavation)['pca']['fitted_on'][0])
    raw = synthetic.write_raw_folder(str(tmp_path / 'raw'), 'excavation', [known], change=driven)
    metadata = convert.convert(raw, str(tmp_path / 'new'), like=excavation)
    assert metadata['cases']['test'][0]['kind'] == 'smooth'


def machine_run(case, arrays):
    """Gives case 2 a free body, cases 3 and 4 longer runs; all name their split and their soil."""
    rng = np.random.default_rng(case)
    parameters = json.loads(str(arrays['parameters']))
    parameters |= {'split': {2: 'valid', 5: 'test'}.get(case, 'train'), 'kind': 'smooth'}
    parameters |= {'tool': {'width_m': 0.3}, 'bulk_density_kg_m3': 1600.0 + case}
    if case == 2:
        parameters |= {'kind': 'pressed', 'machine': {'mass_kg': [20.0, 20.0, 1.0]}}
        for name, shape in (('target', (3,)), ('external', (3,)), ('subframe_force', (4, 3))):
            arrays[name] = rng.normal(size=(24, *shape)).astype(np.float32)
    if case in (3, 4):
        for name in ('positions', 'rigid_positions', 'force', 'pose'):
            arrays[name] = np.concatenate([arrays[name], arrays[name][:: -case]])
    arrays['torque'] = rng.normal(size=arrays['force'].shape).astype(np.float32)
    arrays['parameters'] = np.array(json.dumps(parameters))


@pytest.mark.parametrize('packed', [True, False])
def test_free_bodies_and_runs_of_other_lengths_go_in_and_out(tmp_path, packed):
    raw, more = (
        synthetic.write_raw_folder(str(tmp_path / name), 'excavation', cases, change=machine_run)
        for name, cases in (('raw', range(1, 5)), ('more', (5, 6)))
    )
    grown, few = str(tmp_path / 'grown'), str(tmp_path / 'few')
    convert.convert(raw, grown, modes=4, packed=packed)
    append.append(more, grown)
    metadata = subset.subset(grown, few, train_runs=3)
    assert metadata['dataset_split'] == {'train': [1, 4, 6], 'valid': [2], 'test': [5]}
    assert metadata['frames_of_runs'] == {'train': [24, 30, 24], 'valid': [24], 'test': [24]}
    assert metadata['cases']['valid'][0]['machine'] == {'mass_kg': [20.0, 20.0, 1.0]}
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


def test_bad_series_of_a_free_body_are_named(tmp_path):
    def five_parts(case, arrays):
        arrays['subframe_force'] = np.zeros((24, 5, 3), np.float32)

    raw = synthetic.write_raw_folder(str(tmp_path / 'raw'), 'excavation', [1], change=five_parts)
    with pytest.raises(ValueError, match=r'subframe_force has shape \(24, 5, 3\), .* of 4 x 3'):
        convert.convert(raw, str(tmp_path / 'out'))


def test_conversion_says_what_cannot_be_trained_without_a_pose(tmp_path):
    def without(case, arrays):
        del arrays['pose']

    raw = synthetic.write_raw_folder(str(tmp_path / 'raw'), 'excavation', range(5), change=without)
    with pytest.warns(UserWarning, match='no `pose` .* the swept field cannot'):
        convert.convert(raw, str(tmp_path / 'out'), modes=3)
    first = dataset.read_metadata(str(tmp_path / 'out'))['dataset_split']['train'][0]
    run = dataset.read_split(str(tmp_path / 'out'), 'train')[0]
    np.testing.assert_array_equal(run.position[:, :20], raw_of(raw, first)['rigid_positions'])
