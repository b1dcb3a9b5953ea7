"""The readers that are fuzzed: a small valid folder for each, and what may come out of it.

Whole models build what a forged `config.json` asks for, so they show what it costs: tens of
milliseconds an input.
"""

import base64
import dataclasses
import enum
import json
import os
import shutil
from collections.abc import Callable
from typing import Any

import numpy as np

from learning_to_simulate import checkpoints, shipped
from learning_to_simulate.live import roll_out_path
from learning_to_simulate.rendering import rollout_frames
from learning_to_simulate.scene import RigidMotion, Scene
from learning_to_simulate.soil_field import digs, field
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Blade
from learning_to_simulate.subspace import edge_lists, subspace_model
from learning_to_simulate.training import loop
from mpm import bodies
from nri import data as nri_data
from nri import model as nri_model
from nri.config import NriConfig
from pca_tools import (
    compression,
    dataset,
    files,
    formats,
    heights,
    legacy_pickles,
    particles,
    raw_runs,
    subspace,
)
from pca_tools.formats import full_space
from tests.faults.small import FRAMES, MODES, copies

# numpy.array([3.0, 2.0, 1.0]) in the form of the authors' files, pickle protocol 3.
_PICKLE = (
    'gANjbnVtcHkuX2NvcmUubXVsdGlhcnJheQpfcmVjb25zdHJ1Y3QKcQBjbnVtcHkKbmRhcnJheQpxAUsAhXECQwFi'
    'cQOHcQRScQUoSwFLA4VxBmNudW1weQpkdHlwZQpxB1gCAAAAZjhxCImIh3EJUnEKKEsDWAEAAAA8cQtOTk5K////'
    '/0r/////SwB0cQxiiUMYAAAAAAAACEAAAAAAAAAAQAAAAAAAAPA/cQ10cQ5iLg=='
)


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


def is_finite(value: Any) -> bool:
    """Whether all arrays inside a value are finite."""
    if dataclasses.is_dataclass(value):
        value = [getattr(value, field.name) for field in dataclasses.fields(value)]
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, (list, tuple)):
        return all(map(is_finite, value))
    is_real = isinstance(value, np.ndarray) and value.dtype.kind == 'f'
    return not is_real or bool(np.isfinite(value).all())


@dataclasses.dataclass(frozen=True)
class Target:
    """A reader under test."""

    name: str
    promise: Promise
    write: Callable[[str], None]  # makes the valid files in a folder
    changed: tuple[str, ...]  # names of the files that are damaged, in turn
    read: Callable[[str], Any]  # reads the folder
    # Whether a value could be that of some valid file, judged apart from the reader.
    possible: Callable[[Any], bool] = is_finite
    # Of a CHECKSUM file without a list of its parts, damage may lose or repeat whole ones.
    parts: Callable[[Any], list] = lambda value: [value]


def _rng():
    return np.random.default_rng(0)


def _possible_trajectories(runs):
    return is_finite(runs) and all(
        run.position.shape == (FRAMES, run.n_rigid + MODES, 3) and run.force.shape == (FRAMES, 3)
        for run in runs
    )


def _read_metadata(folder):
    metadata = dataset.read_metadata(folder)
    return metadata, Scene.from_metadata(metadata, rigid_particle_type=0)


def _possible_metadata(value):
    metadata, scene = value
    statistics = (v for k, v in metadata.items() if k.endswith(('_mean', '_std')))
    return (
        scene.n_modes == metadata['mode_number'] > 0
        and 0 < scene.dt < np.inf
        and all(low < high for low, high in metadata['bounds'])
        and all(np.isfinite(np.float64(v)).all() for v in statistics)
        and isinstance(scene.rigid_motion, RigidMotion)
        and scene.up_axis in (0, 1, 2)
        and (scene.n_soil is None or scene.n_soil > 0)
    )


def _possible_subspace(space):
    return (
        is_finite(space)
        and all(a.dtype.kind == 'f' for a in (space.mean, space.components, space.initial))
        and np.isfinite(space.decode(space.encode(space.initial))).all()
        and 0 < space.total_energy < np.inf
        and np.isfinite(space.projection_floor())
    )


