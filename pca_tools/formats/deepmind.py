"""DeepMind's learning_to_simulate: `{train,valid,test}.tfrecord` and `metadata.json`, full space.

One `SequenceExample` per trajectory; `sequence_length` counts the frames but the first.
"""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np

from pca_tools import files, tfrecord_io
from pca_tools.formats.full_space import (
    FullSpaceData,
    FullSpaceRun,
    ReadOptions,
    bounds_of,
    check_run,
    motion_moments,
    number_of,
    read_foreign_json,
)
from pca_tools.metadata import METADATA_NAME, SPLITS

NAME = 'deepmind'
TITLE = "DeepMind's learning_to_simulate (TFRecord, full space)"


def read(folder: str, options: ReadOptions) -> FullSpaceData:
    """Opens a folder; arguments as of all formats."""
    path = os.path.join(folder, METADATA_NAME)
    metadata = read_foreign_json(path)
    dim = metadata.get('dim')
    if dim not in (2, 3):
        raise ValueError(f'{path}: dim is {dim!r}, 2 or 3 was expected')
    context = metadata.get('context_mean')
    n_context = len(context) if isinstance(context, list) else 0

    def runs() -> Iterator[FullSpaceRun]:
        for split in SPLITS:
            file = os.path.join(folder, f'{split}.tfrecord')
            if not os.path.exists(file):
                continue
            for index, record in enumerate(tfrecord_io.read_records(file)):
                yield _run_of(record, f'{split}_{index}', split, dim, f'{file}: record {index}')

    return FullSpaceData(
        source=f'{folder} ({TITLE})',
        runs=runs,
        dt=options.dt or number_of(metadata, 'dt', path),
        bounds=bounds_of(metadata, path),
        up_axis=1 if dim == 2 else None,
        context_names=metadata.get('context_names')
        or [f'context_{index}' for index in range(n_context)],
        radius=number_of(metadata, 'default_connectivity_radius', path),
    )


def _run_of(record, name: str, split: str, dim: int, where: str) -> FullSpaceRun:
    if len(record.particle_type) % 8:
        raise ValueError(f'{where}: particle_type is no row of int64')
    types = np.frombuffer(record.particle_type, '<i8').astype(np.int64)
    frames = {
        key: _stacked(values, f'{where}: {key}')
        for key, values in record.frames.items()
        if key in ('position', 'force', 'step_context')
    }
    positions = frames['position']
    if positions.shape[1] != len(types) * dim:
        raise ValueError(
            f'{where}: {positions.shape[1]} coordinates a frame, {len(types)} particles of {dim} '
            'were expected'
        )
    run = FullSpaceRun(
        name, split, positions.reshape(len(positions), len(types), dim), types,
        force=frames.get('force'), context=frames.get('step_context'),
    )  # fmt: skip
    return check_run(run, where)


def _stacked(values: list[bytes], where: str) -> np.ndarray:
    if not values or len({len(value) for value in values}) != 1 or len(values[0]) % 4:
        raise ValueError(f'{where}: has frames of {sorted({len(v) for v in values})} bytes')
    return np.frombuffer(b''.join(values), '<f4').astype(np.float32).reshape(len(values), -1)


def write(folder: str, data: FullSpaceData) -> None:
    """Writes the data; all runs must be equally long.

    Raises:
        ValueError: runs of different lengths, which DeepMind's reader cannot take.
    """
    written: dict[str, list[int]] = {}
    for split in SPLITS:
        if not any(run.split == split for run in data.runs()):
            continue
        lengths: list[int] = []
        path = os.path.join(folder, f'{split}.tfrecord')
        tfrecord_io.write_records(path, _records(data, split, lengths))
        written[split] = lengths
    every = {length for lengths in written.values() for length in lengths}
    if len(every) != 1:
        raise ValueError(f'runs have {sorted(every)} frames, this format holds runs of one length')
    train = 'train' if 'train' in written else next(iter(written))
    first = next(data.runs())
    metadata = {
        'bounds': data.bounds,
        'sequence_length': every.pop() - 1,
        'default_connectivity_radius': data.radius or 0.025,
        'dim': first.positions.shape[2],
        'dt': data.dt,
        **motion_moments(run for run in data.runs() if run.split == train),
        **_series_moments(data, train),
    }
    files.write_json(os.path.join(folder, METADATA_NAME), metadata)


def _records(data: FullSpaceData, split: str, lengths: list[int]):
    for index, run in enumerate(run for run in data.runs() if run.split == split):
        lengths.append(len(run.positions))
        frames = {}
        for key, values in (
            ('position', run.positions), ('step_context', run.context), ('force', run.force),
        ):  # fmt: skip
            if values is not None:
                rows = np.ascontiguousarray(values, '<f4').reshape(len(values), -1)
                frames[key] = [row.tobytes() for row in rows]
        types = np.ascontiguousarray(run.particle_type, '<i8').tobytes()
        yield tfrecord_io.SequenceRecord(index, types, frames)


def _series_moments(data: FullSpaceData, split: str) -> dict[str, list]:
    """Mean and deviation of force and context, under the names that switch them on."""
    moments: dict[str, list] = {}
    for key, attribute in (('rigid_body_force', 'force'), ('context', 'context')):
        rows = [getattr(run, attribute) for run in data.runs() if run.split == split]
        if rows and all(values is not None for values in rows):
            stacked = np.concatenate(rows).astype(np.float64)
            moments[f'{key}_mean'] = stacked.mean(axis=0).tolist()
            moments[f'{key}_std'] = stacked.std(axis=0).tolist()
    if 'context_mean' in moments:
        moments['context_names'] = list(data.context_names)
    return moments
