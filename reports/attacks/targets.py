"""The readers that are fuzzed: a small valid folder for each, and what may come out of it."""

import base64
import dataclasses
import hashlib
import json
import os

import numpy as np

from learning_to_simulate.rendering import rollout_frames
from learning_to_simulate.scene import RigidMotion, Scene
from learning_to_simulate.subspace import edge_lists
from learning_to_simulate.training import training_state
from mpm import raw_run
from nri import data as nri_data
from pca_tools import dataset, files, legacy_pickles, raw_runs, subspace
from pca_tools.storage import folder_lock
from reports.attacks.import_targets import IMPORT_TARGETS
from reports.attacks.model_targets import MODEL_TARGETS
from reports.attacks.target import Promise, Target

R, MODES, FRAMES, N_SOIL = 2, 2, 9, 6
# numpy.array([3.0, 2.0, 1.0]) in the form of the authors' files, pickle protocol 3.
_PICKLE = (
    'gANjbnVtcHkuX2NvcmUubXVsdGlhcnJheQpfcmVjb25zdHJ1Y3QKcQBjbnVtcHkKbmRhcnJheQpxAUsAhXECQwFi'
    'cQOHcQRScQUoSwFLA4VxBmNudW1weQpkdHlwZQpxB1gCAAAAZjhxCImIh3EJUnEKKEsDWAEAAAA8cQtOTk5K////'
    '/0r/////SwB0cQxiiUMYAAAAAAAACEAAAAAAAAAAQAAAAAAAAPA/cQ10cQ5iLg=='
)


def _rng():
    return np.random.default_rng(0)


def _metadata():
    statistics = {f'{n}_{end}': [0.5] * 3 for n in ('vel', 'acc') for end in ('mean', 'std')}
    return {
        'bounds': [[0.1, 0.9]] * 3, 'sequence_length': FRAMES - 1, 'dim': 3, 'dt': 0.0166,
        'default_connectivity_radius': 0.025, 'mode_number': MODES, 'n_soil': N_SOIL,
        'particles_rigid': R, **statistics, 'rigid_body_force_mean': [1.0] * 3,
        'rigid_body_force_std': [1.0] * 3, 'context_mean': [9.8], 'context_std': [1.0],
        'scene': {
            'name': 'fuzz', 'rigid_motion': 'driven', 'rigid_edges': [[0, 1], [1, 0]],
            'context_names': ['gravity'], 'force': True, 'up_axis': 1,
        },
        'cases': {'train': [{'case': 1}]}, 'projection_mse': {'train': [1e-6]},
        'pca': {'file': 'subspace.npz', 'digest': 'x'}, 'schema_version': 1,
    }  # fmt: skip


def _trajectories():
    rng = _rng()
    types = np.array([0] * R + [6] * MODES)
    return [
        dataset.Trajectory(
            key, types, rng.random((FRAMES, R + MODES, 3), np.float32),
            rng.random((FRAMES, 3), np.float32), np.full((FRAMES, 1), 9.8, np.float32),
        )
        for key in range(2)
    ]  # fmt: skip


def _write_dataset(folder):
    files.write_json(f'{folder}/metadata.json', _metadata())
    dataset.write_split(f'{folder}/train.tfrecord', _trajectories())


def _write_sealed_dataset(folder):
    _write_dataset(folder)
    files.write_manifest(folder, {'metadata.json': {}, 'train.tfrecord': {'records': 2}})


def _possible_trajectories(runs):
    return all(
        np.isfinite(run.position).all()
        and run.position.shape == (FRAMES, run.n_rigid + MODES, 3)
        and run.force.shape == (FRAMES, 3)
        and run.step_context.shape == (FRAMES, 1)
        for run in runs
    )


def _read_metadata(folder):
    metadata = dataset.read_metadata(folder)
    return metadata, Scene.from_metadata(metadata, rigid_particle_type=0)


def _possible_metadata(value):
    metadata, scene = value
    return (
        scene.n_modes == metadata['mode_number'] > 0
        and 0 < scene.dt < np.inf
        and all(low < high for low, high in metadata['bounds'])
        and all(
            np.isfinite(np.float64(v)).all()
            for k, v in metadata.items()
            if k.endswith(('_mean', '_std'))
        )
        and isinstance(scene.rigid_motion, RigidMotion)
        and scene.up_axis in (0, 1, 2)
        and (scene.n_soil is None or scene.n_soil > 0)
    )


