"""Exports a dataset in the format of another project: all particles, with their types.

Soil is decoded from the scores of the records, so it is exact within the modes; with --raw_path it
is that of the raw runs, bit for bit. Rollout files (`rollout_*.npz`) are exported too: the given
frames and the predicted ones.

Examples:
    python -m pca_tools.export_data datasets/excavation --format=deepmind --output_path=for_gns

    # the solver's own particles; every fifth
    python -m pca_tools.export_data datasets/excavation --raw_path=raw/excavation \\
        --format=lagrangebench --particle_stride=5 --output_path=for_lagrangebench

    # a rollout for ParaView
    python -m pca_tools.export_data datasets/excavation --rollouts=rollouts --format=vtp \\
        --output_path=paraview
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from absl import flags

from pca_tools import command, dataset, files
from pca_tools.encode import SUBSPACE_NAME
from pca_tools.formats import detect
from pca_tools.formats.full_space import SOIL_TYPE, FullSpaceData, FullSpaceRun
from pca_tools.metadata import SPLITS
from pca_tools.raw_runs import RawRuns
from pca_tools.subspace import Subspace


def export_data(
    data_path: str,
    output_path: str,
    format_name: str,
    *,
    raw_path: str | None = None,
    rollouts: str | None = None,
    splits: Sequence[str] = SPLITS,
    particle_stride: int = 1,
) -> str:
    """Exports a dataset; arguments as the flags of the same names.

    Returns:
        What was done, in one line.

    Raises:
        FileNotFoundError: a folder or file is missing.
        ValueError: damaged data, data that the format cannot hold, or an output that is not empty.
    """
    if particle_stride < 1:
        raise ValueError(f'particle_stride is {particle_stride}, at least 1 was expected')
    if os.path.isdir(output_path) and os.listdir(output_path):
        raise ValueError(f'{output_path}: is not empty; name another folder')
    data = full_space_of(data_path, raw_path, rollouts, splits, particle_stride)
    if next(data.runs(), None) is None:
        raise ValueError(f'{data_path}: holds no runs of {list(splits)}')
    module = detect.FORMATS[format_name]
    files.write_folder_atomically(
        output_path, lambda folder: module.write(folder, data), replace=False
    )
    count = sum(1 for _ in data.runs())
    return f'{output_path}: {count} runs of {data.source} as {module.TITLE}'


def full_space_of(
    data_path: str,
    raw_path: str | None = None,
    rollouts: str | None = None,
    splits: Sequence[str] = SPLITS,
    particle_stride: int = 1,
) -> FullSpaceData:
    """Returns a dataset, or rollouts on it, as trajectories of particles: body first, then soil."""
    metadata = dataset.read_metadata(data_path)
    scene = metadata.get('scene', {})
    space = None
    if raw_path is None or rollouts is not None:
        path = os.path.join(data_path, SUBSPACE_NAME)
        if not os.path.exists(path):
            raise FileNotFoundError(
                f'{path}: no such file; scores cannot be decoded without it: give --raw_path'
            )
        space = Subspace.load(path)
    if rollouts is not None:
        runs = _rollout_runs(rollouts, space, particle_stride)
        source = f'the rollouts {rollouts}'
    else:
        raw = None if raw_path is None else RawRuns(raw_path)

        def runs() -> Iterator[FullSpaceRun]:
            for split, case, run in _records(data_path, metadata, splits):
                own = raw and _own_soil(raw, case)
                soil = space.decode(run.position[:, run.n_rigid :]) if own is None else own
                yield _with_soil(run, soil, split, case, particle_stride)

        source = f'{data_path}, decoded from {space and space.n_modes} modes'
        source = source if raw is None else f'the raw runs {raw_path}'
    context = metadata.get('context_mean', [])
    return FullSpaceData(
        source=source,
        runs=runs,
        dt=metadata['dt'],
        bounds=metadata['bounds'],
        up_axis=scene.get('up_axis', 1),
        context_names=scene.get('context_names') or [f'context_{i}' for i in range(len(context))],
        rigid_motion=scene.get('rigid_motion'),
        radius=metadata['default_connectivity_radius'],
    )


def _records(folder: str, metadata: dict[str, Any], splits: Sequence[str]):
    """Yields (split, case, record) of the splits that a dataset has."""
    for split in splits:
        if os.path.exists(dataset.split_path(folder, split)):
            cases = metadata.get('dataset_split', {}).get(split, [])
            for index, run in enumerate(dataset.read_split(folder, split)):
                yield split, cases[index] if index < len(cases) else index, run


def _own_soil(raw: RawRuns, case) -> np.ndarray:
    """Returns the particles of a raw run."""
    places = {str(known): index for index, known in enumerate(raw.cases)}
    if str(case) not in places:
        raise ValueError(f'{raw.folder}: lacks the case {case} of the dataset')
    return raw[places[str(case)]].positions


def _with_soil(run: dataset.Trajectory, soil, split, case, stride) -> FullSpaceRun:
    soil = np.asarray(soil[:, ::stride], np.float32)
    body = run.position[:, : run.n_rigid]
    types = np.append(run.particle_type[: run.n_rigid], np.full(soil.shape[1], SOIL_TYPE, np.int64))
    return FullSpaceRun(
        f'{split}_{case}', split, np.concatenate([body, soil], axis=1), types,
        force=run.force, context=run.step_context,
    )  # fmt: skip


def _rollout_runs(path: str, space: Subspace, stride: int):
    """Runs of one rollout file, or of all of a folder."""
    names = [path]
    if os.path.isdir(path):
        names = sorted(
            os.path.join(path, name)
            for name in os.listdir(path)
            if name.startswith('rollout_') and name.endswith('.npz')
        )
    if not names:
        raise FileNotFoundError(f'{path}: holds no rollout_*.npz')

    def runs() -> Iterator[FullSpaceRun]:
        for name in names:
            yield _rollout_run(name, files.read_npz(name), space, stride)

    return runs


def _rollout_run(path: str, arrays: dict[str, Any], space: Subspace, stride: int) -> FullSpaceRun:
    needed = ('initial_positions', 'predicted_rollout', 'particle_types')
    lacking = [key for key in needed if key not in arrays]
    if lacking:
        raise ValueError(f'{path}: is not a rollout, it lacks {lacking}')
    nodes = np.concatenate([arrays['initial_positions'], arrays['predicted_rollout']])
    types = arrays['particle_types']
    modes = types == dataset.MODE_PARTICLE_ID
    if nodes.ndim != 3 or nodes.shape[1] != len(types) or modes.sum() != space.n_modes:
        raise ValueError(
            f'{path}: {nodes.shape} positions of {modes.sum()} modes do not fit the subspace of '
            f'{space.n_modes}'
        )
    force = None
    if 'predicted_forces' in arrays and 'initial_forces' in arrays:
        force = np.concatenate([arrays['initial_forces'], arrays['predicted_forces']])
    name = os.path.basename(path).removesuffix('.npz')
    split = next((split for split in SPLITS if f'_{split}_' in name), 'test')
    soil = np.asarray(space.decode(nodes[:, modes])[:, ::stride], np.float32)
    positions = np.concatenate([nodes[:, ~modes].astype(np.float32), soil], axis=1)
    kinds = np.append(types[~modes], np.full(soil.shape[1], SOIL_TYPE)).astype(np.int64)
    return FullSpaceRun(name, split, positions, kinds, force=force)


def define_flags() -> None:
    """Defines the flags; not at import, so that several commands can be imported together."""
    flags.DEFINE_string('output_path', None, 'Folder of the export.', required=True)
    flags.DEFINE_enum('format', None, sorted(detect.FORMATS), 'Of the export.', required=True)
    flags.DEFINE_string('raw_path', None, 'Raw runs of the dataset, to export their own particles.')
    flags.DEFINE_string('rollouts', None, 'A rollout file or a folder of them, exported instead.')
    flags.DEFINE_list('splits', list(SPLITS), 'Splits to export.')
    flags.DEFINE_integer('particle_stride', 1, 'Every how many soil particles are exported.')


def main(values, arguments: Sequence[str]) -> None:
    """Runs the command."""
    if not arguments:
        sys.exit('usage: python -m pca_tools.export_data DATASET --format=... --output_path=...')
    text = export_data(
        arguments[0], values.output_path, values.format, raw_path=values.raw_path,
        rollouts=values.rollouts, splits=values.splits, particle_stride=values.particle_stride,
    )  # fmt: skip
    print(text)


if __name__ == '__main__':
    define_flags()
    command.start_quietly(main, 1)
