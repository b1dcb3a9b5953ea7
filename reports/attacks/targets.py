"""The readers that are fuzzed: a small valid folder for each, and what may come out of it.

Whole models build what a forged `config.json` asks for, so they show what it costs: tens of
milliseconds an input, hence their small share.
"""

import base64
import dataclasses
import enum
import hashlib
import json
import os
from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree

import numpy as np
import tensorflow as tf

from learning_to_simulate import checkpoints
from learning_to_simulate.config import TrainConfig
from learning_to_simulate.native import fmu, model_data
from learning_to_simulate.normalization import Statistics
from learning_to_simulate.rendering import rollout_frames
from learning_to_simulate.scene import RigidMotion, Scene
from learning_to_simulate.subspace import edge_lists, subspace_model
from learning_to_simulate.subspace.learned_simulator import LearnedSimulator
from learning_to_simulate.training import training_state
from mpm import raw_run
from nri import data as nri_data
from nri import model as nri_model
from nri.config import NriConfig
from pca_tools import dataset, files, legacy_pickles, packing, particles, raw_runs, subspace
from pca_tools.formats import detect, full_space
from pca_tools.storage import folder_lock

R, MODES, FRAMES, N_SOIL = 2, 2, 9, 6
# numpy.array([3.0, 2.0, 1.0]) in the form of the authors' files, pickle protocol 3.
_PICKLE = (
    'gANjbnVtcHkuX2NvcmUubXVsdGlhcnJheQpfcmVjb25zdHJ1Y3QKcQBjbnVtcHkKbmRhcnJheQpxAUsAhXECQwFi'
    'cQOHcQRScQUoSwFLA4VxBmNudW1weQpkdHlwZQpxB1gCAAAAZjhxCImIh3EJUnEKKEsDWAEAAAA8cQtOTk5K////'
    '/0r/////SwB0cQxiiUMYAAAAAAAACEAAAAAAAAAAQAAAAAAAAPA/cQ10cQ5iLg=='
)
_IMPORT_FRAMES = 5


class Promise(enum.Enum):
    """What a reader owes its caller when the file was changed.

    SEALED: digests cover the files; a value that is returned equals the original one.
    CHECKSUM: so for damaged bytes, which a checksum finds; where the content was forged together
      with its checksum, a value that is returned is a possible one.
    OPEN: there is no checksum; a value that is returned is a possible one.
    """

    SEALED = 'sealed'
    CHECKSUM = 'checksum'
    OPEN = 'open'


@dataclasses.dataclass(frozen=True)
class Target:
    """A reader under test.

    Attributes:
      name: for the table.
      promise: see `Promise`.
      write: makes the valid files in a folder.
      changed: names of the files that are damaged, in turn.
      read: reads the folder.
      possible: whether a value could be that of some valid file, judged apart from the reader.
      parts: splits a value into parts; of a CHECKSUM file without a list of its parts, damage may
        lose or repeat whole ones.
      share: turns in each round of inputs; fewer for a reader that costs many times the others.
    """

    name: str
    promise: Promise
    write: Callable[[str], None]
    changed: tuple[str, ...]
    read: Callable[[str], Any]
    possible: Callable[[Any], bool] = lambda value: True
    parts: Callable[[Any], list] = lambda value: [value]
    share: int = 16


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
            key=key, particle_type=types,
            position=rng.random((FRAMES, R + MODES, 3), np.float32),
            force=rng.random((FRAMES, 3), np.float32),
            step_context=np.full((FRAMES, 1), 9.8, np.float32),
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
            force=rng.random((4, 3), np.float32), torque=rng.random((4, 3), np.float32),
            pose=np.eye(7, dtype=np.float32)[[3] * 4], parameters=np.array(json.dumps(parameters)),
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


def _data() -> full_space.FullSpaceData:
    """Two small runs with a body, a force and a context."""
    rng = np.random.default_rng(0)
    types = np.array([3, 6, 6, 6])

    def runs():
        for number, split in enumerate(('train', 'test')):
            positions = rng.uniform(0.2, 0.8, (_IMPORT_FRAMES, 4, 3)).astype(np.float32)
            force = rng.normal(size=(_IMPORT_FRAMES, 3)).astype(np.float32)
            yield full_space.FullSpaceRun(f'{split}_{number}', split, positions, types, force)

    held = list(runs())
    return full_space.FullSpaceData(
        'here', lambda: iter(held), 0.1, bounds=[[0.0, 1.0]] * 3, up_axis=1, radius=0.1
    )


