"""LagrangeBench: `{train,valid,test}.h5` with groups 00000, 00001, ... and `metadata.json`.

Also read: geoelements' second HDF5 layout (`positions` in place of `position`). A `force.py` beside
the data, which LagrangeBench runs, is never run and never written.
"""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np

from pca_tools import files
from pca_tools.formats.full_space import (
    SOIL_TYPE,
    Foreign,
    FullSpaceData,
    FullSpaceRun,
    by_split,
    check_run,
    common_metadata,
    length_of,
    split_files,
    type_column,
)
from pca_tools.metadata import METADATA_NAME

NAME = 'lagrangebench'
TITLE = 'LagrangeBench (HDF5)'
# Theirs -> DeepMind's: fluid, solid wall, moving wall, rigid body; -1 is padding.
_TYPES = {0: SOIL_TYPE, 1: 3, 2: 3, 3: 0}
_PADDING = -1


def read(folder: str, dt: float | None = None) -> FullSpaceData:
    """Opens a folder; arguments as of all formats."""
    metadata, notes = Foreign(folder), []
    periodic = metadata.values.get('periodic_boundary_conditions') or []
    if not isinstance(periodic, list):
        raise ValueError(
            f'{metadata.path}: periodic_boundary_conditions is {periodic!r}, a list was expected'
        )
    if any(periodic):
        notes.append(
            'its boundaries are periodic, which these models do not know: particles that cross one '
            'seem to jump'
        )
    if os.path.exists(os.path.join(folder, 'force.py')):
        notes.append('its force.py (an external force) was not run and is left out')

    def runs() -> Iterator[FullSpaceRun]:
        for split, path in split_files(folder, 'h5'):
            yield from _runs_of(path, split)

    # dt is the solver's; a frame is stored every so many of its steps.
    of_frame = (metadata.number('dt') or 0.0) * (metadata.number('write_every') or 1.0)
    return metadata.described(f'{folder} ({TITLE})', runs, dt or of_frame or None, notes=notes)


def _runs_of(path: str, split: str) -> Iterator[FullSpaceRun]:
    import h5py

    files.refuse_git_lfs_pointer(path)
    try:
        with h5py.File(path, 'r') as file:
            for name in sorted(file):
                yield _run_of(file[name], f'{split}_{name}', split, f'{path}: {name}')
    except (OSError, RuntimeError, KeyError, TypeError) as error:  # h5py, of damaged files
        raise ValueError(f'{path}: is not a readable HDF5 file ({error})') from error


def _run_of(group, name: str, split: str, where: str) -> FullSpaceRun:
    import h5py

    key = next((k for k in ('position', 'positions') if _is_dataset(group, k, where)), None)
    if key is None or not _is_dataset(group, 'particle_type', where):
        held = sorted(group) if isinstance(group, h5py.Group) else type(group).__name__
        raise ValueError(f'{where}: holds {held}; position and particle_type were expected')
    stored = group[key]
    if stored.dtype.kind not in 'fiu' or stored.size * stored.dtype.itemsize > files.MAX_BYTES:
        raise ValueError(f'{where}: position has {stored.shape}, {stored.dtype}')
    positions = stored[()]
    types = group['particle_type']
    if types.size not in (1, positions.shape[1] if positions.ndim > 1 else 0):
        raise ValueError(f'{where}: {types.shape} types for positions of {positions.shape}')
    theirs = type_column(types[()], positions.shape[1], where)
    kept = theirs != _PADDING
    # Their converter from DeepMind's records does not map types: 5 and above are already ours.
    unknown = sorted(set(theirs[kept].tolist()) - _TYPES.keys() - {5, 6, 7})
    if unknown:
        raise ValueError(f'{where}: has the unknown particle types {unknown}')
    mapped = np.array([_TYPES.get(kind, kind) for kind in theirs[kept].tolist()], np.int64)
    material = None
    if _is_dataset(group, 'material_property', where):
        material = np.broadcast_to(group['material_property'][()], (len(mapped),))
    run = FullSpaceRun(name, split, positions[:, kept], mapped, material=material)
    return check_run(run, where)


def _is_dataset(group, key: str, where: str) -> bool:
    import h5py

    # Of this file only: a link to another one would be followed.
    if not isinstance(group, h5py.Group) or not isinstance(
        group.get(key, getlink=True), (h5py.HardLink, h5py.SoftLink)
    ):
        return False
    if not isinstance(group.get(key), h5py.Dataset) or group[key].external:
        return False
    try:
        _ = group[key].dtype
    except ValueError as error:
        raise ValueError(f'{where}: {key} holds numbers that numpy has not ({error})') from error
    return True


def write(folder: str, data: FullSpaceData) -> None:
    """Writes the data; the runs of a split must be equally long.

    Raises:
        ValueError: runs of different lengths in a split.
    """
    import h5py

    lengths, largest, splits = {}, 0, by_split(data)
    for split, runs in splits.items():
        counts = []
        with h5py.File(os.path.join(folder, f'{split}.h5'), 'w') as file:
            for index, run in enumerate(runs()):
                counts.append(len(run.positions))
                largest = max(largest, run.positions.shape[1])
                group = file.create_group(f'{index:05d}')
                positions = np.asarray(run.positions, np.float32)
                group.create_dataset('position', data=positions, compression='gzip')
                group.create_dataset('particle_type', data=_theirs(run))
        lengths[split] = length_of(counts), len(counts)
    train = next(iter(splits))
    held_out = next((split for split in ('test', 'valid') if split in splits), train)
    metadata = {
        'case': os.path.basename(folder),
        'solver': 'material point method',
        **common_metadata(data, splits[train]()),
        't_end': None if data.dt is None else data.dt * (lengths[train][0] - 1),
        'sequence_length_train': lengths[train][0],
        'num_trajs_train': lengths[train][1],
        'sequence_length_test': lengths[held_out][0],
        'num_trajs_test': lengths[held_out][1],
        'num_particles_max': largest,
        'description': f'exported from {data.source}',
    }
    metadata['dx'] = metadata['default_connectivity_radius']
    metadata['periodic_boundary_conditions'] = [False] * metadata['dim']
    files.write_json(os.path.join(folder, METADATA_NAME), metadata)


def _theirs(run: FullSpaceRun) -> np.ndarray:
    """Returns LagrangeBench's types: a boundary that never moves is a solid wall."""
    kinematic = run.particle_type == 3
    walls = run.positions[:, kinematic]
    wall_type = 1 if kinematic.any() and not np.any(walls != walls[0]) else 2
    types = np.zeros(len(run.particle_type), np.int32)
    types[kinematic] = wall_type
    types[run.particle_type == 0] = 3
    return types
