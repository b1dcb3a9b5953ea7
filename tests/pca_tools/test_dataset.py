"""Dataset folders: round trip, and every disagreement between records, metadata and manifest."""

import dataclasses
import re

import numpy as np
import pytest

from pca_tools import dataset, files, tfrecord_io
from pca_tools.dataset import Trajectory
from pca_tools.metadata import metadata_problems


def make_trajectory(key=0, frames=5, rigid=3, modes=2, context=None, seed=0):
    rng = np.random.default_rng(seed)
    return Trajectory(
        key=key,
        particle_type=np.array([3] * rigid + [6] * modes, np.int64),
        position=rng.random((frames, rigid + modes, 3)).astype(np.float32),
        force=rng.random((frames, 3)).astype(np.float32),
        step_context=context,
    )


def make_metadata(**changes):
    """Metadata of such runs; `...` takes a key out."""
    statistics = {f'{name}_mean': [0.0] * 3 for name in ('vel', 'acc', 'rigid_body_force')}
    statistics |= {f'{name}_std': [1.0] * 3 for name in ('vel', 'acc', 'rigid_body_force')}
    metadata = {
        'bounds': [[0.1, 0.9]] * 3, 'sequence_length': 4, 'default_connectivity_radius': 0.025,
        'dim': 3, 'dt': 1 / 60, 'mode_number': 2, 'particles_rigid': 3, **statistics, **changes,
    }  # fmt: skip
    return {key: value for key, value in metadata.items() if value is not ...}


def make_folder(path, trajectories, **changes):
    """A dataset of training runs without a manifest."""
    files.write_json(f'{path}/metadata.json', make_metadata(**changes))
    dataset.write_split(f'{path}/train.tfrecord', trajectories)
    return str(path)


def test_round_trip_with_different_node_counts(tmp_path):
    context = np.tile(np.float32([9.81, 30, 100]), (5, 1))
    runs = [make_trajectory(i, rigid=3 + i, context=context, seed=i) for i in range(3)]
    runs = [dataclasses.replace(run, force=None) for run in runs]
    changes = {'context_mean': [0.0] * 3, 'context_std': [1.0] * 3}
    changes |= {'rigid_body_force_mean': ..., 'rigid_body_force_std': ...}
    read = dataset.read_split(make_folder(tmp_path, runs, **changes), 'train')
    for first, second in zip(runs, read, strict=True):
        for field in dataclasses.fields(Trajectory):
            values, found = getattr(first, field.name), getattr(second, field.name)
            np.testing.assert_array_equal(values, found)
            assert np.asarray(values).dtype == np.asarray(found).dtype
    assert [run.n_rigid for run in read] == [3, 4, 5]
    assert [run.n_modes for run in read] == [2, 2, 2]


IMPOSSIBLE = [
    ('dt', 0), ('dt', float('nan')), ('dt', '1/60'), ('dim', 2), ('sequence_length', 4.0),
    ('mode_number', True), ('particles_rigid', -1), ('bounds', [[0.1, 0.9]] * 2),
    ('bounds', [[0.9, 0.1]] * 3), ('vel_mean', [0.0] * 2), ('vel_std', [1.0, -1.0, 1.0]),
    ('acc_std', None), ('schema_version', 2), ('pca', 'subspace.npz'), ('pca', {'file': 5}),
    ('pca', {'fitted_on': 1}), ('projection_floors', {'modes': ['a']}), ('dataset_split', [1]),
    ('cases', {'train': ['a']}), ('projection_mse', {'train': ['a']}),
]  # fmt: skip


def test_impossible_values_are_named():
    for key, value in IMPOSSIBLE:
        (problem,) = metadata_problems(make_metadata(**{key: value}))
        assert problem.startswith(f'{key} is {value!r}, ') and 'was expected' in problem
    assert len(metadata_problems(make_metadata(dim=2, dt=0))) == 2


@pytest.mark.parametrize(
    'changes, text',
    [
        ({'sequence_length': 5}, r'has 5 frames, sequence_length \+ 1 = 6'),
        ({'mode_number': 3}, 'has 2 mode nodes .* among 5, mode_number says the last 3'),
        ({'rigid_body_force_mean': ..., 'rigid_body_force_std': ...},
         'the record has force but metadata lacks rigid_body_force_mean'),
        ({'context_mean': [0.0], 'context_std': [0.0]},
         'metadata has context_mean but the record lacks step_context'),
        ({'bounds': ...}, '^lacks bounds'),
        ({'context_mean': [1.0, 2.0], 'context_std': [1.0]}, 'context_mean has 2 values but'),
        ({'scene': {'rigid_motion': 'flying', 'force': True}}, "rigid_motion is 'flying'"),
        ({'scene': {'rigid_motion': 'prescribed', 'force': False}}, 'scene.force'),
        ({'scene': {'rigid_motion': 'driven', 'force': True, 'rigid_edges': [[0, 3]]}},
         r'rigid_edges has \[0, 3\], two of 3'),
        ({'scene': {'rigid_motion': 'driven', 'force': True, 'context_names': ['g']}},
         'context_names has 1 names, context_mean 0'),
    ],
)  # fmt: skip
def test_metadata_that_does_not_fit(changes, text):
    metadata = make_metadata(**changes)
    problems = metadata_problems(metadata)
    problems = problems or dataset.trajectory_problems(make_trajectory(), metadata)
    assert re.search(text, '; '.join(problems))


def test_buffers_of_the_wrong_size_nan_and_other_node_types_are_named(tmp_path):
    folder = make_folder(tmp_path, [make_trajectory()])
    path = f'{folder}/train.tfrecord'
    good = next(tfrecord_io.read_records(path))
    infinite = list(good.frames['force'])
    infinite[2] = np.float32([1, np.inf, 3]).tobytes()
    for change, text in (
        ({'particle_type': good.particle_type[:-1]}, 'particle_type has 39 bytes'),
        (
            {'particle_type': good.particle_type[:-8]},
            'position has 15 values a frame, 4 x 3 were expected',
        ),
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
    files.write_manifest(folder, {'metadata.json': {}, 'train.tfrecord': {'records': 2}})
    with pytest.raises(ValueError, match='has 1 records, the manifest says 2'):
        dataset.read_split(folder, 'train')
    make_folder(tmp_path, [make_trajectory()], bounds=...)
    with pytest.raises(ValueError, match='metadata.json: lacks bounds'):
        dataset.read_split(folder, 'train')


def test_runs_that_do_not_fit_are_named():
    run = make_trajectory()
    broken = run.position.copy()
    broken[3, 4, 1] = np.nan
    for change, text in (
        ({'position': run.position[:, :4]}, 'position has shape'),
        ({'position': broken}, 'position holds 1 NaN .* frame 3, point 4, axis 1'),
        ({'force': run.force[:4]}, 'force has shape'),
        ({'force': run.force[:, :2]}, 'force has shape'),
        ({'step_context': np.zeros((4, 3), np.float32)}, 'step_context has shape'),
    ):
        problems = dataset.trajectory_problems(dataclasses.replace(run, **change), make_metadata())
        assert re.search(text, '; '.join(problems))