def _writer(name: str) -> Callable[[str], None]:
    return lambda folder: detect.FORMATS[name].write(folder, _data())


def _reader(name: str) -> Callable[[str], list]:
    def read(folder: str) -> list:
        data = detect.FORMATS[name].read(folder, 0.1)
        return [(run.positions, run.particle_type, run.force, run.context) for run in data.runs()]

    return read


def _possible_runs(runs: list) -> bool:
    """Shapes that fit each other; values are the business of `write_raw`."""
    return all(
        positions.ndim == 3
        and positions.shape[2] in (2, 3)
        and positions.dtype.kind in 'fiu'
        and types.shape == positions.shape[1:2]
        and (force is None or len(force) == len(positions))
        for positions, types, force, _ in runs
    )


def _write_sample(folder: str) -> None:
    positions = np.random.default_rng(0).uniform(0.0, 1.0, (_IMPORT_FRAMES, 4, 3))
    packed = [(packing.pack_steps(positions, positions[0], particles.RESOLUTION), _IMPORT_FRAMES)]
    particles.write_sample(
        os.path.join(folder, 'particles_train.npz'), packed, np.arange(4), positions[0]
    )


def _read_sample(folder: str) -> list:
    return list(particles.ParticleSample(os.path.join(folder, 'particles_train.npz')))


def _possible_sample(runs: list) -> bool:
    return all(run.ndim == 3 and run.dtype == np.float64 for run in runs)


# MPM-NGF and VTP keep folders of files, the bench single ones.
_CHANGED = {
    'deepmind': ('train.tfrecord', 'metadata.json'),
    'geoelements': ('train.npz', 'metadata.json'),
    'lagrangebench': ('train.h5', 'metadata.json'),
    'npz': ('train_0.npz',),
}

IMPORT_TARGETS = (
    *(
        Target(f'import {name}', Promise.OPEN, _writer(name), files, _reader(name), _possible_runs,
               share={'deepmind': 2, 'npz': 4}.get(name, Target.share))
        for name, files in _CHANGED.items()
    ),
    Target('particle sample', Promise.CHECKSUM, _write_sample, ('particles_train.npz',),
           _read_sample, _possible_sample),
)  # fmt: skip


WEIGHT_SHAPES = {'000.layer/w': (3, 4), '001.layer/b': (4,)}
_SCENE = Scene(
    'fuzz', MODES, RigidMotion.DRIVEN, ((0, 1), (1, 0)), True, ('gravity',), 6, 0.0166
)  # fmt: skip
_MASK = np.array([[1, 0], [1, 1]], bool)


def _statistics() -> Statistics:
    """Of a model of our style with a driven body, all parts present."""
    classes = MODES + 1
    pair, axes = (classes, classes, 3), (3,)
    shapes = {
        'displacement_mean': pair, 'displacement_std': pair, 'force_mean': axes, 'force_std': axes,
        'position_range': (2, classes, 3), 'given_range': (2, 3), 'body_extent_range': (2, 3),
        'given_velocity_range': (2, 3),
        'body_speed_range': (2, 1), 'context_range': (2, 1),
    }  # fmt: skip
    ones = ('height', 'body_speed', 'context', 'log')
    arrays = {}
    for field in dataclasses.fields(Statistics):
        default = (1,) if field.name.startswith(ones) else (classes, 3)
        arrays[field.name] = np.full(shapes.get(field.name, default), 0.25)
    # Neither an input nor a share of a driven body's; and no C form has a torque.
    arrays |= dict.fromkeys(('path', 'contact', 'surface', 'torque_mean', 'torque_std'))
    return Statistics(**arrays)


def _write_model(folder: str) -> None:
    config = TrainConfig('pcg', latent_size=4, hidden_layers=1)
    simulator = LearnedSimulator(_SCENE, config, _statistics())
    model = subspace_model.Model(simulator, _MASK, None)
    tf.random.set_seed(0)
    model.create_variables(R)
    checkpoints.save_config(folder, model, R, {'path': 'x', 'sha256': {}})
    checkpoints.save_weights(folder, simulator)


def _read_model(folder: str):
    model = subspace_model.load(folder)
    simulator = model.simulator
    weights = [variable.numpy() for variable in simulator.trainable_variables]
    return simulator.config, simulator.scene, model.edge_counts(), weights