def _write_subspace(folder):
    rng = _rng()
    runs = [rng.random((4, N_SOIL, 3)) for _ in range(2)]
    subspace.fit(runs, MODES).save(f'{folder}/subspace.npz')


def _possible_subspace(space):
    arrays = (space.mean, space.components, space.singular_values, space.initial)
    return (
        all(a.dtype.kind == 'f' and np.isfinite(a).all() for a in arrays)
        and np.isfinite(space.decode(space.encode(space.initial))).all()
        and 0 < space.total_energy < np.inf
        and np.isfinite(space.projection_floor())
    )


def _write_mask(folder):
    np.save(f'{folder}/mask.npy', _rng().random((4, 4)) < 0.5)


def _write_edges(folder):
    probabilities = _rng().random((4, 4))
    edges = edge_lists.EdgeList(
        mask=edge_lists.select(probabilities, threshold=0.5),
        node_names=edge_lists.mode_names(4), probabilities=probabilities, method='nri',
        threshold=0.5, digests={'model': 'a' * 64, 'subspace.npz': 'b' * 64},
    )  # fmt: skip
    edge_lists.write(f'{folder}/edges.json', edges)


def _possible_mask(mask):
    return mask.dtype == bool and mask.ndim == 2 and mask.shape[0] == mask.shape[1]


def _write_rollout(folder):
    first = _trajectories()[0]
    p, f = first.position, first.force
    files.write_npz(
        f'{folder}/rollout_test_0.npz',
        initial_positions=p[:6], predicted_rollout=p[6:] * 1.01, ground_truth_rollout=p[6:],
        particle_types=first.particle_type, metadata=np.array(json.dumps(_metadata())),
        initial_forces=f[:6], predicted_forces=f[6:], ground_truth_forces=f[6:],
    )  # fmt: skip


def _possible_rollout(frames):
    arrays = [*frames.rigid.values(), *(frames.force or {}).values()]
    return (
        all(np.isfinite(a).all() and len(a) == frames.n_frames for a in arrays)
        and all(np.isfinite(a).all() for a in [*frames.soil.values(), *frames.soil_rms_mm.values()])
        and np.isfinite(frames.time).all()
        and isinstance(frames.title, str)
    )


def _write_raw(folder):
    rng, entries = _rng(), []
    for case in (1, 2):
        name = f'run_{case:03d}.npz'
        parameters = {'case': case, 'context': {'gravity': 9.8}}
        files.write_npz(
            f'{folder}/{name}', positions=rng.random((4, N_SOIL, 3), np.float32),
            rigid_positions=rng.random((4, R, 3), np.float32),
            force=rng.random((4, 3), np.float32), parameters=np.array(json.dumps(parameters)),
        )  # fmt: skip
        path = f'{folder}/{name}'
        entries.append({
            'file': name, 'case': case, 'bytes': os.path.getsize(path),
            'sha256': files.sha256_of_file(path), 'parameters': parameters,
        })  # fmt: skip
    values = {'scene': _metadata()['scene'], 'dt': 0.0166, 'bounds': [[0.1, 0.9]] * 3}
    files.write_json(f'{folder}/manifest.json', values | {'runs': entries})


def _possible_raw(runs):
    return all(
        run.positions.shape[2] == 3
        and all(np.isfinite(a).all() for a in (run.positions, run.rigid_positions, run.context))
        and (run.force is None or np.isfinite(run.force).all())
        for run in runs
    )


def _read_raw_of_solver(folder):
    manifest = raw_run.read_manifest(folder)
    run = raw_run.read_run(f'{folder}/run_001.npz')
    return manifest, run.positions, run.rigid_positions, run.force, run.parameters


def _possible_raw_of_solver(value):
    _, positions, rigid, force, parameters = value
    arrays = (positions, rigid, force)
    return isinstance(parameters, dict) and all(np.isfinite(a).all() for a in arrays)


def _write_pickle(folder):
    with open(f'{folder}/pca_eigen_values.pkl', 'wb') as file:
        file.write(base64.b64decode(_PICKLE))


def _possible_numbers(array):
    return isinstance(array, np.ndarray) and array.dtype.kind in 'fciu'


def _write_kipf(folder):
    rng = _rng()
    for name, shape in (('loc', (2, 5, 2, 3)), ('vel', (2, 5, 2, 3)), ('edges', (2, 3, 3))):
        values = rng.random(shape) if name != 'edges' else rng.integers(0, 2, shape)
        np.save(f'{folder}/{name}_train_springs3.npy', values)


def _possible_kipf(data):
    return np.isfinite(data.features).all() and np.isin(data.edges, (0, 1)).all()