def _write_edges(folder):
    probabilities = _rng().random((4, 4))
    mask = edge_lists.select(probabilities, threshold=0.5)
    np.save(f'{folder}/mask.npy', mask)
    edges = edge_lists.EdgeList(
        mask, edge_lists.mode_names(4), probabilities, 'nri', 0.5,
        {'model': 'a' * 64, 'subspace.npz': 'b' * 64},
    )  # fmt: skip
    edge_lists.write(f'{folder}/edges.json', edges)


def _possible_mask(mask):
    return mask.dtype == bool and mask.ndim == 2 and mask.shape[0] == mask.shape[1]


def _write_rollout(folder):
    copies('data', 'metadata.json', 'train.tfrecord')(folder)
    first = dataset.read_records_as_trajectories(f'{folder}/train.tfrecord')[0]
    p, f = first.position, first.force
    files.write_npz(
        f'{folder}/rollout_test_0.npz',
        initial_positions=p[:6], predicted_rollout=p[6:] * 1.01, ground_truth_rollout=p[6:],
        particle_types=first.particle_type, initial_forces=f[:6], predicted_forces=f[6:],
        ground_truth_forces=f[6:], metadata=np.array(json.dumps(dataset.read_metadata(folder))),
    )  # fmt: skip


def _possible_rollout(frames):
    of_frames = [*frames.rigid.values(), *(frames.force or {}).values()]
    return (
        all(len(a) == frames.n_frames for a in of_frames)
        and is_finite([*of_frames, frames.soil, frames.soil_rms_mm, frames.time])
        and isinstance(frames.title, str)
    )


def _possible_raw(runs):
    return is_finite(runs) and all(run.positions.shape[2] == 3 for run in runs)


def _write_pickle(folder):
    with open(f'{folder}/pca_eigen_values.pkl', 'wb') as file:
        file.write(base64.b64decode(_PICKLE))


def _write_kipf(folder):
    rng = _rng()
    for name in ('loc', 'vel'):
        np.save(f'{folder}/{name}_train_springs3.npy', rng.random((2, 5, 2, 3)))
    np.save(f'{folder}/edges_train_springs3.npy', rng.integers(0, 2, (2, 3, 3)))


def _possible_kipf(data):
    return is_finite(data) and np.isin(data.edges, (0, 1)).all()


def _write_checkpoints(folder):
    for step in (8, 12):
        values = np.arange(200.0) + step
        files.write_npz(loop.file_of(folder, step), values=values, step=np.array(step))


def _possible_checkpoint(value):
    step, arrays, damaged = value
    return step in {0, 8, 12} - damaged.keys() and all(
        isinstance(array, np.ndarray) for array in arrays.values()
    )


def _full_space_data() -> full_space.FullSpaceData:
    """Two small runs with a body and a force."""
    rng, held = _rng(), []
    for number, split in enumerate(('train', 'test')):
        positions = rng.uniform(0.2, 0.8, (5, 4, 3)).astype(np.float32)
        force, types = rng.normal(size=(5, 3)).astype(np.float32), np.array([3, 6, 6, 6])
        held.append(full_space.FullSpaceRun(f'{split}_{number}', split, positions, types, force))
    return full_space.FullSpaceData(
        'here', lambda: iter(held), 0.1, bounds=[[0.0, 1.0]] * 3, up_axis=1, radius=0.1
    )


def _import(name: str, changed: tuple[str, ...]) -> Target:
    """The reader of a foreign format: shapes must fit; values are the business of `write_raw`."""

    def read(folder):
        runs = formats.FORMATS[name].read(folder, 0.1).runs()
        return [(run.positions, run.particle_type, run.force, run.context) for run in runs]

    def possible(runs):
        return all(
            positions.ndim == 3
            and positions.shape[2] in (2, 3)
            and positions.dtype.kind in 'fiu'
            and types.shape == positions.shape[1:2]
            and (force is None or len(force) == len(positions))
            for positions, types, force, _ in runs
        )

    def write(folder):
        formats.FORMATS[name].write(folder, _full_space_data())

    return Target(f'import {name}', Promise.OPEN, write, changed, read, possible)


def _packed(kind: type[compression.PackedRuns], **own) -> Target:
    """The reader of series of runs; `own` are the arrays of their kind."""
    name = f'{kind.NAME}_train.npz'

    def write(folder):
        values = _rng().uniform(0.0, 1.0, (9, 4, 3))
        kind.write(folder, 'train', [kind.pack(values, values[0])] * 2, values[0], **own)

    def read(folder):
        runs = kind(f'{folder}/{name}')
        return list(runs), [getattr(runs, key) for key in own]

    def possible(value):
        return is_finite(value) and all(run.ndim == 3 for run in value[0])

    return Target(kind.TITLE, Promise.CHECKSUM, write, (name,), read, possible)


