"""`metadata.json` of a dataset folder: what it must hold and how it is checked.

Raw runs are of a scene with bounds, too; both are checked here alike. Every check returns
sentences, so that a person sees all of them at once.

The keys are DeepMind's (learning_to_simulate) and the authors' (Subspace-Graph-Physics); ours come
on top and are optional.
"""

import math
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pca_tools import files

METADATA_NAME = 'metadata.json'
SCHEMA_VERSION = 1
DIM = 3
SPLITS = ('train', 'valid', 'test')
AXES = ('x', 'y', 'z')
# What the projection does to each record, see `pca_tools.encode.projection_details`.
PROJECTION_KEYS = ('projection_mse', 'projection_max_mm', 'motion_mse', 'motion_kept')
RIGID_MOTIONS = ('none', 'prescribed', 'driven', 'predicted')
_REQUIRED = (
    'bounds', 'sequence_length', 'default_connectivity_radius', 'dim', 'dt',
    'vel_mean', 'vel_std', 'acc_mean', 'acc_std', 'mode_number',
)  # fmt: skip


def read_metadata(folder: str) -> dict[str, Any]:
    """Returns the checked metadata of a dataset folder, ours or the authors', as written.
    FileNotFoundError: the folder or the file is missing. ValueError: not JSON, or keys and values
    that are not as expected, all of them listed."""
    path, what = os.path.join(folder, METADATA_NAME), f'`lts import {folder}` says what it is'
    if not os.path.isdir(folder):
        raise FileNotFoundError(f'{folder}: no such dataset folder')
    if not os.path.exists(path):
        raise FileNotFoundError(f'{path}: no such file, so the folder is no dataset; {what}')
    metadata = files.read_json(path)
    problems = metadata_problems(metadata)
    if problems:
        raise ValueError(f'{path}: ' + '; '.join(problems) + f'. {what}')
    return metadata


def union_of_bounds(every: Sequence[list[list[float]]]) -> list[list[float]]:
    """Returns the least bounds [[low, high]] * D that hold all given ones."""
    return [
        [min(low for low, _ in pairs), max(high for _, high in pairs)]
        for pairs in zip(*every, strict=True)
    ]


def non_finite(values: np.ndarray, *axes: str) -> str:
    """Says how many values are not finite and where the first is, by the names of its last axes;
    empty where all are finite."""
    bad = np.argwhere(~np.isfinite(values))
    if not len(bad):
        return ''
    axes = axes[-values.ndim :]
    place = ', '.join(f'{axis} {index}' for axis, index in zip(axes, bad[0][-len(axes) :]))
    return f'{len(bad)} NaN or infinite values, the first at {place}'


def is_number(value: Any) -> bool:
    """Whether a value of a JSON file is a finite number that a float can hold."""
    return (
        isinstance(value, (int, float))
        and not isinstance(value, bool)
        and abs(value) <= sys.float_info.max
    )


def is_index(value: Any) -> bool:
    """Whether a value is a whole number of at least 0."""
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _list_of(is_one: Callable[[Any], bool], length: int | None = None) -> Callable[[Any], bool]:
    return lambda values: (
        isinstance(values, list)
        and (length is None or len(values) == length)
        and all(map(is_one, values))
    )


def _is_body(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and _is_text(value.get('name'))
        and value.get('rigid_motion') in RIGID_MOTIONS[1:]
        and is_index(value.get('points'))
        and value['points'] > 0
    )


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_pca(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and _is_text(value.get('file', ''))
        and _list_of(_is_text)(value.get('fitted_on', []))
    )


def _is_pair(value: Any) -> bool:
    return _list_of(is_number, 2)(value) and value[0] < value[1]


def _of_splits(what: str, is_one: Callable[[Any], bool]) -> tuple[str, Callable[[Any], bool]]:
    """The check of a key that holds one value for each record of each split."""
    is_part = _list_of(is_one)
    return (
        f'an object with a list for each split, one {what} a record,',
        lambda value: isinstance(value, dict) and all(map(is_part, value.values())),
    )


