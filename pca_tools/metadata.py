"""`metadata.json` of a dataset folder: what it must hold and how it is checked.

The keys are DeepMind's (learning_to_simulate) and the authors' (Subspace-Graph-Physics); ours come
on top and are optional: `schema_version`, `scene`, `frames_stored`, `n_soil`, `pca`, `cases`,
`projection_mse`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Any

from pca_tools import files

METADATA_NAME = 'metadata.json'
SCHEMA_VERSION = 1
DIM = 3
SPLITS = ('train', 'valid', 'test')
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
        if not _is_number(metadata[key]) or metadata[key] <= 0:
            problems.append(f'{key} is {metadata[key]!r}, a positive number was expected')
    for key, least in (
        ('sequence_length', 1),
        ('mode_number', 1),
        ('particles_rigid', 0),
        ('n_soil', 1),
    ):
        value = metadata.get(key, least)
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            problems.append(f'{key} is {value!r}, an integer of at least {least} was expected')
    problems += _bounds_problems(metadata['bounds'])
    for name, length in (
        ('vel', DIM), ('acc', DIM), ('rigid_body_force', DIM), ('rigid_body_torque', DIM),
        ('context', None),
    ):  # fmt: skip
        problems += _statistics_problems(metadata, name, length)
    version = metadata.get('schema_version', SCHEMA_VERSION)
    if version != SCHEMA_VERSION:
        problems.append(f'schema_version is {version!r}, this program reads {SCHEMA_VERSION}')
    problems += _record_problems(metadata)
    if 'scene' in metadata:
        problems += _scene_problems(metadata)
    return problems


def _bounds_problems(bounds: Any) -> list[str]:
    if not isinstance(bounds, list) or len(bounds) != DIM:
        return [f'bounds is {bounds!r}, {DIM} pairs [low, high] were expected']
    for pair in bounds:
        if not _is_numbers(pair, 2) or pair[0] >= pair[1]:
            return [f'bounds has {pair!r}, a pair [low, high] with low < high was expected']
    return []


def _statistics_problems(metadata: dict[str, Any], name: str, length: int | None) -> list[str]:
    """Checks a pair `<name>_mean`, `<name>_std`; a pair that is absent as a whole is no problem."""
    if f'{name}_mean' not in metadata and f'{name}_std' not in metadata:
        return []
    mean, std = metadata.get(f'{name}_mean'), metadata.get(f'{name}_std')
    problems = []
    for key, value in ((f'{name}_mean', mean), (f'{name}_std', std)):
        if not _is_numbers(value, length):
            problems.append(f'{key} is {value!r}, {length or "finite"} numbers were expected')
    if problems:
        return problems
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
        if not isinstance(value, dict) or not all(
            isinstance(part, list) for part in value.values()
        ):
            problems.append(f'{key} must be an object with one list for each split')
        elif key in PROJECTION_KEYS and not all(_is_numbers(part, None) for part in value.values()):
            problems.append(f'{key} must hold one number for each record')
    return problems


def _scene_problems(metadata: dict[str, Any]) -> list[str]:
    scene = metadata['scene']
    if not isinstance(scene, dict):
        return [f'scene is {scene!r}, an object was expected']
    problems = []
    if scene.get('rigid_motion') not in RIGID_MOTIONS:
        problems.append(
            f'scene.rigid_motion is {scene.get("rigid_motion")!r}, one of {RIGID_MOTIONS} was '
            'expected'
        )
    if not isinstance(scene.get('name', ''), str):
        problems.append(f'scene.name is {scene["name"]!r}, a text was expected')
    up_axis = scene.get('up_axis', 1)
    if isinstance(up_axis, bool) or up_axis not in range(DIM) or not isinstance(up_axis, int):
        problems.append(f'scene.up_axis is {up_axis!r}, one of 0, 1, 2 was expected')
    names, edges = scene.get('context_names', []), scene.get('rigid_edges', [])
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        return [*problems, f'scene.context_names is {names!r}, a list of texts was expected']
    if not isinstance(edges, list):
        return [*problems, f'scene.rigid_edges is {edges!r}, a list of pairs was expected']
    context = metadata.get('context_mean', [])
    if isinstance(context, list) and len(names) != len(context):
        problems.append(
            f'scene.context_names has {len(names)} names but context_mean has {len(context)} values'
        )
    if bool(scene.get('force')) != ('rigid_body_force_mean' in metadata):
        problems.append('scene.force and the presence of rigid_body_force_mean disagree')
    count = metadata.get('particles_rigid')
    for edge in edges:
        if (
            not _is_numbers(edge, 2)
            or not all(isinstance(end, int) and end >= 0 for end in edge)
            or (isinstance(count, int) and max(edge) >= count)
        ):
            problems.append(
                f'scene.rigid_edges has {edge!r}, two of {count} rigid particles were expected'
            )
            break
    return problems


def _is_number(value: Any) -> bool:
    # JSON has integers that no float can hold.
    return (
        isinstance(value, (int, float))
        and not isinstance(value, bool)
        and abs(value) <= sys.float_info.max
    )


def _is_numbers(value: Any, length: int | None) -> bool:
    return (
        isinstance(value, list)
        and all(_is_number(item) for item in value)
        and (length is None or len(value) == length)
    )