def _read_terrain(folder):
    t = Terrain.load(f'{folder}/ground.npz')
    return t.heights, t.cell, t.corner, t.floor, t.walled, t.soil


def _possible_terrain(value):
    surface, cell, _, floor, _, soil = value
    return (
        is_finite(value) and surface.ndim == 2 and surface.size and (cell > 0).all()
        and -np.inf < floor <= surface.min() and 0 < soil.friction < np.inf
    )  # fmt: skip


def _write_table(folder):
    """A dig as `lts fit-soil` reads it, and its poses as `lts rollout` does."""
    rows = [
        f'{i / 60:.4f},{1 - 0.01 * i},{0.2 - 0.003 * i},{0.5 * i},{-3.0 * i},{2.0 * i}'
        for i in range(8)
    ]
    text = ['time_s,x_m,y_m,angle_deg,force_x_N,force_y_N', *rows]
    files.write_text(f'{folder}/dig.csv', '\n'.join(text) + '\n')
    poses = [','.join(row.split(',')[1:4]) for row in rows]
    files.write_text(f'{folder}/path.csv', '# x, y, angle\n' + '\n'.join(poses) + '\n')


def _read_digs(folder):
    found = digs.read(f'{folder}/dig.csv', Blade(), None, 0.2, 9.81)
    return [(d.name, d.times, d.pose, d.force, d.terrain.heights) for d in found]


def _possible_digs(found):
    return all(
        is_finite([times, pose, ground]) and (np.diff(times) > 0).all()
        and pose.shape == (len(times), 7) and force.shape == (len(times), 3)
        for _, times, pose, force, ground in found
    )  # fmt: skip


def _write_tools(folder):
    outline = [[0.0, 0.0], [0.02, 0.12], [-0.03, 0.2]]
    bucket = {'name': 'bucket', 'outline': outline, 'edge_radius': 0.004, 'width': 0.3,
              'side_plates': {'thickness': 0.01}, 'friction': 0.3}  # fmt: skip
    lugs = {'count': 12, 'height': 0.01, 'thickness': 0.004}
    wheel = {'name': 'wheel', 'radius': 0.15, 'width': 0.12, 'friction': 0.5, 'grousers': lugs}
    for tool in (bucket, wheel):
        files.write_json(f'{folder}/{tool["name"]}.json', tool)


def _possible_tools(tools):
    return all(bodies.check_tool(tool) == tool and tool['width'] > 0 for tool in tools)


def _write_field(folder):
    for name in _MODEL:
        shutil.copy(os.path.join(shipped.find('excavation', 'models'), name), folder)


def _read_field(folder):
    found = field.load(folder)
    weights = {n: v.numpy() for n, v in field._weights(found.networks).items()}
    return found.config, found.ranges, found.bounds, found.limits, weights


def _possible_field(value):
    config, _, bounds, _, weights = value
    return is_finite(list(weights.values())) and config.members > 0 and is_finite(bounds)


def _read_model(folder):
    model = subspace_model.load(folder)
    s = model.simulator
    return s.config, s.scene, model.edge_counts(), [v.numpy() for v in s.trainable_variables]


def _possible_model(value):
    config, scene, _, weights = value
    widths = {width for weight in weights for width in weight.shape}
    return is_finite(weights) and config.latent_size in widths and scene.n_modes == MODES


def _write_nri(folder):
    config = NriConfig(hidden=4, window=6, segment=2)
    offset = np.zeros((1, 4))
    nri_model.NriModel(config, ('a', 'b', 'c'), offset, offset + 1.0, 'digest').save(folder)


def _read_nri(folder):
    model = nri_model.load_model(folder)
    # What a window of zeros says about the edges: the numbers of the file are used, too.
    shape = (1, len(model.node_names), model.config.window, model.offset.shape[1])
    frames = np.zeros(shape, np.float32)
    return model.config, model.node_names, model.encode(frames, is_training=False).numpy()


def _possible_nri(value):
    config, names, logits = value
    return logits.shape == (1, len(names) * (len(names) - 1), config.edge_types)