# Key -> what is expected, and whether a value is that.
Checks = dict[str, tuple[str, Callable[[Any], bool]]]
_POSITIVE = ('a positive number', lambda value: is_number(value) and value > 0)
_COUNT = ('an integer of at least 1', lambda value: is_index(value) and value > 0)
_VECTOR = (f'{DIM} numbers', _list_of(is_number, DIM))
_DEVIATIONS = (f'{DIM} numbers, none negative,', lambda v: _VECTOR[1](v) and min(v) >= 0)
WORLD_CHECKS: Checks = {
    'dt': ('a positive number of seconds', _POSITIVE[1]),
    'bounds': (f'{DIM} pairs [low, high] in metres, low < high,', _list_of(_is_pair, DIM)),
}
_CHECKS: Checks = WORLD_CHECKS | {
    'dim': (f'{DIM}', lambda value: value == DIM),
    'default_connectivity_radius': _POSITIVE,
    'sequence_length': _COUNT, 'mode_number': _COUNT, 'n_soil': _COUNT,
    'particles_rigid': ('an integer of at least 0', is_index),
    **{
        f'{name}_{kind}': check
        for name in ('vel', 'acc', 'rigid_body_force', 'rigid_body_torque')
        for kind, check in (('mean', _VECTOR), ('std', _DEVIATIONS))
    },
    'context_mean': ('finite numbers', _list_of(is_number)),
    'context_std': ('numbers, none negative,', _list_of(lambda v: is_number(v) and v >= 0)),
    'schema_version': (f'{SCHEMA_VERSION}', lambda value: value == SCHEMA_VERSION),
    'pca': ('an object with the file and the runs of the fit as texts', _is_pca),
    'projection_floors': ('an object with lists of numbers', _of_splits('', is_number)[1]),
    'dataset_split': _of_splits('case id', lambda value: isinstance(value, (int, str))),
    'cases': _of_splits('object', lambda value: isinstance(value, dict)),
    'frames_of_runs': _of_splits('number', is_index),
    **dict.fromkeys(PROJECTION_KEYS, _of_splits('number', is_number)),
}  # fmt: skip
_SCENE_CHECKS: Checks = {
    'name': ('a text', _is_text),
    'rigid_motion': (f'one of {RIGID_MOTIONS}', RIGID_MOTIONS.__contains__),
    'up_axis': ('0 (x), 1 (y) or 2 (z)', lambda value: is_index(value) and value < DIM),
    'context_names': ('a list of texts', _list_of(_is_text)),
    'rigid_edges': ('a list of pairs of rigid points', _list_of(_list_of(is_index, 2))),
    'bodies': (
        f'a list of two or more objects with name, rigid_motion (one of {RIGID_MOTIONS[1:]}) and '
        'points',
        lambda value: _list_of(_is_body)(value) and len(value) > 1,
    ),
}


def problems_of(values: dict[str, Any], checks: Checks, prefix: str = '') -> list[str]:
    """Returns a sentence about each value that is there and not what is expected."""
    return [
        f'{prefix}{key} is {short(values[key])}, {expected} was expected'
        for key, (expected, is_right) in checks.items()
        if key in values and not is_right(values[key])
    ]


def metadata_problems(metadata: Any) -> list[str]:
    """Returns what is wrong with a metadata dictionary, one sentence each; empty if nothing is."""
    if not isinstance(metadata, dict):
        return [f'must be a JSON object, found {type(metadata).__name__}']
    if missing := [key for key in _REQUIRED if key not in metadata]:
        return [f'lacks {", ".join(missing)}']
    problems = problems_of(metadata, _CHECKS)
    if problems := problems + scene_problems(metadata.get('scene', {'rigid_motion': 'none'})):
        return problems
    for name in ('rigid_body_force', 'rigid_body_torque', 'context'):
        means, deviations = (metadata.get(f'{name}_{kind}', []) for kind in ('mean', 'std'))
        if len(means) != len(deviations):
            problems.append(f'{name}_mean has {len(means)} values but {name}_std {len(deviations)}')
    if 'scene' not in metadata:
        return problems
    scene = metadata['scene']
    names, context = scene.get('context_names', []), metadata.get('context_mean', [])
    if len(names) != len(context):
        problems.append(f'scene.context_names has {len(names)} names, context_mean {len(context)}')
    if bool(scene.get('force')) != ('rigid_body_force_mean' in metadata):
        problems.append('scene.force and the presence of rigid_body_force_mean disagree')
    count = metadata.get('particles_rigid', math.inf)
    if beyond := [edge for edge in scene.get('rigid_edges', []) if max(edge) >= count]:
        problems.append(f'scene.rigid_edges has {beyond[0]}, two of {count} rigid particles')
    return problems


def scene_problems(scene: Any) -> list[str]:
    """Returns what is wrong with the scene of a dataset or of raw runs."""
    if not isinstance(scene, dict):
        return [f'scene is {short(scene)}, an object was expected']
    return problems_of({'rigid_motion': None, **scene}, _SCENE_CHECKS, 'scene.')


def short(value: Any) -> str:
    """Returns a value as text that fits into a message."""
    text = repr(value)
    return text if len(text) < 200 else text[:197] + '...'
