"""Writes raw runs of any origin, and lets a manifest follow files that were changed on purpose."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from pca_tools import files, heights, raw_runs
from pca_tools.metadata import AXES
from pca_tools.raw_runs import SERIES

_RUN_KEYS = (*SERIES, 'case', 'context', 'parameters', 'split', 'kind')
# Bounds that are not given: the hull of soil and body, wider by this share of its size.
_MARGIN = 0.05
_FILE_NAME = 'run_{:05d}.npz'


def write_raw(
    folder: str,
    runs: Iterable[Mapping[str, Any]],
    dt: float,
    *,
    up_axis: int | str,
    body: str | None = None,
    bounds: Sequence[Sequence[float]] | None = None,
    rigid_edges: Sequence[Sequence[int]] = (),
    name: str = 'own_data',
    gravity: Sequence[float] | None = None,
    bodies: Sequence[Mapping[str, Any]] | None = None,
    check_units: bool = True,
) -> None:
    """Writes runs as a folder that `lts convert --raw_path=FOLDER` takes.

    Args:
        folder: absent or empty; it is there whole or not at all.
        runs: one mapping per run, taken one at a time (a generator will do). `positions`
            [T, N, D] is needed; the rest is optional, but the same in all runs:
            `rigid_positions` [T, R, D] points fixed to the body, `force` [T, D] and `torque`
            [T, 3] on it, its `pose` [T, 7] (position, quaternion w x y z), `context` (name ->
            number), `step_context` [T, C] where that changes in time, `case` (id; default its
            index), `split` (train, valid or test), `kind`, and `parameters` (anything JSON can
            hold). `heights` [T, nx, nz] of the soil's surface are coordinates along the upward
            axis; the `parameters` then say where the map lies: `heights_corner_m` [x, z] and
            `heights_cell_m` [dx, dz], the same in all runs. Metres, newtons; D = 2 or 3, a third
            coordinate of 0 is added to 2. T and R may differ from run to run, N may not: particle i
            is the same particle in all runs.
        dt: seconds from frame to frame.
        up_axis: axis against gravity, 0, 1, 2 or 'x', 'y', 'z'.
        body: what is known of the body's motion beforehand: 'prescribed' (all), 'driven' (rotation
            and travel, the height is predicted), 'predicted' (nothing), or 'none' (no body).
            Default: 'prescribed' where there are `rigid_positions`, else 'none'.
        bounds: [low, high] of every axis, which no particle leaves; default the hull of all soil
            and bodies with a margin.
        rigid_edges: pairs of rigid points that hold the body's shape, for bodies whose motion is
            not prescribed.
        name: of the scene.
        gravity: vector, m/s^2; only recorded.
        bodies: of several bodies, in the order of their points: `name`, `rigid_motion` and `points`
            (how many of R) of each. `rigid_edges` join points of one body; runs may then have
            `body_force` [T, B, 3] and `body_pose` [T, B, 7], and `force` is the sum. Runs with a
            free body may have `target` and `external` [T, 3] and `subframe_force` [T, 4, 3].
        check_units: refuse positions and dt that are implausible in metres and seconds.

    Raises:
        ValueError: all faults of all runs, before the folder exists.
    """
    runs = iter(runs)
    first = next(runs, None)
    if first is None:
        raise ValueError(f'{folder}: no runs were given')
    if os.path.isdir(folder) and os.listdir(folder):
        raise ValueError(f'{folder}: is not empty; name another folder')
    scene: dict[str, Any] = {
        'name': name,
        'rigid_motion': body or ('prescribed' if 'rigid_positions' in first else 'none'),
        'rigid_edges': [[int(a), int(b)] for a, b in rigid_edges],
        'context_names': list(first.get('context') or {}),
        'force': 'force' in first,
        'up_axis': AXES.index(up_axis) if up_axis in AXES else up_axis,
    }
    if bodies is not None:
        scene['bodies'] = [dict(body) for body in bodies]
    if gravity is not None:
        scene['gravity'] = [float(value) for value in gravity]
    if np.ndim(first.get('positions')) == 3 and np.shape(first['positions'])[2] == 2:
        scene['dim'] = 2
    manifest = {
        'scene': scene,
        'dt': dt,
        'bounds': [[0.0, 1.0]] * 3 if bounds is None else [list(map(float, b)) for b in bounds],
        'runs': [dict.fromkeys(raw_runs.ENTRY_KEYS, '')],
    }
    raw_runs.raise_faults(folder, raw_runs.manifest_faults(manifest))

    def fill(temporary: str) -> None:
        every = itertools.chain([first], runs)
        _write_runs(temporary, every, manifest, bounds is None, check_units)
        files.write_json(os.path.join(temporary, files.MANIFEST_NAME), manifest)

    files.write_folder_atomically(folder, fill, replace=False)


def _write_runs(folder, runs, manifest, find_bounds, check_units) -> None:
    """Writes all runs, and their entries (and bounds, where none are given) into the manifest."""
    scene, dt = manifest['scene'], manifest['dt']
    extent, entries, faults, corners, first = raw_runs.Extent(), [], [], [], None
    for index, run in enumerate(runs):
        arrays, problems = _arrays_of(index, run, scene)
        problems = problems or raw_runs.array_faults(arrays, scene)
        if not problems:
            terrain, n_soil = arrays.get('heights'), arrays['positions'].shape[1]
            grid = heights.grid_of(json.loads(str(arrays['parameters'])), terrain)
            first = first or (n_soil, grid)
            problems = heights.grid_faults(grid, first[1], 'the runs before it')
            if n_soil != first[0]:
                problems += [f'has {n_soil} particles, the runs before it {first[0]}']
        if problems:
            faults += [f'run {index}: {problem}' for problem in problems]
            continue
        soil = arrays['positions']
        body = arrays.get('rigid_positions', np.empty((len(soil), 0, 3), np.float32))
        extent.add(soil, body, dt, heights.reach(terrain, grid))
        points = np.concatenate([soil, body], axis=1)
        corners += [points.min(axis=(0, 1)), points.max(axis=(0, 1))]
        if not faults:  # after the first fault the rest is only looked at
            name = _FILE_NAME.format(index)
            files.write_npz(os.path.join(folder, name), **arrays)
            entries.append(_entry(folder, {'file': name}, str(arrays['parameters'])))
    faults += raw_runs.repeated_cases([entry['case'] for entry in entries])
    if corners and find_bounds:
        low, high = np.float64(np.min(corners, axis=0)), np.float64(np.max(corners, axis=0))
        margin = _MARGIN * max(float(np.max(high - low)), 1e-9)
        manifest['bounds'] = np.stack([low - margin, high + margin], axis=1).tolist()
    if corners and check_units:
        faults += raw_runs.unit_faults(extent, manifest['bounds'], dt)
    raw_runs.raise_faults('write_raw', faults)
    manifest['runs'] = entries


def _arrays_of(
    index: int, run: Mapping[str, Any], scene: dict[str, Any]
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Returns the arrays to write of one run, and what is wrong with its keys."""
    unknown = sorted(set(run) - set(_RUN_KEYS))
    if unknown:
        return {}, [f'has the unknown keys {unknown}; known are {list(_RUN_KEYS)}']
    faults, arrays = [], {}
    for name in SERIES:
        if run.get(name) is None:
            continue
        values = np.asarray(run[name])
        if values.dtype.kind not in 'fiu':
            faults.append(f'{name} is of type {values.dtype}, numbers were expected')
            continue
        is_plane = scene.get('dim') == 2 and values.ndim and values.shape[-1] == 2
        if is_plane and name != 'heights':
            values = np.concatenate([values, np.zeros((*values.shape[:-1], 1))], axis=-1)
        arrays[name] = np.asarray(values, np.float32)
    context = run.get('context') or {}
    if sorted(context) != sorted(scene['context_names']):
        faults.append(f'context has {sorted(context)}, run 0 {sorted(scene["context_names"])}')
    if ('force' in arrays) != scene['force']:
        faults.append(f'{"has" if "force" in arrays else "lacks"} force, unlike run 0')
    parameters = {**(run.get('parameters') or {}), 'case': run.get('case', index)}
    parameters['context'] = {key: float(value) for key, value in context.items()}
    parameters |= {key: run[key] for key in ('split', 'kind') if run.get(key) is not None}
    if not raw_runs.is_case(parameters['case']):
        faults.append(f'case is {parameters["case"]!r}, a whole number or a text was expected')
    try:
        arrays['parameters'] = np.array(json.dumps(parameters, allow_nan=False))
    except (TypeError, ValueError) as error:
        faults.append(f'parameters cannot be written as JSON: {error}')
    return arrays, faults


