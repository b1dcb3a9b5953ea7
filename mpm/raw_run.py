"""Raw runs on disk: one `.npz` per run and a manifest that says which are complete.

Files appear whole or not at all: they are written under a temporary name in the same folder
and renamed. The manifest is rewritten after every run; a run that it does not list, or whose file
has another size than it says, does not count as done.
"""

import dataclasses
import hashlib
import itertools
import json
import os
from typing import TYPE_CHECKING

import numpy as np

from mpm import scenes
from pca_tools import raw_runs
from pca_tools.files import MANIFEST_NAME, fingerprint, read_json, read_npz, write_json, write_npz

if TYPE_CHECKING:
    from mpm.run import RawRun


def file_name(case: int | str) -> str:
    return f'run_{case:03d}.npz' if isinstance(case, int) else f'run_{case}.npz'


def write_run(folder: str, run: 'RawRun') -> dict:
    """Writes a run into a folder; returns its entry of the manifest."""
    case = run.parameters['case']
    path = os.path.join(folder, file_name(case))
    write_npz(path, **arrays_of(run), parameters=np.array(json.dumps(run.parameters)))
    return {
        'file': file_name(case),
        'case': case,
        **fingerprint(path),
        'content': content_digest(run),
        'parameters': run.parameters,
    }


def arrays_of(run: 'RawRun') -> dict[str, np.ndarray]:
    """Returns the arrays of a run by name, those that it has."""
    arrays = {field.name: getattr(run, field.name) for field in dataclasses.fields(run)}
    del arrays['parameters']
    return {name: array for name, array in arrays.items() if array is not None}


def content_digest(run: 'RawRun') -> str:
    """Returns the sha256 of what a run holds, in hexadecimal: same seed, same digest.

    It covers names, shapes, bytes (little-endian) and parameters, not the compression of the file
    nor the time that the run took on its machine.
    """
    found = hashlib.sha256()
    for name, array in arrays_of(run).items():
        found.update(f'{name} {array.shape} '.encode())
        found.update(np.ascontiguousarray(array, dtype='<f4').tobytes())
    kept = {name: value for name, value in run.parameters.items() if name != 'solver_cpu_s'}
    found.update(json.dumps(kept, sort_keys=True).encode())
    return found.hexdigest()


def read_run(path: str) -> 'RawRun':
    """Reads one run of this solver (`pca_tools.raw_runs` reads those of any origin); ValueError: it
    is none."""
    from mpm.run import RawRun  # help does not wait for Numba

    arrays = read_npz(path)
    try:
        return RawRun(parameters=json.loads(str(arrays.pop('parameters'))), **arrays)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f'{path} is not a raw run: {error!r}') from error


def write_manifest(folder: str, scene: scenes.Scene, runs: list[dict]) -> None:
    """Writes the manifest of a folder of raw runs, sorted by file name."""
    content = {
        'scene': scenes.describe(scene),
        'dt': 1.0 / scenes.FRAME_RATE,
        'bounds': [list(axis) for axis in scene.bin.bounds],
        'runs': sorted(runs, key=lambda run: run['file']),
    }
    write_json(os.path.join(folder, MANIFEST_NAME), content)


def read_manifest(folder: str) -> dict | None:
    """Returns the manifest of a folder, None if it has none; ValueError: it is not one."""
    path = os.path.join(folder, MANIFEST_NAME)
    if not os.path.exists(path):
        return None
    manifest = read_json(path)
    raw_runs.raise_faults(path, raw_runs.manifest_faults(manifest))
    return manifest


def finished_runs(folder: str, scene: scenes.Scene, settings: dict) -> list[dict]:
    """Returns the manifest entries of the runs that are complete on disk; ValueError if the folder
    holds another scene, or runs whose parameters differ from `settings`, which all share."""
    manifest = read_manifest(folder)
    if manifest is None:
        return []
    if manifest['scene']['name'] != scene.name:
        raise ValueError(
            f'{folder} holds runs of the scene {manifest["scene"]["name"]!r}, not {scene.name!r}; '
            'name another folder'
        )
    for entry, (name, value) in itertools.product(manifest['runs'], settings.items()):
        if (made := entry.get('parameters', {}).get(name)) != value:
            raise ValueError(
                f'{folder}: {entry["file"]} was made with {name} = {made!r}, not {value!r}; name '
                'another folder'
            )

    def is_whole(entry):
        path = os.path.join(folder, entry['file'])
        return os.path.exists(path) and os.path.getsize(path) == entry['bytes']

    return [entry for entry in manifest['runs'] if is_whole(entry)]
