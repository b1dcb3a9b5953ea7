"""Dataset folders: `{train,valid,test}.tfrecord` and `metadata.json`.

One record is one run (formats of DeepMind's learning_to_simulate and of Subspace-Graph-Physics): R
rigid particles first, then r modes of the soil subspace, each mode a node whose three coordinates
are its x, y, z scores.

Records are written in one of two forms. Plain ones have one buffer a frame, and DeepMind's reader
takes them. Packed ones take a fifth of the bytes (`pca_tools.compression`): scores to within half a
micrometre, particles of a rigid body as their places on the body, which its pose moves, and
everything else bit for bit. Both are read alike.
"""

import dataclasses
import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from pca_tools import compression, files, rigid_fit, tfrecord_io
from pca_tools.metadata import DIM, METADATA_NAME, SPLITS, non_finite, read_metadata

RIGID_PARTICLE_ID = 0
KINEMATIC_PARTICLE_ID = 3
MODE_PARTICLE_ID = 6
# Scores are packed to within half of it, m; float32 resolves 2.4e-7 of scores near 3 m.
SCORE_RESOLUTION = 1e-6
# Largest distance (m) of a rigid particle from where the pose puts it for it to be left out.
POSE_TOLERANCE = 2e-6


def rigid_type(rigid_motion: str) -> int:
    """The type of a rigid particle whose body has a motion of `metadata.RIGID_MOTIONS`."""
    return KINEMATIC_PARTICLE_ID if rigid_motion == 'prescribed' else RIGID_PARTICLE_ID


def _series(*shape: int | None) -> Any:
    return dataclasses.field(default=None, metadata={'shape': shape})


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class FrameSeries:
    """What a run may have beside positions, each or None: float32 [T, shape], where None in a shape
    is as many as the scene has."""

    step_context: np.ndarray | None = _series(None)  # global context
    force: np.ndarray | None = _series(DIM)  # on the rigid body, N; of several bodies their sum
    torque: np.ndarray | None = _series(DIM)  # on the body about the position of its pose, N m
    rigid_pose: np.ndarray | None = _series(7)  # position (m) and unit quaternion (w, x, y, z)
    body_force: np.ndarray | None = _series(None, DIM)  # on each of several bodies, N
    body_pose: np.ndarray | None = _series(None, 7)  # of each of several bodies
    # Place (m) along and up and angle (rad) that the actuators of a free body pull towards.
    target: np.ndarray | None = _series(DIM)
    # Force (N, N, N m) on these beside soil and actuators, at the end of each frame.
    external: np.ndarray | None = _series(DIM)
    subframe_force: np.ndarray | None = _series(4, DIM)  # on a free body in the quarters, N


# Name -> shape of a frame. Readers of the published formats ignore those that they do not know.
FRAME_SERIES = {field.name: field.metadata['shape'] for field in dataclasses.fields(FrameSeries)}


@dataclasses.dataclass(frozen=True, eq=False)
class Trajectory(FrameSeries):
    """One run in the subspace: T frames of V = R + r nodes."""

    key: int  # number of the run in its file (0 in all records of the authors)
    particle_type: np.ndarray  # int64 [V]; 3 rigid and prescribed, 0 rigid and predicted, 6 mode
    position: np.ndarray  # float32 [T, V, 3]; metres for rigid particles, scores (metres) for modes

    @property
    def n_rigid(self) -> int:
        """R of this record."""
        return int(np.count_nonzero(self.particle_type != MODE_PARTICLE_ID))

    @property
    def n_modes(self) -> int:
        """r of this record."""
        return len(self.particle_type) - self.n_rigid

    @property
    def n_frames(self) -> int:
        """T."""
        return self.position.shape[0]


def split_path(folder: str, split: str) -> str:
    if split not in SPLITS:
        raise ValueError(f'split {split!r} is not one of {SPLITS}')
    return os.path.join(folder, f'{split}.tfrecord')


