"""DeepMind's learning_to_simulate: `{train,valid,test}.tfrecord` and `metadata.json`, full space.

One `SequenceExample` per trajectory; `sequence_length` counts the frames but the first.
"""

import os
from collections.abc import Iterator
from typing import Any

from pca_tools import files, tfrecord_io
from pca_tools.formats import full_space
from pca_tools.formats.full_space import FullSpaceData, FullSpaceRun
from pca_tools.metadata import METADATA_NAME

TITLE = "DeepMind's learning_to_simulate (TFRecord, full space)"
# Their feature list -> our attribute.
_SERIES = {'position': 'positions', 'force': 'force', 'step_context': 'context'}


def read(folder: str, dt: float | None = None) -> FullSpaceData:
    """Opens a folder; arguments as of all formats."""
    metadata = full_space.Foreign(folder)
    dim = metadata.values.get('dim')
    if dim not in (2, 3):
        raise ValueError(f'{metadata.path}: dim is {dim!r}, 2 or 3 was expected')
    context = metadata.values.get('context_mean')
    count = len(context) if isinstance(context, list) else 0
    names = metadata.values.get('context_names') or [f'context_{index}' for index in range(count)]

    def read_file(path: str) -> Iterator[tuple[Any, dict[str, Any]]]:
        for index, record in enumerate(tfrecord_io.read_records(path)):
            where = f'{path}: record {index}'
            types = record.node_types(where)
            if 'position' not in record.frames:
                raise ValueError(f'{where}: holds no positions, only {sorted(record.frames)}')
            arrays = {
                ours: record.series(key, where)
                for key, ours in _SERIES.items()
                if key in record.frames
            }
            shape = len(types), dim
            arrays['positions'] = tfrecord_io.shaped(arrays['positions'], shape, where)
            yield index, arrays | {'particle_type': types}

    return metadata.data(
        TITLE, 'tfrecord', read_file, dt, up_axis=1 if dim == 2 else None, context_names=names
    )


def write(folder: str, data: FullSpaceData) -> None:
    """Writes the data; ValueError for runs of different lengths, which DeepMind's reader cannot
    take."""
    splits, lengths = full_space.by_split(data), []

    def records(runs: Iterator[FullSpaceRun]) -> Iterator[tfrecord_io.SequenceRecord]:
        for index, run in enumerate(runs):
            lengths.append(len(run.positions))
            series = {key: getattr(run, ours) for key, ours in _SERIES.items()}
            yield tfrecord_io.SequenceRecord.of(index, run.particle_type, series)

    for split, runs in splits.items():
        tfrecord_io.write_records(os.path.join(folder, f'{split}.tfrecord'), records(runs()))
    train = splits['train'] if 'train' in splits else next(iter(splits.values()))
    # Means and deviations of force and context switch them on.
    common = full_space.common_metadata(data, train(), ('rigid_body_force', 'context'))
    metadata = {'sequence_length': full_space.length_of(lengths) - 1, **common}
    if 'context_mean' in metadata:
        metadata['context_names'] = list(data.context_names)
    files.write_json(os.path.join(folder, METADATA_NAME), metadata)
