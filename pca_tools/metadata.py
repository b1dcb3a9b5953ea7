"""`metadata.json` of a dataset folder: what it must hold and how it is checked.

Raw runs are of a scene with bounds, too; both are checked here alike. Every check returns
sentences, so that a person is told all of them at once.

The keys are DeepMind's (learning_to_simulate) and the authors' (Subspace-Graph-Physics); ours come
on top and are optional: `schema_version`, `scene`, `frames_stored`, `n_soil`, `pca`, `cases`,
`projection_mse`.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

from pca_tools import files

METADATA_NAME = 'metadata.json'
SCHEMA_VERSION = 1
DIM = 3
SPLITS = ('train', 'valid', 'test')
AXES = ('x', 'y', 'z')
# What the projection does to each record, see `pca_tools.convert.projection_details`.
PROJECTION_KEYS = ('projection_mse', 'projection_max_mm', 'motion_mse', 'motion_kept')
RIGID_MOTIONS = ('none', 'prescribed', 'driven', 'predicted')
_REQUIRED = (
    'bounds', 'sequence_length', 'default_connectivity_radius', 'dim', 'dt',
    'vel_mean', 'vel_std', 'acc_mean', 'acc_std', 'mode_number',
)  # fmt: skip


def read_metadata(folder: str) -> dict[str, Any]:
    """Reads and checks the metadata of a dataset folder, ours or the authors'.

    Args:
        folder: dataset folder with `metadata.json`.

    Returns:
        The metadata as written; nothing is added or changed.

    Raises:
        FileNotFoundError: the folder or the file is missing.
        ValueError: not JSON, a missing key, a wrong type, or an impossible value; all problems are
            listed.
    """
    path = os.path.join(folder, METADATA_NAME)
    if not os.path.isdir(folder):
        raise FileNotFoundError(f'{folder}: no such dataset folder')
    if not os.path.exists(path):
        raise FileNotFoundError(f'{path}: no such file{_what_else(folder)}')
    metadata = files.read_json(path)
    problems = metadata_problems(metadata)
    if problems:
        raise ValueError(f'{path}: ' + '; '.join(problems) + _what_else(folder))
    return metadata


def union_of_bounds(every: Sequence[list[list[float]]]) -> list[list[float]]:
    """Returns the least bounds [[low, high]] * D that hold all given ones."""
    return [
        [min(low for low, _ in pairs), max(high for _, high in pairs)]
        for pairs in zip(*every, strict=True)
    ]


def _what_else(folder: str) -> str:
    """Names the format of a folder that is no dataset of ours, with what to do; else empty."""
    from pca_tools.formats import detect  # knows all formats, this one included

    try:
        kind = detect.detect(folder)
    except (ValueError, OSError):
        return ''
    known = kind in detect.FORMATS or kind == detect.RAW
    return f'. {detect.explain(kind, folder)}' if known else ''


def metadata_problems(metadata: Any) -> list[str]:
    """Returns what is wrong with a metadata dictionary, one sentence each; empty if nothing is."""
    if not isinstance(metadata, dict):
        return [f'must be a JSON object, found {type(metadata).__name__}']
    missing = [key for key in _REQUIRED if key not in metadata]
    if missing:
        return [f'lacks {", ".join(missing)}']
    problems = []
    if metadata['dim'] != DIM:
        problems.append(f'dim is {metadata["dim"]!r}, only {DIM} is supported')
    for key in ('dt', 'default_connectivity_radius'):
        if not is_number(metadata[key]) or metadata[key] <= 0:
            problems.append(f'{key} is {metadata[key]!r}, a positive number was expected')
    for key in ('sequence_length', 'mode_number', 'n_soil', 'particles_rigid'):
        least = int(key != 'particles_rigid')
        if not is_index(metadata.get(key, least)) or metadata.get(key, least) < least:
            problems.append(
                f'{key} is {metadata[key]!r}, an integer of at least {least} was expected'
            )
    problems += bounds_problems(metadata['bounds'])
    for name in ('vel', 'acc', 'rigid_body_force', 'rigid_body_torque', 'context'):
        problems += _statistics_problems(metadata, name, None if name == 'context' else DIM)
    if metadata.get('schema_version', SCHEMA_VERSION) != SCHEMA_VERSION:
        problems.append(
            f'schema_version is {metadata["schema_version"]!r}, this program reads {SCHEMA_VERSION}'
        )
    problems += _record_problems(metadata)
    if 'scene' in metadata:
        problems += scene_problems(metadata['scene']) or _disagreements(metadata)
    return problems


def bounds_problems(bounds: Any) -> list[str]:
    """Returns what is wrong with bounds, which must be [[low, high]] * 3 in metres."""
    if not isinstance(bounds, list) or len(bounds) != DIM:
        return [f'bounds is {bounds!r}, {DIM} pairs [low, high] in metres were expected']
    for pair in bounds:
        if not _is_numbers(pair, 2) or pair[0] >= pair[1]:
            return [f'bounds has {pair!r}, a pair [low, high] with low < high was expected']
    return []


def scene_problems(scene: Any) -> list[str]:
    """Returns what is wrong with the scene of a dataset or of raw runs."""
    if not isinstance(scene, dict):
        return [f'scene is {scene!r}, an object was expected']
    problems = []
    for key, is_possible, expected in (
        ('name', isinstance(scene.get('name', ''), str), 'a text'),
        ('rigid_motion', scene.get('rigid_motion') in RIGID_MOTIONS, f'one of {RIGID_MOTIONS}'),
        ('up_axis', is_index(scene.get('up_axis', 1)) and scene.get('up_axis', 1) < DIM,
         '0 (x), 1 (y) or 2 (z)'),
        ('context_names', _all_are(scene.get('context_names', []), lambda n: isinstance(n, str)),
         'a list of texts'),
        ('rigid_edges', _all_are(scene.get('rigid_edges', []), _is_edge),
         'a list of pairs of rigid points'),
        ('bodies', 'bodies' not in scene
         or _all_are(scene['bodies'], _is_body) and len(scene['bodies']) > 1,
         f'a list of two or more objects with name, rigid_motion (one of {RIGID_MOTIONS[1:]}) and '
         'points'),
    ):  # fmt: skip
        if not is_possible:
            problems.append(f'scene.{key} is {short(scene.get(key))}, {expected} was expected')
    return problems


def _disagreements(metadata: dict[str, Any]) -> list[str]:
    """What a scene says that the other metadata do not."""
    scene, problems = metadata['scene'], []
    names, context = scene.get('context_names', []), metadata.get('context_mean', [])
    if isinstance(context, list) and len(names) != len(context):
        problems.append(
            f'scene.context_names has {len(names)} names but context_mean has {len(context)} values'
        )
    if bool(scene.get('force')) != ('rigid_body_force_mean' in metadata):
        problems.append('scene.force and the presence of rigid_body_force_mean disagree')
    count = metadata.get('particles_rigid', math.inf)
    beyond = [edge for edge in scene.get('rigid_edges', []) if max(edge) >= count]
    if beyond:
        problems.append(
            f'scene.rigid_edges has {beyond[0]}, two of {count} rigid particles were expected'
        )
    return problems


def _statistics_problems(metadata: dict[str, Any], name: str, length: int | None) -> list[str]:
    """Checks a pair `<name>_mean`, `<name>_std`; a pair that is absent as a whole is no problem."""
    held = {f'{name}_{kind}': metadata.get(f'{name}_{kind}') for kind in ('mean', 'std')}
    if not held.keys() & metadata.keys():
        return []
    problems = [
        f'{key} is {value!r}, {length or "finite"} numbers were expected'
        for key, value in held.items()
        if not _is_numbers(value, length)
    ]
    if problems:
        return problems
    mean, std = held.values()
    if len(mean) != len(std):
        return [f'{name}_mean has {len(mean)} values but {name}_std has {len(std)}']
    if min(std, default=0.0) < 0:
        return [f'{name}_std has a negative value: {std!r}']
    return []


def _record_problems(metadata: dict[str, Any]) -> list[str]:
    """Checks the optional keys that hold one value per record of each split."""
    problems = []
    if not isinstance(metadata.get('pca', {}), dict):
        problems.append(f'pca is {metadata["pca"]!r}, an object was expected')
    for key in ('dataset_split', 'cases', 'frames_of_runs', *PROJECTION_KEYS):
        value = metadata.get(key, {})
        if not isinstance(value, dict) or not _all_are(
            list(value.values()), lambda part: isinstance(part, list)
        ):
            problems.append(f'{key} must be an object with one list for each split')
        elif key in PROJECTION_KEYS and not all(_is_numbers(part, None) for part in value.values()):
            problems.append(f'{key} must hold one number for each record')
    return problems


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


def short(value: Any) -> str:
    """Returns a value as text that fits into a message."""
    text = repr(value)
    return text if len(text) < 200 else text[:197] + '...'


def _all_are(values: Any, is_one: Callable[[Any], bool]) -> bool:
    return isinstance(values, list) and all(map(is_one, values))


def _is_numbers(value: Any, length: int | None) -> bool:
    return _all_are(value, is_number) and (length is None or len(value) == length)


def _is_edge(value: Any) -> bool:
    return _all_are(value, is_index) and len(value) == 2


def _is_body(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and isinstance(value.get('name'), str)
        and value.get('rigid_motion') in RIGID_MOTIONS[1:]
        and is_index(value.get('points'))
        and value['points'] > 0
    )