def _possible_model(value) -> bool:
    config, scene, _, weights = value
    widths = {width for weight in weights for width in weight.shape}
    return (
        all(np.isfinite(weight).all() for weight in weights)
        and config.latent_size in widths
        and scene.n_modes == MODES
    )


def _write_nri(folder: str) -> None:
    config = NriConfig(hidden=4, window=6, segment=2)
    offset = np.zeros((1, 4))
    nri_model.NriModel(config, ('a', 'b', 'c'), offset, offset + 1.0, 'digest').save(folder)


def _read_nri(folder: str):
    model = nri_model.load_model(folder)
    # What a window of zeros says about the edges: the numbers of the file are used, too.
    shape = (1, len(model.node_names), model.config.window, model.offset.shape[1])
    frames = np.zeros(shape, np.float32)
    return model.config, model.node_names, model.encode(frames, is_training=False).numpy()


def _possible_nri(value) -> bool:
    config, names, logits = value
    return logits.shape == (1, len(names) * (len(names) - 1), config.edge_types)


def _read_config(folder: str):
    return subspace_model.read_parts(folder)


def _possible_config(parts) -> bool:
    masks = [m for m in (parts.mode_mask, parts.loaded_mask) if m is not None]
    arrays = [a for a in dataclasses.asdict(parts.statistics).values() if a is not None]
    small = parts.config.latent_size <= 4096 and parts.n_rigid <= 1000
    return small and all(np.isfinite(a).all() for a in arrays) and all(map(_possible_mask, masks))


def _read_weights(folder: str):
    stored = checkpoints.stored_weights(folder)
    return checkpoints.check_weights(folder, stored, WEIGHT_SHAPES)


def _write_weights(folder: str) -> None:
    rng = np.random.default_rng(0)
    arrays = {name: rng.random(shape, np.float32) for name, shape in WEIGHT_SHAPES.items()}
    files.write_npz(f'{folder}/{checkpoints.WEIGHTS_FILE}', **arrays)


def _possible_weights(weights) -> bool:
    return {n: w.shape for n, w in weights.items()} == WEIGHT_SHAPES and all(
        np.isfinite(w).all() for w in weights.values()
    )


def _describe(folder: str):
    """The FMU's description of a model folder, with its names as an importing tool reads them."""
    parts = _read_config(folder)
    rest = np.zeros((R, 3))
    start = {'modes': rest, 'points': rest, 'context': np.ones(len(parts.scene.context_names))}
    try:
        text = fmu.description('soil', _values(parts.scene, start), ['lts.c'])
    except ValueError as error:  # the description is made of values: it knows no file
        raise ValueError(f'{folder}/config.json: {error}') from error
    return parts.scene, text


def _values(scene: Scene, start: dict) -> dict:
    """The part of `model_data.values` that a description needs; weights are not."""
    return {
        'name': scene.name,
        'context_names': ','.join(scene.context_names),
        'n_context': len(scene.context_names),
        'motion': model_data.MOTIONS.index(scene.rigid_motion),
        'dt': scene.dt,
        'digest': '0' * 64,
        'n_start': 1,
        'starts': [start],
    }


def _possible_description(value) -> bool:
    """It parses, says what the scene says, and no two variables have one name."""
    scene, text = value
    root = ElementTree.fromstring(text)
    names = [v.get('name') for v in root.iter('ScalarVariable')]
    step = root.find('DefaultExperiment').get('stepSize')
    return (
        len(set(names)) == len(names)
        and set(scene.context_names) <= set(names)
        and float(step) == scene.dt
        and root.get('description').endswith(scene.name)
    )


MODEL_TARGETS = (
    Target('model config.json', Promise.OPEN, _write_model, ('config.json',), _read_config,
           _possible_config),
    Target('model weights.npz', Promise.CHECKSUM, _write_weights, ('weights.npz',),
           _read_weights, _possible_weights),
    Target('load_model', Promise.OPEN, _write_model, ('config.json', 'weights.npz'), _read_model,
           _possible_model, share=1),
    Target('load_model of NRI', Promise.OPEN, _write_nri, ('config.json', 'weights.npz'),
           _read_nri, _possible_nri, share=1),
    Target('FMU description', Promise.OPEN, _write_model, ('config.json',), _describe,
           _possible_description),
)  # fmt: skip

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