def read_split(folder: str, split: str) -> list[Trajectory]:
    """Returns all runs of a split, in file order, each checked against metadata and manifest. The
    folder may be ours, or one of Subspace-Graph-Physics (without manifest and scene).

    FileNotFoundError: the folder, its metadata or the split is missing. ValueError, with file,
    record, frame and remedy: a file is damaged, foreign, a git-lfs pointer or not the one in the
    manifest, or a record does not fit the metadata or holds NaN."""
    metadata = read_metadata(folder)
    path = split_path(folder, split)
    if not os.path.exists(path):
        present = [name for name in SPLITS if os.path.exists(split_path(folder, name))]
        raise FileNotFoundError(f'{path}: no such file; splits in this folder: {present or "none"}')
    before = _identity(path)
    entries = files.check_manifest(folder, [METADATA_NAME, os.path.basename(path)])
    trajectories = read_records_as_trajectories(path)
    if _identity(path) != before:
        raise ValueError(f'{path}: the file was replaced while it was read; read it again')
    entry = (entries or {}).get(os.path.basename(path), {})
    if (expected := entry.get('records', len(trajectories))) != len(trajectories):
        raise ValueError(f'{path}: has {len(trajectories)} records, the manifest says {expected}')
    for index, trajectory in enumerate(trajectories):
        if problems := trajectory_problems(trajectory, metadata):
            raise ValueError(f'{path}: record {index}: ' + '; '.join(problems))
    return trajectories


def _identity(path: str) -> tuple[int, int, int]:
    status = os.stat(path)
    return status.st_dev, status.st_ino, status.st_size


def read_records_as_trajectories(path: str) -> list[Trajectory]:
    """Reads the runs of one record file without holding them against any metadata; raises as
    `tfrecord_io.read_records`, and ValueError for buffers whose sizes do not fit each other."""
    return [
        _trajectory_from_record(record, f'{path}: record {index}')
        for index, record in enumerate(tfrecord_io.read_records(path))
    ]


def _trajectory_from_record(record: tfrecord_io.SequenceRecord, where: str) -> Trajectory:
    particle_type = record.node_types(where)
    shapes = {'position': (len(particle_type), DIM), **FRAME_SERIES}
    if record.packed:
        try:
            series = _unpacked(record.packed, particle_type)
        except ValueError as error:
            raise ValueError(f'{where}: {error}') from error
    else:
        series = {name: record.series(name, where) for name in shapes if name in record.frames}
    for name, values in series.items():
        series[name] = tfrecord_io.shaped(values, shapes[name], f'{where}: {name}')
    return Trajectory(record.key, particle_type, **series)


def _unpacked(packed: dict[str, bytes], particle_type: np.ndarray) -> dict[str, np.ndarray]:
    """Returns name -> [T, values] of a packed record."""
    series = {
        name: compression.unpack_series(packed[name]) for name in FRAME_SERIES if name in packed
    }
    if 'scores' not in packed:
        raise ValueError(f'holds no scores of modes, only {sorted(packed)}')
    parts = [compression.unpack_positions(packed['scores'])]
    if 'rigid_shape' in packed:
        shape = compression.unpack_series(packed['rigid_shape']).reshape(-1, DIM)
        pose = series.get('rigid_pose', np.empty((0, 0)))
        if pose.shape[1] != 7:
            raise ValueError('holds the shape of a body but no pose of it')
        parts.insert(0, rigid_fit.placed(shape, pose).astype(np.float32))
    elif 'rigid_position' in packed:
        values = compression.unpack_series(packed['rigid_position'])
        parts.insert(0, values.reshape(len(values), -1, DIM))
    counts = [part.shape[:2] for part in parts]
    if len({frames for frames, _ in counts}) > 1 or sum(n for _, n in counts) != len(particle_type):
        raise ValueError(f'its (frames, nodes) {counts} do not fit {len(particle_type)} node types')
    position = np.concatenate(parts, axis=1)
    return {**series, 'position': position.reshape(len(position), -1)}


