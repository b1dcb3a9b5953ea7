"""Plain `.npz`: one file per run with `positions` [T, N, D] and whatever else a raw run may have.

`particle_type` [N] tells soil from body where both lie in `positions`; else `rigid_positions` is
the body.
"""

import json
import math
import os
from typing import Any

import numpy as np

from pca_tools import files
from pca_tools.formats import full_space
from pca_tools.formats.full_space import SOIL_TYPE, FullSpaceData, FullSpaceRun
from pca_tools.metadata import SPLITS, union_of_bounds

TITLE = 'plain npz, one file per run'
# What all files share, as far as they state it.
_SHARED = ('dt', 'bounds', 'up_axis', 'rigid_motion')


def run_files(folder: str) -> list[str]:
    return sorted(name for name in os.listdir(folder) if name.endswith('.npz'))


def read(folder: str, dt: float | None = None) -> FullSpaceData:
    """Opens a folder; `dt` is needed where the files have none. ValueError: they state different dt
    (and none is given), upward axes or motions of the body, or bounds that are none."""
    paths = [os.path.join(folder, name) for name in run_files(folder)]
    stated: dict[str, dict[str, Any]] = {key: {} for key in _SHARED}  # key -> path -> value
    for path in paths:
        arrays = files.read_npz(path, only=_SHARED)
        dt_held = arrays.get('dt', np.empty(0))
        is_dt = dt_held.size == 1 and dt_held.dtype.kind in 'fiu' and np.isfinite(dt_held).all()
        found = {
            'dt': float(dt_held.reshape(())) if is_dt else None,
            'bounds': full_space.bounds_of(
                {key: arrays[key].tolist() for key in arrays if key == 'bounds'}, path
            ),
            'up_axis': _up_axis_of(arrays.get('up_axis'), path),
            'rigid_motion': str(arrays['rigid_motion']) if 'rigid_motion' in arrays else None,
        }
        for key, value in found.items():
            if value is not None:
                stated[key][path] = value
    bounds = list(stated['bounds'].values())
    if len({len(one) for one in bounds}) > 1:
        raise ValueError(f'{folder}: its files have bounds of two and of three axes')
    context = np.atleast_1d(files.read_npz(paths[0], only=['context']).get('context', []))
    return FullSpaceData(
        source=f'{folder} ({TITLE})',
        runs=lambda: map(_run_of, paths),
        dt=dt or _only('dt', stated),
        bounds=union_of_bounds(bounds) if bounds else None,
        context_names=[f'context_{index}' for index in range(context.shape[-1])],
        rigid_motion=_only('rigid_motion', stated),
        up_axis=_only('up_axis', stated),
    )


def _up_axis_of(held: np.ndarray | None, path: str) -> int | None:
    if held is None:
        return None
    if held.size != 1 or held.dtype.kind not in 'iu':
        raise ValueError(f'{path}: up_axis is {held.tolist()!r}, 0, 1 or 2 was expected')
    return int(held.reshape(()))


def _only(key: str, stated: dict[str, dict[str, Any]]) -> Any:
    """Returns what the files that state it agree on, None where none does."""
    held = stated[key]
    first = next(iter(held), None)
    for path, value in held.items():
        same = value == held[first]
        if key == 'dt':  # of time stamps, or of another kind of number
            same = math.isclose(value, held[first], rel_tol=1e-6)
        if not same:
            raise ValueError(
                f'{first} has {key} {held[first]}, {os.path.basename(path)} {value}: runs of one '
                'folder share it' + ('; give --dt if only the files say it wrong' * (key == 'dt'))
            )
    return held.get(first)


def _run_of(path: str) -> FullSpaceRun:
    arrays = files.read_npz(path)
    if 'positions' not in arrays:
        held = {key: value.shape for key, value in arrays.items()}
        raise ValueError(f'{path}: holds {held}; positions [T, N, D] was expected')
    soil, body = arrays['positions'], arrays.get('rigid_positions', np.empty(0))
    types = arrays.get('particle_type', np.int64(SOIL_TYPE))
    types = full_space.particle_types(types, soil, path)
    if body.size:
        if body.ndim != 3 or len(body) != len(soil) or body.shape[2] != soil.shape[2]:
            raise ValueError(f'{path}: rigid_positions have shape {body.shape} beside {soil.shape}')
        soil = np.concatenate([body, soil], axis=1)
        types = np.concatenate([np.full(body.shape[1], 3), types])
    context, split = arrays.get('context'), str(arrays.get('split', ''))
    if context is not None and context.ndim < 2:
        context = np.tile(np.atleast_1d(context), (len(soil), 1))
    name, split = os.path.basename(path).removesuffix('.npz'), split if split in SPLITS else ''
    run = FullSpaceRun(name, split, soil, types, arrays.get('force'), context)
    return full_space.check_run(run, path)


def write(folder: str, data: FullSpaceData) -> None:
    """Writes one file per run, soil and body in `positions` with their types."""
    for run in data.runs():
        arrays = {
            'positions': np.asarray(run.positions, np.float32),
            'particle_type': run.particle_type,
            'split': run.split,
            'dt': np.float64(np.nan if data.dt is None else data.dt),
            'force': run.force,
            'context': run.context,
            'bounds': data.bounds,
            'up_axis': data.up_axis,
            'rigid_motion': data.rigid_motion,
            'parameters': json.dumps({'source': data.source}),
        }
        held = {key: value for key, value in arrays.items() if value is not None}
        files.write_npz(os.path.join(folder, f'{run.name}.npz'), **held)
