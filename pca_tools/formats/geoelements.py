"""geoelements/gns: `{train,valid,test}.npz` of object arrays and `metadata.json`.

Two layouts are read: one entry per trajectory, or the single key `gns_data`; the second is written.
A trajectory is (positions [T, N, D], particle type [N] or one number[, material property]); the
last is not kept. Object arrays are pickles, which `pca_tools.legacy_pickles` reads and never runs.
"""

import os
from collections.abc import Iterator
from typing import Any

import numpy as np

from pca_tools import files, legacy_pickles
from pca_tools.formats import full_space
from pca_tools.formats.full_space import FullSpaceData
from pca_tools.metadata import METADATA_NAME

TITLE = 'geoelements/gns (npz)'
KEY = 'gns_data'


def read(folder: str, dt: float | None = None) -> FullSpaceData:
    """Opens a folder; arguments as of all formats."""
    metadata = full_space.Foreign(folder)
    # Newer metadata nest everything under the use it is for.
    nested = [metadata.values.get(section) for section in ('train', 'rollout')]
    nested = [held for held in nested if isinstance(held, dict) and 'bounds' in held]
    metadata.values = [*nested, metadata.values][0]
    up_axis = 1 if metadata.values.get('dim') == 2 else None
    return metadata.data(TITLE, 'npz', _read_file, dt, up_axis=up_axis)


def _read_file(path: str) -> Iterator[tuple[Any, dict[str, Any]]]:
    for index, item in enumerate(read_trajectories(path)):
        where = f'{path}: trajectory {index}'
        if not isinstance(item, (list, tuple)) or len(item) not in (2, 3):
            raise ValueError(f'{where}: is no (positions, types[, material property])')
        positions = np.asarray(item[0])
        types = full_space.particle_types(item[1], positions, where)
        yield index, {'positions': positions, 'particle_type': types}


def read_trajectories(path: str) -> list[Any]:
    """Returns the trajectories of a file, each a tuple or list; ValueError if it is damaged, too
    large, or holds anything but numpy arrays."""
    held = {}
    with files.opened_npz(path) as members:
        for name, file, _ in members:
            shape, _, dtype = files.read_npy_header(file)
            if not dtype.hasobject:
                expected = 'object arrays (positions, types), or all of them in gns_data'
                raise ValueError(f'{name} is {dtype}, {shape}; expected are {expected}')
            held[name] = legacy_pickles.parse_objects(file.read(files.MAX_BYTES), name)
    return held[KEY] if KEY in held else list(held.values())


def write(folder: str, data: FullSpaceData) -> None:
    """Writes the data in the layout `gns_data`; runs of different lengths are theirs to take."""
    lengths, splits = set(), full_space.by_split(data)
    for split, runs in splits.items():
        trajectories = [
            (np.asarray(run.positions, np.float32), run.particle_type.astype(np.int64))
            for run in runs()
        ]
        lengths |= {len(positions) for positions, _ in trajectories}
        held = np.empty(len(trajectories), dtype=object)
        held[:] = trajectories
        with open(os.path.join(folder, f'{split}.npz'), 'wb') as file:
            np.savez_compressed(file, **{KEY: held})
    metadata = full_space.common_metadata(data, splits['train']() if 'train' in splits else ())
    metadata |= {'boundary_augment': 1.0, 'material_feature_len': 0}
    metadata = {key: value for key, value in metadata.items() if value is not None}
    # All frames, unlike DeepMind's; null: as long as each trajectory is.
    metadata['sequence_length'] = lengths.pop() if len(lengths) == 1 else None
    files.write_json(os.path.join(folder, METADATA_NAME), metadata)