def _packed(trajectory: Trajectory) -> dict[str, bytes]:
    """Returns the series of a record, packed; the inverse of `_unpacked`."""
    rigid, scores = np.split(trajectory.position, [trajectory.n_rigid], axis=1)
    packed = {'scores': compression.pack_positions(scores, SCORE_RESOLUTION)}
    if rigid.size:
        name, values, pose = 'rigid_position', rigid, trajectory.rigid_pose
        if pose is not None:  # which may put its particles where they are in every frame
            shape = rigid_fit.on_body(rigid[0], pose[0]).astype(np.float32)
            if np.abs(rigid_fit.placed(shape, pose) - rigid).max() < POSE_TOLERANCE:
                name, values = 'rigid_shape', shape[None]
        packed[name] = compression.pack_series(values)
    for name in FRAME_SERIES:
        values = getattr(trajectory, name)
        if values is not None:
            packed[name] = compression.pack_series(values)
    return packed


def trajectory_problems(trajectory: Trajectory, metadata: dict[str, Any]) -> list[str]:
    """Returns what is wrong with a run under a dataset's metadata, one sentence each.

    The rigid count is the record's: `particles_rigid` of the authors' metadata (15) is wrong for
    half of their runs (20), of which `pca_tools.inspect` tells.
    """
    problems = []
    types, n_modes = trajectory.particle_type, metadata['mode_number']
    if trajectory.n_modes != n_modes or not np.all(types[-n_modes:] == MODE_PARTICLE_ID):
        found = f'has {trajectory.n_modes} mode nodes (type {MODE_PARTICLE_ID}) among {len(types)}'
        problems.append(f'{found}, mode_number says the last {n_modes}')
    elif not np.all(np.isin(types[:-n_modes], (RIGID_PARTICLE_ID, KINEMATIC_PARTICLE_ID))):
        wanted = f'rigid nodes must be {RIGID_PARTICLE_ID} or {KINEMATIC_PARTICLE_ID}'
        problems.append(f'has node types {sorted(set(types.tolist()))}; {wanted}')
    frames, differ = metadata['sequence_length'] + 1, 'frames_of_runs' in metadata
    if trajectory.n_frames > frames or (trajectory.n_frames < frames and not differ):
        problems.append(f'has {trajectory.n_frames} frames, sequence_length + 1 = {frames}')
    for name, key in (('force', 'rigid_body_force_mean'), ('step_context', 'context_mean')):
        values = getattr(trajectory, name)
        if values is None and key in metadata:
            problems.append(f'metadata has {key} but the record lacks {name}')
        elif values is not None and key not in metadata:
            problems.append(f'the record has {name} but metadata lacks {key}')
        elif values is not None and values.shape[-1] != len(metadata[key]):
            held = len(metadata[key])
            problems.append(f'{name} has {values.shape[-1]} values, the metadata {held}')
    shapes = {'position': (len(types), DIM), **FRAME_SERIES}
    faults = (
        series_fault(values, name, trajectory.n_frames, shape)
        for name, shape in shapes.items()
        if (values := getattr(trajectory, name)) is not None
    )
    return problems + list(filter(None, faults))


def series_fault(values: np.ndarray, name: str, n_frames: int, of_frame: tuple) -> str:
    """Says what is wrong with a series of `n_frames` frames of a shape, where None is any number;
    empty if nothing is."""
    expected = (n_frames, *of_frame)
    fits = values.ndim == len(expected) and all(
        wanted in (None, size) for wanted, size in zip(expected, values.shape)
    )
    if not fits or not values.size or values.dtype.kind not in 'fiu':
        sizes = ' x '.join('any' if size is None else str(size) for size in of_frame)
        shape = f'{values.shape}, {values.dtype}'
        return f'{name} has shape {shape} for {n_frames} frames of {sizes} values'
    fault = non_finite(values, 'frame', *('point', 'axis')[1 - values.ndim :])
    return f'{name} holds {fault}' if fault else ''


def write_split(path: str, trajectories: Sequence[Trajectory], packed: bool = False) -> int:
    """Writes runs as a TFRecord file, packed or plain (see above), whole or not at all; returns
    their number. OSError: it cannot be written."""
    records = []
    for run in trajectories:
        series = {name: getattr(run, name) for name in ('position', *FRAME_SERIES)}
        record = tfrecord_io.SequenceRecord.of(run.key, run.particle_type, {} if packed else series)
        records.append(dataclasses.replace(record, packed=_packed(run) if packed else {}))
    return tfrecord_io.write_records(path, records)
