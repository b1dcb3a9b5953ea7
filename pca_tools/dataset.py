"""Dataset folders: `{train,valid,test}.tfrecord` and `metadata.json`.

One record is one run (formats of DeepMind's learning_to_simulate and of Subspace-Graph-Physics): R
rigid particles first, then r modes of the soil subspace, each mode a node whose three coordinates
are its x, y, z scores.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from pca_tools import files, tfrecord_io
from pca_tools.metadata import DIM, METADATA_NAME, SPLITS, read_metadata

__all__ = [
    'KINEMATIC_PARTICLE_ID', 'MODE_PARTICLE_ID', 'RIGID_PARTICLE_ID', 'SPLITS', 'Trajectory',
    'read_metadata', 'read_split', 'split_path', 'trajectory_problems', 'write_split',
]  # fmt: skip

RIGID_PARTICLE_ID = 0
KINEMATIC_PARTICLE_ID = 3
MODE_PARTICLE_ID = 6
NUM_PARTICLE_TYPES = 9
# Feature lists beside `position` -> values per frame; None: as many as the metadata says. Readers
# of the published formats ignore those that they do not know (torque, rigid_pose).
FRAME_SERIES = {
    'step_context': None, 'force': DIM, 'torque': DIM, 'rigid_pose': 7,
    'body_force': None, 'body_pose': None,
}  # fmt: skip
# Values of each body in one frame.
_OF_BODIES = {'body_force': DIM, 'body_pose': 7}


@dataclasses.dataclass(frozen=True, eq=False)
class Trajectory:
    """One run in the subspace: T frames of V = R + r nodes.

    Attributes:
        key: number of the run in its file (0 in all records of the authors).
        particle_type: int64 [V]; 3 rigid and prescribed, 0 rigid and predicted, 6 mode.
        position: float32 [T, V, 3]; metres for rigid particles, scores (metres) for modes.
        force: float32 [T, 3] on the rigid body in newtons, or None.
        step_context: float32 [T, C], or None.
        torque: float32 [T, 3] on the rigid body about the position of `rigid_pose`, newton metres,
            or None.
        rigid_pose: float32 [T, 7], position (metres) and unit quaternion (w, x, y, z), or None.
        body_force: float32 [T, B, 3] on each of several bodies, newtons, or None.
        body_pose: float32 [T, B, 7] of each of several bodies, as `rigid_pose`, or None.
    """

    key: int
    particle_type: np.ndarray
    position: np.ndarray
    force: np.ndarray | None = None
    step_context: np.ndarray | None = None
    torque: np.ndarray | None = None
    rigid_pose: np.ndarray | None = None
    body_force: np.ndarray | None = None
    body_pose: np.ndarray | None = None

    @property
    def n_rigid(self) -> int:
        """R, counted in this record and not taken from the metadata."""
        return int(np.count_nonzero(self.particle_type != MODE_PARTICLE_ID))

    @property
    def n_modes(self) -> int:
        """r, counted in this record."""
        return len(self.particle_type) - self.n_rigid

    @property
    def n_frames(self) -> int:
        """T, all stored frames."""
        return self.position.shape[0]


def split_path(folder: str, split: str) -> str:
    """Returns the path of a split's record file.

    Raises:
        ValueError: `split` is not one of train, valid, test.
    """
    if split not in SPLITS:
        raise ValueError(f'split {split!r} is not one of {SPLITS}')
    return os.path.join(folder, f'{split}.tfrecord')


def read_split(folder: str, split: str) -> list[Trajectory]:
    """Reads all runs of a split and checks each against the metadata and the manifest.

    Args:
        folder: dataset folder, ours or the authors' (which have neither manifest nor scene).
        split: train, valid or test.

    Returns:
        The runs, in file order.

    Raises:
        FileNotFoundError: the folder, its metadata or the split is missing.
        ValueError: a file is damaged, foreign, a git-lfs pointer or not the one in the manifest, or
            a record does not fit the metadata or holds NaN; the message names file, record and
            frame and says what to do.
    """
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
    if entries is not None:
        expected = entries[os.path.basename(path)].get('records')
        if expected is not None and expected != len(trajectories):
            raise ValueError(
                f'{path}: has {len(trajectories)} records, the manifest says {expected}'
            )
    for index, trajectory in enumerate(trajectories):
        problems = trajectory_problems(trajectory, metadata)
        if problems:
            raise ValueError(f'{path}: record {index}: ' + '; '.join(problems))
    return trajectories


def _identity(path: str) -> tuple[int, int, int]:
    """Which file a path leads to now."""
    status = os.stat(path)
    return status.st_dev, status.st_ino, status.st_size


def read_records_as_trajectories(path: str) -> list[Trajectory]:
    """Reads the runs of one record file without holding them against any metadata.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: see `tfrecord_io.read_records`; also buffers whose sizes do not fit each other.
    """
    return [
        _trajectory_from_record(record, f'{path}: record {index}')
        for index, record in enumerate(tfrecord_io.read_records(path))
    ]


def _trajectory_from_record(record: tfrecord_io.SequenceRecord, where: str) -> Trajectory:
    if len(record.particle_type) % 8 or not record.particle_type:
        raise ValueError(
            f'{where}: particle_type has {len(record.particle_type)} bytes, a positive multiple '
            'of 8 (int64) was expected'
        )
    particle_type = np.frombuffer(record.particle_type, '<i8').astype(np.int64)
    position = _stack_frames(
        record.frames['position'], len(particle_type) * DIM, f'{where}: position'
    )
    series = {
        name: _stack_frames(record.frames[name], width, f'{where}: {name}')
        for name, width in FRAME_SERIES.items()
        if name in record.frames
    }
    for name, width in _OF_BODIES.items():
        if name in series:
            if series[name].shape[1] % width:
                raise ValueError(f'{where}: {name} has {series[name].shape[1]} values a frame')
            series[name] = series[name].reshape(len(series[name]), -1, width)
    return Trajectory(record.key, particle_type, position.reshape(len(position), -1, DIM), **series)


def _stack_frames(frames: list[bytes], values: int | None, where: str) -> np.ndarray:
    """Stacks per-frame float32 buffers to [T, values]; None takes the size of the first frame."""
    if not frames:
        raise ValueError(f'{where}: has no frames')
    expected = len(frames[0]) if values is None else 4 * values
    if expected % 4 or not expected:
        raise ValueError(f'{where}: frame 0 has {expected} bytes, not a whole number of float32')
    for index, frame in enumerate(frames):
        if len(frame) != expected:
            raise ValueError(
                f'{where}: frame {index} has {len(frame)} bytes, {expected} were expected '
                f'({expected // 4} float32); the node count of the record and its buffers disagree'
            )
    return np.frombuffer(b''.join(frames), '<f4').astype(np.float32).reshape(len(frames), -1)


def trajectory_problems(trajectory: Trajectory, metadata: dict[str, Any]) -> list[str]:
    """Returns what is wrong with a run under a dataset's metadata, one sentence each.

    The rigid count is taken from the record: `particles_rigid` of the authors' metadata (15) is
    wrong for half of their runs (20), which is a finding of `pca_tools.inspect` and no reason not
    to read them.
    """
    problems = []
    types, n_modes = trajectory.particle_type, metadata['mode_number']
    if trajectory.n_modes != n_modes or not np.all(types[-n_modes:] == MODE_PARTICLE_ID):
        problems.append(
            f'has {trajectory.n_modes} mode nodes (type {MODE_PARTICLE_ID}) among {len(types)}, '
            f'mode_number says the last {n_modes}'
        )
    elif not np.all(np.isin(types[:-n_modes], (RIGID_PARTICLE_ID, KINEMATIC_PARTICLE_ID))):
        problems.append(
            f'has node types {sorted(set(types.tolist()))}; rigid nodes must be '
            f'{RIGID_PARTICLE_ID} or {KINEMATIC_PARTICLE_ID}'
        )
    frames, differ = metadata['sequence_length'] + 1, 'frames_of_runs' in metadata
    if trajectory.n_frames > frames or (trajectory.n_frames < frames and not differ):
        problems.append(
            f'has {trajectory.n_frames} frames, sequence_length + 1 = {frames} were expected'
        )
    for name, values, statistics in (
        ('force', trajectory.force, metadata.get('rigid_body_force_mean')),
        ('step_context', trajectory.step_context, metadata.get('context_mean')),
    ):
        if (values is None) != (statistics is None):
            key = 'rigid_body_force_mean' if name == 'force' else 'context_mean'
            present, absent = (f'the record has {name}', f'metadata lacks {key}')
            if values is None:
                present, absent = (f'metadata has {key}', f'the record lacks {name}')
            problems.append(f'{present} but {absent}')
        elif values is not None:
            if values.shape[1] != len(statistics):
                problems.append(
                    f'{name} has {values.shape[1]} values, the metadata {len(statistics)}'
                )
            if len(values) != trajectory.n_frames:
                problems.append(f'{name} has {len(values)} frames, position {trajectory.n_frames}')
            problems += _non_finite_problems(values, name)
    for name in ('torque', 'rigid_pose', 'body_force', 'body_pose'):
        values = getattr(trajectory, name)
        if values is None:
            continue
        width = FRAME_SERIES[name] or _OF_BODIES[name]
        if len(values) != trajectory.n_frames or values.shape[-1] != width:
            problems.append(f'{name} has shape {values.shape} for {trajectory.n_frames} frames')
        problems += _non_finite_problems(values, name)
    return problems + _non_finite_problems(trajectory.position, 'position')


def _non_finite_problems(values: np.ndarray, name: str) -> list[str]:
    bad = np.argwhere(~np.isfinite(values))
    if not len(bad):
        return []
    first = ', '.join(
        f'{axis} {index}'
        for axis, index in zip(('frame', 'node', 'axis')[: values.ndim - 1], bad[0])
    )
    return [f'{name} holds {len(bad)} NaN or infinite values, the first at {first}']


def write_split(path: str, trajectories: Sequence[Trajectory]) -> int:
    """Writes runs as a TFRecord file, whole or not at all.

    Args:
        path: `<folder>/<split>.tfrecord`.
        trajectories: the runs, in file order.

    Returns:
        The number of records.

    Raises:
        ValueError: shapes that do not fit each other, or NaN.
        OSError: the file could not be written.
    """
    return tfrecord_io.write_records(path, list(_records_of(path, trajectories)))


def _records_of(
    path: str, trajectories: Iterable[Trajectory]
) -> Iterable[tfrecord_io.SequenceRecord]:
    for index, trajectory in enumerate(trajectories):
        where = f'{path}: record {index}'
        nodes = len(trajectory.particle_type)
        if trajectory.position.ndim != 3 or trajectory.position.shape[1:] != (nodes, DIM):
            raise ValueError(
                f'{where}: position has shape {trajectory.position.shape}, [T, {nodes}, {DIM}] '
                'was expected'
            )
        frames = {}
        for name, width in {'position': None, **FRAME_SERIES}.items():
            values = getattr(trajectory, name)
            if values is None:
                continue
            if len(values) != trajectory.n_frames or (width and values.shape[1:] != (width,)):
                raise ValueError(
                    f'{where}: {name} has shape {values.shape} for {trajectory.n_frames} frames '
                    f'of {width or DIM} values'
                )
            problems = _non_finite_problems(values, name)
            if problems:
                raise ValueError(f'{where}: {problems[0]}')
            frames[name] = [frame.tobytes() for frame in np.ascontiguousarray(values, '<f4')]
        types = np.ascontiguousarray(trajectory.particle_type, '<i8').tobytes()
        yield tfrecord_io.SequenceRecord(int(trajectory.key), types, frames)
