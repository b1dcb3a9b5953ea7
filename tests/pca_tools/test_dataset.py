"""Dataset folders: round trip, and every disagreement between records, metadata and manifest."""

import dataclasses
import json
import os

import numpy as np
import pytest

from pca_tools import dataset, files, tfrecord_io
from pca_tools.dataset import Trajectory


def make_trajectory(key=0, frames=5, rigid=3, modes=2, context=None, seed=0):
    rng = np.random.default_rng(seed)
    return Trajectory(
        key=key,
        particle_type=np.array([3] * rigid + [6] * modes, np.int64),
        position=rng.random((frames, rigid + modes, 3)).astype(np.float32),
        force=rng.random((frames, 3)).astype(np.float32),
        step_context=context,
    )


def make_folder(path, trajectories, manifest=True, **changes):
    """A dataset of training runs; `...` takes a key out of its metadata."""
    statistics = {f'{name}_mean': [0.0] * 3 for name in ('vel', 'acc', 'rigid_body_force')}
    statistics |= {f'{name}_std': [1.0] * 3 for name in ('vel', 'acc', 'rigid_body_force')}
    metadata = {
        'bounds': [[0.1, 0.9]] * 3, 'sequence_length': 4, 'default_connectivity_radius': 0.025,
        'dim': 3, 'dt': 1 / 60, 'mode_number': 2, 'particles_rigid': 3, **statistics, **changes,
    }  # fmt: skip
    folder = str(path)
    with open(f'{folder}/metadata.json', 'w', encoding='utf-8') as file:
        json.dump({key: value for key, value in metadata.items() if value is not ...}, file)
    dataset.write_split(f'{folder}/train.tfrecord', trajectories)
    if manifest:
        listed = {'metadata.json': {}, 'train.tfrecord': {'records': len(trajectories)}}
        files.write_manifest(folder, listed)
    return folder


def assert_equal(first, second):
    for field in dataclasses.fields(Trajectory):
        a, b = getattr(first, field.name), getattr(second, field.name)
        assert (a is None) == (b is None)
        if a is not None:
            np.testing.assert_array_equal(a, b)
            assert np.asarray(a).dtype == np.asarray(b).dtype


def test_round_trip_with_different_node_counts(tmp_path):
    context = np.tile(np.float32([9.81, 30, 100]), (5, 1))
    runs = [make_trajectory(i, rigid=3 + i, context=context, seed=i) for i in range(3)]
    runs = [dataclasses.replace(run, force=None) for run in runs]
    changes = {'context_mean': [0.0] * 3, 'context_std': [1.0] * 3}
    changes |= {'rigid_body_force_mean': ..., 'rigid_body_force_std': ...}
    read = dataset.read_split(make_folder(tmp_path, runs, **changes), 'train')
    for first, second in zip(runs, read, strict=True):
        assert_equal(first, second)
    assert [run.n_rigid for run in read] == [3, 4, 5]
    assert [run.n_modes for run in read] == [2, 2, 2]


