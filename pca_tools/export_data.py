"""Exports a dataset in the format of another project: all particles, with their types.

Soil is decoded from the scores of the records, so it is exact within the modes; with --raw_path it
is that of the raw runs, bit for bit. Rollout files (`rollout_*.npz`) are exported too: the given
frames and the predicted ones.

Examples:
    lts export-data datasets/excavation --format=deepmind --output_path=for_gns

    # the solver's own particles; every fifth
    lts export-data datasets/excavation --raw_path=raw/excavation \\
        --format=lagrangebench --particle_stride=5 --output_path=for_lagrangebench

    # a rollout for ParaView
    lts export-data datasets/excavation --rollouts=rollouts --format=vtp \\
        --output_path=paraview
"""

import functools
import glob
import os
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from absl import flags

from pca_tools import command, dataset, files, formats
from pca_tools.formats.full_space import SOIL_TYPE, FullSpaceData, FullSpaceRun
from pca_tools.metadata import SPLITS
from pca_tools.raw_runs import RawRuns
from pca_tools.subspace import SUBSPACE_NAME, Subspace


def export_data(data_path: str, output_path: str, format_name: str, **chosen: Any) -> str:
    """Exports what of a dataset is `chosen` (`full_space_of`); returns what was done.
    FileNotFoundError: a folder or file is missing. ValueError: damaged data, data that the format
    cannot hold, or an output that is not empty."""
    data = full_space_of(data_path, **chosen)
    if next(data.runs(), None) is None:
        raise ValueError(f'{data.source}: holds no runs of {chosen.get("splits", SPLITS)}')
    module = formats.FORMATS[format_name]
    files.write_folder_atomically(
        output_path, lambda folder: module.write(folder, data), replace=False
    )
    return f'{output_path}: {data.source} as {module.TITLE}'


def full_space_of(
    data_path: str,
    raw_path: str | None = None,
    rollouts: str | None = None,
    splits: Sequence[str] = SPLITS,
    particle_stride: int = 1,
) -> FullSpaceData:
    """Returns a dataset, or rollouts on it, as trajectories of particles: body first, then soil;
    arguments as the flags of the same names."""
    if particle_stride < 1:
        raise ValueError(f'particle_stride is {particle_stride}, at least 1 was expected')
    metadata = dataset.read_metadata(data_path)
    scene = metadata.get('scene', {})
    raw, space = None, None
    if raw_path is not None and rollouts is None:
        raw, source = RawRuns(raw_path), f'the raw runs {raw_path}'
    else:
        path = os.path.join(data_path, SUBSPACE_NAME)
        if not os.path.exists(path):
            raise FileNotFoundError(
                f'{path}: no such file; scores cannot be decoded without it: give --raw_path'
            )
        space = Subspace.load(path)
        source = f'{data_path}, decoded from {space.n_modes} modes'

    def soil_of(case: Any, scores: np.ndarray) -> np.ndarray:
        if raw is None:
            return space.decode(scores)
        known = [str(one) for one in raw.cases]
        if str(case) not in known:
            raise ValueError(f'{raw_path}: lacks the case {case} of the dataset')
        return raw[known.index(str(case))].positions

    if rollouts is not None:
        source = f'the rollouts {rollouts}'
        records = functools.partial(_rollouts, rollouts, space.n_modes)
    else:
        records = functools.partial(_records, data_path, metadata, splits)

    def runs() -> Iterator[FullSpaceRun]:
        for name, split, case, positions, types, series in records():
            is_mode = types == dataset.MODE_PARTICLE_ID
            soil = soil_of(case, positions[:, is_mode])[:, ::particle_stride].astype(np.float32)
            body = positions[:, ~is_mode].astype(np.float32)
            kinds = np.append(types[~is_mode], np.full(soil.shape[1], SOIL_TYPE)).astype(np.int64)
            yield FullSpaceRun(name, split, np.concatenate([body, soil], axis=1), kinds, **series)

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
        name=scene.get('name', 'soil'),
    )


def _records(data_path: str, metadata: dict[str, Any], splits: Sequence[str]) -> Iterator[tuple]:
    """Yields name, split, case, positions and types of nodes, and series of every record."""
    for split in splits:
        if os.path.exists(dataset.split_path(data_path, split)):
            cases = metadata.get('dataset_split', {}).get(split, [])
            for index, run in enumerate(dataset.read_split(data_path, split)):
                case = cases[index] if index < len(cases) else index
                name = f'{split}_{case}'
                if os.path.basename(name) != name:  # it becomes one, and points out of the folder
                    raise ValueError(f'{data_path}: case {case!r} cannot name a file')
                series = {'force': run.force, 'context': run.step_context}
                yield name, split, case, run.position, run.particle_type, series


def _rollouts(rollouts: str, n_modes: int) -> Iterator[tuple]:
    """Yields the same as `_records` of a rollout file or a folder of them: given frames, then
    predicted ones."""
    is_folder = os.path.isdir(rollouts)
    paths = sorted(glob.glob(os.path.join(glob.escape(rollouts), 'rollout_*.npz')))
    if is_folder and not paths:
        raise FileNotFoundError(f'{rollouts}: holds no rollout_*.npz')
    for path in paths if is_folder else [rollouts]:
        arrays = files.read_npz(path)
        needed = ('initial_positions', 'predicted_rollout', 'particle_types')
        if lacking := [key for key in needed if key not in arrays]:
            raise ValueError(f'{path}: is not a rollout, it lacks {lacking}')
        first, predicted, types = (arrays[key] for key in needed)
        nodes, found = np.concatenate([first, predicted]), np.sum(types == dataset.MODE_PARTICLE_ID)
        if nodes.ndim != 3 or nodes.shape[1] != len(types) or found != n_modes:
            held = f'{nodes.shape} positions of {found} modes'
            raise ValueError(f'{path}: {held} do not fit the subspace of {n_modes}')
        series = {}
        if 'predicted_forces' in arrays and 'initial_forces' in arrays:
            forces = [arrays['initial_forces'], arrays['predicted_forces']]
            series['force'] = np.concatenate(forces)
        name = os.path.basename(path).removesuffix('.npz')
        split = next((split for split in SPLITS if f'_{split}_' in name), 'test')
        yield name, split, None, nodes, types, series


def define_flags() -> None:
    flags.DEFINE_string('output_path', None, 'Folder of the export.', required=True)
    flags.DEFINE_enum('format', None, sorted(formats.FORMATS), 'Of the export.', required=True)
    flags.DEFINE_string('raw_path', None, 'Raw runs of the dataset, to export their own particles.')
    flags.DEFINE_string('rollouts', None, 'A rollout file or a folder of them, exported instead.')
    flags.DEFINE_list('splits', list(SPLITS), 'Splits to export.')
    flags.DEFINE_integer('particle_stride', 1, 'Every how many soil particles are exported.')


def main(values, arguments: Sequence[str]) -> None:
    text = export_data(
        arguments[0], values.output_path, values.format, raw_path=values.raw_path,
        rollouts=values.rollouts, splits=values.splits, particle_stride=values.particle_stride,
    )  # fmt: skip
    print(text)


if __name__ == '__main__':
    define_flags()
    usage = 'lts export-data DATASET --format=... --output_path=...'
    command.start_quietly(main, 1, usage)