_RECORDS = ('metadata.json', 'train.tfrecord')
_MODEL = ('config.json', checkpoints.WEIGHTS_FILE)
TARGETS = (
    Target('dataset with manifest', Promise.SEALED, copies('data'), (*_RECORDS, 'manifest.json'),
           lambda folder: dataset.read_split(folder, 'train')),
    Target('records without manifest', Promise.CHECKSUM, copies('data', *_RECORDS), _RECORDS[1:],
           lambda folder: dataset.read_split(folder, 'train'), _possible_trajectories, list),
    Target('metadata.json', Promise.OPEN, copies('data', *_RECORDS), _RECORDS[:1], _read_metadata,
           _possible_metadata),
    Target('subspace.npz', Promise.CHECKSUM, copies('data', 'subspace.npz'), ('subspace.npz',),
           lambda folder: subspace.Subspace.load(f'{folder}/subspace.npz'), _possible_subspace),
    Target('edges.json', Promise.OPEN, _write_edges, ('edges.json',),
           lambda folder: edge_lists.read(f'{folder}/edges.json').mask, _possible_mask),
    Target('mask.npy', Promise.OPEN, _write_edges, ('mask.npy',),
           lambda folder: edge_lists.read_mask(f'{folder}/mask.npy'), _possible_mask),
    Target('rollout npz', Promise.CHECKSUM, _write_rollout, ('rollout_test_0.npz',),
           lambda folder: rollout_frames.load(f'{folder}/rollout_test_0.npz', None),
           _possible_rollout),
    Target('raw runs', Promise.SEALED, copies('raw'), ('run_00000.npz', 'run_00001.npz'),
           lambda folder: list(raw_runs.RawRuns(folder))),
    Target('raw manifest', Promise.OPEN, copies('raw'), ('manifest.json',),
           lambda folder: list(raw_runs.RawRuns(folder)), _possible_raw),
    Target("authors' pickles", Promise.OPEN, _write_pickle, ('pca_eigen_values.pkl',),
           lambda folder: legacy_pickles.read_array(f'{folder}/pca_eigen_values.pkl'),
           lambda array: isinstance(array, np.ndarray) and array.dtype.kind in 'fciu'),
    Target('Kipf .npy', Promise.OPEN, _write_kipf,
           tuple(f'{n}_train_springs3.npy' for n in ('loc', 'vel', 'edges')),
           lambda folder: nri_data.load(folder, 'train'), _possible_kipf),
    Target('checkpoints', Promise.OPEN, _write_checkpoints, ('ckpt-8.npz', 'ckpt-12.npz'),
           loop.newest, _possible_checkpoint),
    # MPM-NGF and VTP keep folders of files, the bench single ones.
    _import('deepmind', ('train.tfrecord', 'metadata.json')),
    _import('geoelements', ('train.npz', 'metadata.json')),
    _import('lagrangebench', ('train.h5', 'metadata.json')),
    _import('npz', ('train_0.npz',)),
    _packed(particles.ParticleSample, indices=np.arange(4, dtype=np.int32)),
    _packed(heights.Heights, corner=np.array([0.1, 0.1]), cell=np.array([0.01, 0.02])),
    Target('load_model', Promise.OPEN, copies('model', *_MODEL), _MODEL, _read_model,
           _possible_model),
    Target('saved terrain', Promise.CHECKSUM,
           lambda folder: Terrain(_rng().uniform(0.2, 0.3, (6, 5)), 0.02).save(
               f'{folder}/ground.npz'),
           ('ground.npz',), _read_terrain, _possible_terrain),
    Target('csv of fit-soil', Promise.OPEN, _write_table, ('dig.csv',), _read_digs,
           _possible_digs),
    Target('csv of poses', Promise.OPEN, _write_table, ('path.csv',),
           lambda folder: roll_out_path.read_poses(f'{folder}/path.csv'),
           lambda poses: poses.ndim == 2 and poses.dtype == np.float64 and poses.size),
    Target('tool of new-tool', Promise.OPEN, _write_tools, ('bucket.json', 'wheel.json'),
           lambda folder: [bodies.read_tool(f'{folder}/{n}.json') for n in ('bucket', 'wheel')],
           _possible_tools),
    Target('soil field', Promise.OPEN, _write_field, _MODEL, _read_field, _possible_field),
    Target('load_model of NRI', Promise.OPEN, _write_nri, _MODEL, _read_nri, _possible_nri),
)  # fmt: skip