def _entry(folder: str, listed: dict[str, Any], parameters: str) -> dict[str, Any]:
    """Returns what the manifest says of a run; what was listed of it stays."""
    held = json.loads(parameters)
    case = listed.get('case', held.get('case', os.path.splitext(listed['file'])[0]))
    path = os.path.join(folder, os.path.basename(listed['file']))
    return {**listed, 'case': case, **files.fingerprint(path), 'parameters': held}


def rehash(folder: str) -> list[str]:
    """Lets the manifest of a raw folder follow its files; files are read, never changed.

    Bytes, sha256 and parameters of every listed run become those of its file; a case id that is
    missing becomes that of the parameters, else the name of the file. The manifest may list runs by
    `file` alone.

    Returns:
        names of the files whose entries changed.

    Raises:
        FileNotFoundError: there is no manifest.
        ValueError: all faults of the manifest and of the files; nothing was changed.
    """
    path = os.path.join(folder, files.MANIFEST_NAME)
    manifest = files.read_json(path)
    runs = manifest.get('runs') if isinstance(manifest, dict) else None
    if not isinstance(runs, list) or not all(
        isinstance(entry, dict) and isinstance(entry.get('file'), str) for entry in runs
    ):
        raise ValueError(f'{path}: "runs" must list at least the "file" of every run')
    stand_ins = [{'bytes': 0, 'sha256': '', 'case': i, **entry} for i, entry in enumerate(runs)]
    raw_runs.raise_faults(path, raw_runs.manifest_faults({**manifest, 'runs': stand_ins}))
    entries, faults = [], []
    for entry in runs:
        file = os.path.join(folder, os.path.basename(entry['file']))
        try:
            arrays = files.read_npz(file)
            raw_runs.raise_faults(file, raw_runs.array_faults(arrays, manifest['scene']))
            entries.append(_entry(folder, entry, str(arrays['parameters'])))
        except (ValueError, OSError) as error:
            faults.append(str(error))
    manifest = {**manifest, 'runs': entries}
    raw_runs.raise_faults(path, faults or raw_runs.manifest_faults(manifest))
    files.write_json(path, manifest)
    return [new['file'] for old, new in zip(runs, entries) if old != new]
