"""Raw runs on disk: one `.npz` per run and a manifest that says which are complete.

Files appear whole or not at all: they are written under a temporary name in the same folder
and renamed. The manifest is rewritten after every run; a run that it does not list, or whose file
has other bytes than it says, does not count as done.
"""

import hashlib
import json
import os

import numpy as np

from mpm import scenes
from mpm.run import RawRun
from pca_tools.files import read_npz, write_json, write_npz

MANIFEST = 'manifest.json'
# Arrays of a run beside its parameters, and their shapes behind [T] (None: any length).
_ARRAYS = {
    'positions': (None, 3), 'rigid_positions': (None, 3), 'force': (3,), 'torque': (3,),
    'pose': (7,), 'step_context': (None,), 'target': (3,), 'external': (3,),
    'subframe_force': (None, 3), 'heights': (None, None),
}  # fmt: skip
_REQUIRED = ('positions', 'rigid_positions', 'force', 'torque', 'pose')
# What a run cost depends on the machine and is left out of the digest of its content.
_COSTS = ('solver_cpu_s',)


def file_name(case: int | str) -> str:
    """Returns the name of the file of a run."""
    return f'run_{case:03d}.npz' if isinstance(case, int) else f'run_{case}.npz'


def write_run(folder: str, run: RawRun) -> dict:
    """Writes one run and returns its entry of the manifest."""
    case = run.parameters['case']
    path = os.path.join(folder, file_name(case))
    write_npz(path, **arrays_of(run), parameters=np.array(json.dumps(run.parameters)))
    return {
        'file': file_name(case),
        'case': case,
        'bytes': os.path.getsize(path),
        'sha256': digest(path),
        'content': content_digest(run),
        'parameters': run.parameters,
    }


def arrays_of(run: RawRun) -> dict[str, np.ndarray]:
    """Returns the arrays of a run by name, those that it has."""
    arrays = {name: getattr(run, name) for name in _ARRAYS}
    return {name: array for name, array in arrays.items() if array is not None}


def content_digest(run: RawRun) -> str:
    """Returns the sha256 of what a run holds, in hexadecimal: same seed, same digest.

    It covers names, shapes, bytes (little-endian) and parameters, not the compression of the file
    nor the time that the run took.
    """
    found = hashlib.sha256()
    for name, array in arrays_of(run).items():
        found.update(f'{name} {array.shape} '.encode())
        found.update(np.ascontiguousarray(array, dtype='<f4').tobytes())
    kept = {name: value for name, value in run.parameters.items() if name not in _COSTS}
    found.update(json.dumps(kept, sort_keys=True).encode())
    return found.hexdigest()


def read_run(path: str) -> RawRun:
    """Reads one run.

    Raises:
        ValueError: if the file is not a raw run.
    """
    try:
        arrays = read_npz(path)
        run = RawRun(
            **{name: arrays[name] if name in _REQUIRED else arrays.get(name) for name in _ARRAYS},
            parameters=json.loads(str(arrays['parameters'])),
        )
        for name, values in arrays_of(run).items():
            fits = values.ndim == 1 + len(_ARRAYS[name]) and all(
                length in (None, found) for length, found in zip(_ARRAYS[name], values.shape[1:])
            )
            if values.dtype.kind != 'f' or not fits or len(values) != len(run.positions):
                raise ValueError(f'{name} is {values.dtype} {values.shape}')
            if not np.isfinite(values).all():
                raise ValueError(f'{name} is not finite')
        if not isinstance(run.parameters, dict):
            raise ValueError('parameters is no JSON object')
    except (KeyError, TypeError, OSError, ValueError, RecursionError) as error:
        raise ValueError(f'{path} is not a raw run: {error}') from error
    return run


def digest(path: str) -> str:
    """Returns the sha256 of a file, in hexadecimal."""
    with open(path, 'rb') as file:
        return hashlib.file_digest(file, 'sha256').hexdigest()


def write_manifest(folder: str, scene: scenes.Scene, runs: list[dict]) -> None:
    """Writes the manifest of a folder of raw runs, sorted by file name."""
    content = {
        'scene': scenes.describe(scene),
        'dt': 1.0 / scenes.FRAME_RATE,
        'bounds': [list(axis) for axis in scene.bin.bounds],
        'runs': sorted(runs, key=lambda run: run['file']),
    }
    write_json(os.path.join(folder, MANIFEST), content)


def read_manifest(folder: str) -> dict | None:
    """Returns the manifest of a folder, or None if it has none.

    Raises:
        ValueError: if the manifest is not readable as one.
    """
    path = os.path.join(folder, MANIFEST)
    if not os.path.exists(path):
        return None
    try:
        with open(path, encoding='utf-8') as file:
            manifest = json.load(file)
        manifest['scene']['name'], manifest['dt'], manifest['bounds']
        for entry in manifest['runs']:
            if os.path.basename(entry['file']) != entry['file']:
                raise ValueError(f'{entry["file"]!r} points out of the folder')
            entry['bytes'] + 0, entry['sha256'] + '', entry['parameters'].keys()
            if not isinstance(entry['case'], (int, str)):
                raise ValueError(f'case {entry["case"]!r} is neither a number nor a text')
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f'{path} is not a manifest of raw runs: {error!r}') from error
    return manifest


def finished_runs(folder: str, scene: scenes.Scene, settings: dict) -> list[dict]:
    """Returns the manifest entries of the runs that are complete on disk.

    Args:
        folder: of raw runs; may be empty.
        scene: that the folder must belong to.
        settings: parameters that every run of the folder must share.

    Raises:
        ValueError: if the folder holds another scene, or runs with other settings.
    """
    manifest = read_manifest(folder)
    if manifest is None:
        return []
    if manifest['scene']['name'] != scene.name:
        raise ValueError(
            f'{folder} holds runs of the scene {manifest["scene"]["name"]!r}, not {scene.name!r}; '
            'name another folder'
        )
    finished = []
    for entry in manifest['runs']:
        for name, value in settings.items():
            made = entry['parameters'].get(name)
            if made != value:
                raise ValueError(
                    f'{folder}: {entry["file"]} was made with {name} = {made!r}, not '
                    f'{value!r}; name another folder'
                )
        path = os.path.join(folder, entry['file'])
        if os.path.exists(path) and os.path.getsize(path) == entry['bytes']:
            finished.append(entry)
    return finished