def _write_checkpoints(folder):
    for step in (8, 12):
        for end in ('index', 'data-00000-of-00001'):
            with open(f'{folder}/ckpt-{step}.{end}', 'wb') as file:
                file.write(bytes(range(200)) + bytes([step]))
        names = [n for n in os.listdir(folder) if n.startswith(f'ckpt-{step}.')]
        files.write_manifest(folder, {n: {} for n in names}, f'ckpt-{step}.json')


def _newest_whole_checkpoint(folder):
    """Step and bytes of the checkpoint that training would go on from."""
    for step in training_state.stored_steps(folder):
        try:
            training_state.check(folder, step)
        except ValueError:
            continue
        names = (f'ckpt-{step}.index', f'ckpt-{step}.data-00000-of-00001')
        return step, *(files.sha256_of_file(os.path.join(folder, name)) for name in names)
    raise ValueError(f'{folder}: all checkpoints are damaged')


def _possible_checkpoint(value):
    step, *digests = value
    written = hashlib.sha256(bytes(range(200)) + bytes([step])).hexdigest()
    return step in (8, 12) and digests == [written] * 2


def _write_lock(folder):
    owner = folder_lock.Owner('elsewhere', 4711, 99)
    files.write_json(f'{folder}/{folder_lock.LOCK_NAME}', dataclasses.asdict(owner))


def _take_lock(folder):
    with folder_lock.locked(folder, take_over=True):
        return 'taken'


TARGETS = (
    Target('dataset with manifest', Promise.SEALED, _write_sealed_dataset,
           ('train.tfrecord', 'metadata.json', 'manifest.json'),
           lambda folder: dataset.read_split(folder, 'train')),
    Target('records without manifest', Promise.CHECKSUM, _write_dataset, ('train.tfrecord',),
           lambda folder: dataset.read_split(folder, 'train'), _possible_trajectories, list,
           share=2),
    Target('metadata.json', Promise.OPEN, _write_dataset, ('metadata.json',), _read_metadata,
           _possible_metadata),
    Target('subspace.npz', Promise.CHECKSUM, _write_subspace, ('subspace.npz',),
           lambda folder: subspace.Subspace.load(f'{folder}/subspace.npz'), _possible_subspace),
    Target('edges.json', Promise.OPEN, _write_edges, ('edges.json',),
           lambda folder: edge_lists.read(f'{folder}/edges.json').mask, _possible_mask),
    Target('mask.npy', Promise.OPEN, _write_mask, ('mask.npy',),
           lambda folder: edge_lists.read_mask(f'{folder}/mask.npy'), _possible_mask),
    Target('rollout npz', Promise.CHECKSUM, _write_rollout, ('rollout_test_0.npz',),
           lambda folder: rollout_frames.load(f'{folder}/rollout_test_0.npz', None),
           _possible_rollout),
    Target('raw runs', Promise.SEALED, _write_raw, ('run_001.npz', 'run_002.npz'),
           lambda folder: list(raw_runs.RawRuns(folder))),
    Target('raw manifest', Promise.OPEN, _write_raw, ('manifest.json',),
           lambda folder: list(raw_runs.RawRuns(folder)), _possible_raw),
    Target('raw runs, solver', Promise.CHECKSUM, _write_raw, ('run_001.npz',),
           _read_raw_of_solver, _possible_raw_of_solver),
    Target('raw manifest, solver', Promise.OPEN, _write_raw, ('manifest.json',),
           lambda folder: raw_run.read_manifest(folder)),
    Target("authors' pickles", Promise.OPEN, _write_pickle, ('pca_eigen_values.pkl',),
           lambda folder: legacy_pickles.read_array(f'{folder}/pca_eigen_values.pkl'),
           _possible_numbers),
    Target('Kipf .npy', Promise.OPEN, _write_kipf,
           tuple(f'{n}_train_springs3.npy' for n in ('loc', 'vel', 'edges')),
           lambda folder: nri_data.load(folder, 'train'), _possible_kipf),
    Target('checkpoints', Promise.OPEN, _write_checkpoints,
           tuple(f'ckpt-{step}.{end}' for step in (8, 12)
                 for end in ('index', 'data-00000-of-00001', 'json')),
           _newest_whole_checkpoint, _possible_checkpoint),
    Target('folder lock', Promise.OPEN, _write_lock, (folder_lock.LOCK_NAME,), _take_lock),
    *IMPORT_TARGETS,
    *MODEL_TARGETS,
)  # fmt: skip