@pytest.mark.parametrize(
    'changes, text',
    [
        ({'sequence_length': 5}, r'record 0: has 5 frames, sequence_length \+ 1 = 6'),
        ({'mode_number': 3}, 'record 0: has 2 mode nodes .* among 5, mode_number says the last 3'),
        ({'rigid_body_force_mean': ..., 'rigid_body_force_std': ...},
         'the record has force but metadata lacks rigid_body_force_mean'),
        ({'context_mean': [0.0], 'context_std': [0.0]},
         'metadata has context_mean but the record lacks step_context'),
        ({'bounds': ...}, 'metadata.json: lacks bounds'),
        ({'dim': 2, 'dt': 0}, 'dt is 0.*dim is 2'),
        ({'dt': float('nan')}, 'dt is nan'),
        ({'dt': '1/60'}, "dt is '1/60'"),
        ({'sequence_length': 4.0}, 'sequence_length is 4.0'),
        ({'mode_number': True}, 'mode_number is True'),
        ({'particles_rigid': -1}, 'particles_rigid is -1'),
        ({'bounds': [[0.1, 0.9]] * 2}, '3 pairs'),
        ({'bounds': [[0.9, 0.1]] * 3}, 'low < high'),
        ({'vel_std': [1.0, -1.0, 1.0]}, 'vel_std is .* none negative'),
        ({'vel_mean': [0.0] * 2}, 'vel_mean is .*3 numbers'),
        ({'acc_std': None}, 'acc_std is None'),
        ({'context_mean': [1.0, 2.0], 'context_std': [1.0]}, 'context_mean has 2 values but'),
        ({'schema_version': 2}, 'schema_version is 2, 1 was expected'),
        ({'pca': 'subspace.npz'}, 'pca is'),
        ({'pca': {'file': 5}}, "pca is {'file': 5}, an object with the file"),
        ({'pca': {'fitted_on': 1}}, 'pca is'),
        ({'projection_floors': {'modes': ['a']}}, 'projection_floors is .* lists of numbers'),
        ({'dataset_split': [1]}, r'dataset_split is \[1\], an object with a list'),
        ({'cases': {'train': ['a']}}, 'cases is .* one object a record'),
        ({'projection_mse': {'train': ['a']}}, 'projection_mse is .* one number a record'),
        ({'scene': {'rigid_motion': 'flying', 'force': True}}, "rigid_motion is 'flying'"),
        ({'scene': {'rigid_motion': 'prescribed', 'force': False}}, 'scene.force'),
        ({'scene': {'rigid_motion': 'driven', 'force': True, 'rigid_edges': [[0, 3]]}},
         r'rigid_edges has \[0, 3\], two of 3'),
        ({'scene': {'rigid_motion': 'driven', 'force': True, 'context_names': ['g']}},
         'context_names has 1 names but context_mean has 0'),
    ],
)  # fmt: skip
def test_metadata_that_does_not_fit(tmp_path, changes, text):
    folder = make_folder(tmp_path, [make_trajectory()], **changes)
    with pytest.raises(ValueError, match=text):
        dataset.read_split(folder, 'train')


def test_buffers_of_the_wrong_size_nan_and_other_node_types_are_named(tmp_path):
    folder = make_folder(tmp_path, [make_trajectory()], manifest=False)
    path = f'{folder}/train.tfrecord'
    good = next(tfrecord_io.read_records(path))
    infinite = list(good.frames['force'])
    infinite[2] = np.float32([1, np.inf, 3]).tobytes()
    for change, text in (
        ({'particle_type': good.particle_type[:-1]}, 'particle_type has 39 bytes'),
        ({'particle_type': good.particle_type[:-8]}, 'frame 0 has 60 bytes, 48 were expected'),
        ({'frames': {'position': []}}, 'position: has no frames'),
        ({'frames': {**good.frames, 'force': infinite}}, 'force holds 1 NaN .* frame 2'),
        ({'particle_type': np.array([6, 3, 3, 3, 6]).tobytes()}, 'mode_number says the last 2'),
        ({'particle_type': np.array([3, 3, 5, 6, 6]).tobytes()}, 'rigid nodes must be 0 or 3'),
    ):
        tfrecord_io.write_records(path, [dataclasses.replace(good, **change)])
        with pytest.raises(ValueError, match='record 0.*' + text):
            dataset.read_split(folder, 'train')


def test_missing_things_are_named(tmp_path):
    for folder, text in (('nowhere', 'no such dataset folder'), ('', 'metadata.json')):
        with pytest.raises(FileNotFoundError, match=text):
            dataset.read_metadata(str(tmp_path / folder))
    folder = make_folder(tmp_path, [make_trajectory()])
    with pytest.raises(FileNotFoundError, match=r"test.tfrecord: no such file; .*\['train'\]"):
        dataset.read_split(folder, 'test')
    with pytest.raises(ValueError, match="split 'evaluation' is not one of"):
        dataset.read_split(folder, 'evaluation')


def test_writer_refuses_what_does_not_fit(tmp_path):
    run = make_trajectory()
    broken = run.position.copy()
    broken[3, 4, 1] = np.nan
    for change, text in (
        ({'position': run.position[:, :4]}, 'position has shape'),
        ({'position': broken}, 'position holds 1 NaN .* frame 3, node 4, axis 1'),
        ({'force': run.force[:4]}, 'force has shape'),
        ({'force': run.force[:, :2]}, 'force has shape'),
        ({'step_context': np.zeros((4, 3), np.float32)}, 'step_context has shape'),
    ):
        with pytest.raises(ValueError, match='record 1: ' + text):
            runs = [run, dataclasses.replace(run, **change)]
            dataset.write_split(str(tmp_path / 'train.tfrecord'), runs)
    assert not os.listdir(tmp_path)
