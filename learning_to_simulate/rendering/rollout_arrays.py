"""The arrays of a rollout file, checked: positions and forces of the prediction, and of the truth
where the run was recorded."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from learning_to_simulate.scene import Scene
from pca_tools import files
from pca_tools.metadata import metadata_problems

DIM = 3
TRUTH, PREDICTION = 'truth', 'prediction'
TEXTS = ('metadata', 'scene', 'status', 'status_reason', 'model_digest')
REQUIRED = ('initial_positions', 'predicted_rollout', 'particle_types')
TRUE_POSITIONS, TRUE_FORCES = 'ground_truth_rollout', ('initial_forces', 'ground_truth_forces')


def read(path: str):
    """Reads a rollout file.

    Returns:
        Its arrays by name; its metadata, or what a drawing needs of them; {truth, prediction} ->
        float64 [T, V, 3] positions; {truth, prediction} -> float64 [T, 3] forces, or None. Of a
        path that nobody recorded there is no truth in the last two.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: not a rollout, or arrays that do not fit or are not finite in the truth.
    """
    arrays = files.read_npz(path)
    for name, array in arrays.items():
        if name not in TEXTS and array.dtype.kind not in 'fiu':
            raise ValueError(f'{path}: {name} holds {array.dtype}, no real numbers')
    return arrays, _metadata(path, arrays), *_joined(path, arrays)


def _metadata(path: str, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    wanted = (*REQUIRED, 'scene' if 'scene' in arrays else 'metadata')
    missing = [key for key in wanted if key not in arrays]
    if missing:
        raise ValueError(f'{path}: is not a rollout, it lacks {missing}; it has {sorted(arrays)}')
    try:
        stated = json.loads(str(arrays[wanted[-1]]))
    except (ValueError, RecursionError) as error:
        raise ValueError(f'{path}: its {wanted[-1]} is not JSON: {error}') from error
    if wanted[-1] == 'scene':
        return _metadata_of_scene(path, stated)
    problems = metadata_problems(stated)
    if problems:
        raise ValueError(f'{path}: its metadata: ' + '; '.join(problems))
    return stated


def _metadata_of_scene(path: str, stated: Any) -> dict[str, Any]:
    """What a drawing needs of the metadata, from the scene of a path that nobody recorded."""
    try:
        scene = Scene.from_json(stated)
        good = scene.dt > 0 and scene.n_modes > 0
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ValueError(f'{path}: its scene is none ({error})') from error
    if not good:
        raise ValueError(f'{path}: its scene has dt {scene.dt!r} and {scene.n_modes!r} modes')
    return {
        'dt': scene.dt,
        'mode_number': scene.n_modes,
        'n_soil': scene.n_soil,
        'scene': {'name': scene.name, 'up_axis': scene.up_axis},
    }


def _joined(path: str, arrays: dict[str, np.ndarray]):
    """Returns {truth, prediction} -> [T, V, 3], and {truth, prediction} -> forces [T, 3] or None;
    without the truth where there is none."""
    positions = {PREDICTION: 'predicted_rollout', TRUTH: TRUE_POSITIONS}
    given = np.asarray(arrays['initial_positions'], np.float64)
    later = {w: np.asarray(arrays[k], np.float64) for w, k in positions.items() if k in arrays}
    count, n_frames = len(arrays['particle_types']), len(arrays['predicted_rollout'])
    if given.shape[1:] != (count, DIM) or any(
        values.shape != (n_frames, count, DIM) for values in later.values()
    ):
        shapes = {positions[which]: values.shape for which, values in later.items()}
        raise ValueError(
            f'{path}: shapes do not fit: {count} particle types, initial_positions {given.shape}, '
            + ', '.join(f'{name} {shape}' for name, shape in shapes.items())
        )
    if not all(np.isfinite(x).all() for x in (given, *(later[w] for w in later if w == TRUTH))):
        raise ValueError(f'{path}: the ground truth has NaN or infinite values')
    nodes = {which: np.concatenate([given, values]) for which, values in later.items()}
    return nodes, _forces(path, arrays, len(given), n_frames, TRUTH in later)


def _forces(path, arrays, n_given, n_frames, has_truth):
    """{truth, prediction} -> forces [T, 3], or None; of a path, zero in the given frames."""
    wanted = {'predicted_forces': n_frames}
    wanted |= dict(zip(TRUE_FORCES, (n_given, n_frames))) if has_truth else {}
    if not any(key in arrays for key in wanted):
        return None
    missing = [key for key in wanted if key not in arrays]
    if missing:
        raise ValueError(f'{path}: has forces but lacks {missing}')
    for key, length in wanted.items():
        if arrays[key].shape != (length, DIM):
            raise ValueError(
                f'{path}: {key} has shape {arrays[key].shape}, {(length, DIM)} was expected'
            )
    before = arrays['initial_forces'] if has_truth else np.zeros((n_given, DIM))
    keys = {TRUTH: 'ground_truth_forces', PREDICTION: 'predicted_forces'}
    force = {
        which: np.concatenate([before, arrays[key]]).astype(np.float64)
        for which, key in keys.items()
        if which == PREDICTION or has_truth
    }
    if has_truth and not np.isfinite(force[TRUTH]).all():
        raise ValueError(f'{path}: the true force has NaN or infinite values')
    return force


def finite_length(prediction: np.ndarray, force: np.ndarray | None) -> int:
    """Number of frames before the first that is not finite."""
    finite = np.isfinite(prediction).all(axis=(1, 2))
    if force is not None:
        finite &= np.isfinite(force).all(axis=1)
    return len(finite) if finite.all() else int(np.argmin(finite))
