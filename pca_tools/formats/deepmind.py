"""DeepMind's learning_to_simulate: `{train,valid,test}.tfrecord` and `metadata.json`, full space.

One `SequenceExample` per trajectory; `sequence_length` counts the frames but the first.
"""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np

from pca_tools import files, tfrecord_io
from pca_tools.dataset import node_types, stack_frames
from pca_tools.formats.full_space import (
    Foreign,
    FullSpaceData,
    FullSpaceRun,
    by_split,
    check_run,
    common_metadata,
    length_of,
    split_files,
)
from pca_tools.metadata import METADATA_NAME

NAME = 'deepmind'
TITLE = "DeepMind's learning_to_simulate (TFRecord, full space)"


def read(folder: str, dt: float | None = None) -> FullSpaceData:
    """Opens a folder; arguments as of all formats."""
    metadata = Foreign(folder)
    dim = metadata.values.get('dim')
    if dim not in (2, 3):
        raise ValueError(f'{metadata.path}: dim is {dim!r}, 2 or 3 was expected')
    context = metadata.values.get('context_mean')
    count = len(context) if isinstance(context, list) else 0

    def runs() -> Iterator[FullSpaceRun]:
        for split, path in split_files(folder, 'tfrecord'):
            for index, record in enumerate(tfrecord_io.read_records(path)):
                yield _run_of(record, f'{split}_{index}', split, dim, f'{path}: record {index}')

    return metadata.described(
        f'{folder} ({TITLE})', runs, dt, up_axis=1 if dim == 2 else None,
        context_names=metadata.values.get('context_names')
        or [f'context_{index}' for index in range(count)],
    )  # fmt: skip


def _run_of(record, name: str, split: str, dim: int, where: str) -> FullSpaceRun:
    types = node_types(record, where)
    widths = {'position': len(types) * dim, 'force': None, 'step_context': None}
    frames = {
        key: stack_frames(record.frames[key], width, f'{where}: {key}')
        for key, width in widths.items()
        if key in record.frames
    }
    if 'position' not in frames:
        raise ValueError(f'{where}: holds no positions, only {sorted(record.frames)}')
    positions = frames['position'].reshape(-1, len(types), dim)
    run = FullSpaceRun(
        name, split, positions, types, frames.get('force'), frames.get('step_context')
    )
    return check_run(run, where)


def write(folder: str, data: FullSpaceData) -> None:
    """Writes the data; all runs must be equally long.

    Raises:
        ValueError: runs of different lengths, which DeepMind's reader cannot take.
    """
    splits, lengths = by_split(data), []
    for split, runs in splits.items():
        path = os.path.join(folder, f'{split}.tfrecord')
        tfrecord_io.write_records(path, _records(runs(), lengths))
    train = splits['train'] if 'train' in splits else next(iter(splits.values()))
    metadata = {'sequence_length': length_of(lengths) - 1, **common_metadata(data, train())}
    # Means and deviations of these switch them on.
    for key, attribute in (('rigid_body_force', 'force'), ('context', 'context')):
        rows = [getattr(run, attribute) for run in train()]
        if all(values is not None for values in rows):
            stacked = np.concatenate(rows).astype(np.float64)
            metadata[f'{key}_mean'] = stacked.mean(axis=0).tolist()
            metadata[f'{key}_std'] = stacked.std(axis=0).tolist()
    if 'context_mean' in metadata:
        metadata['context_names'] = list(data.context_names)
    files.write_json(os.path.join(folder, METADATA_NAME), metadata)


def _records(runs: Iterator[FullSpaceRun], lengths: list[int]):
    for index, run in enumerate(runs):
        lengths.append(len(run.positions))
        series = {'position': run.positions, 'step_context': run.context, 'force': run.force}
        frames = {
            key: [row.tobytes() for row in np.ascontiguousarray(values, '<f4')]
            for key, values in series.items()
            if values is not None
        }
        types = np.ascontiguousarray(run.particle_type, '<i8').tobytes()
        yield tfrecord_io.SequenceRecord(index, types, frames)
