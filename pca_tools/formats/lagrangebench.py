"""LagrangeBench: `{train,valid,test}.h5` with groups 00000, 00001, ... and `metadata.json`.

Also read: geoelements' second HDF5 layout (`positions` in place of `position`). A `force.py` beside
the data, which LagrangeBench runs, is never run and never written.
"""

import os
from collections.abc import Iterator
from typing import Any

import numpy as np

from pca_tools import files
from pca_tools.formats import full_space
from pca_tools.formats.full_space import SOIL_TYPE, FullSpaceData, FullSpaceRun
from pca_tools.metadata import METADATA_NAME

TITLE = 'LagrangeBench (HDF5)'
# Theirs -> DeepMind's: fluid, solid wall, moving wall, rigid body; -1 is padding.
_TYPES = {0: SOIL_TYPE, 1: 3, 2: 3, 3: 0}
_PADDING = -1


def read(folder: str, dt: float | None = None) -> FullSpaceData:
    """Opens a folder; arguments as of all formats."""
    metadata, notes = full_space.Foreign(folder), []
    periodic = metadata.values.get('periodic_boundary_conditions') or []
    if not isinstance(periodic, list):
        raise ValueError(f'{metadata.path}: periodic_boundary_conditions is {periodic!r}, no list')
    if any(periodic):
        notes.append('its boundaries are periodic: particles that cross one seem to jump')
    if os.path.exists(os.path.join(folder, 'force.py')):
        notes.append('its force.py (an external force) was not run and is left out')
    # dt is the solver's; a frame is stored every `write_every` of its steps.
    of_frame = (metadata.number('dt') or 0.0) * (metadata.number('write_every') or 1.0)
    return metadata.data(TITLE, 'h5', _read_file, dt or of_frame or None, notes=notes)


def _read_file(path: str) -> Iterator[tuple[str, dict[str, Any]]]:
    import h5py

    files.refuse_git_lfs_pointer(path)
    try:
        with h5py.File(path, 'r') as file:
            for name in sorted(file):
                yield name, _arrays(file[name], f'{path}: {name}')
    except (OSError, RuntimeError, KeyError, TypeError) as error:  # h5py, of damaged files
        raise ValueError(f'{path}: is not a readable HDF5 file ({error})') from error


def _arrays(group, where: str) -> dict[str, Any]:
    """Returns a group as arguments of a `FullSpaceRun`."""
    import h5py

    key = next((k for k in ('position', 'positions') if _is_dataset(group, k, where)), None)
    if key is None or not _is_dataset(group, 'particle_type', where):
        held = sorted(group) if isinstance(group, h5py.Group) else type(group).__name__
        raise ValueError(f'{where}: holds {held}; position and particle_type were expected')
    stored, types = group[key], group['particle_type']
    if stored.dtype.kind not in 'fiu' or stored.nbytes + types.nbytes > files.MAX_BYTES:
        held = f'{stored.shape}, {stored.dtype}, {types.shape} types'
        raise ValueError(f'{where}: position has {held}')
    positions = stored[()]
    theirs = full_space.particle_types(types[()], positions, where)
    kept = theirs != _PADDING
    # Their converter from DeepMind's records does not map types: 5 and above are already ours.
    known = _TYPES | {kind: kind for kind in (5, 6, 7)}
    if unknown := sorted(set(theirs[kept].tolist()) - known.keys()):
        raise ValueError(f'{where}: has the unknown particle types {unknown}')
    mapped = np.array([known[kind] for kind in theirs[kept].tolist()], np.int64)
    return {'positions': positions[:, kept], 'particle_type': mapped}


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
    """Writes the data; ValueError for runs of different lengths in a split."""
    import h5py

    lengths, largest, splits = {}, 0, full_space.by_split(data)
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
        lengths[split] = full_space.length_of(counts), len(counts)
    train = next(iter(splits))
    held_out = next((split for split in ('test', 'valid') if split in splits), train)
    metadata = {
        'case': data.name,
        'solver': 'material point method',
        **full_space.common_metadata(data, splits[train]()),
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
