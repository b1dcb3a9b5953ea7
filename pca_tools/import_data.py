"""Imports data of other projects as raw runs, which `lts convert` takes.

Known are DeepMind's learning_to_simulate, geoelements/gns, LagrangeBench, MPM-NGF, series of VTP
files, plain npz, and the folders of Subspace-Graph-Physics (which become a dataset at once). The
format is recognised from the files. Soil and body differ by the particle types: 0 rigid, 3 boundary
or prescribed, all others soil.

Examples:
    lts import downloads/Sand --output_path=raw/sand --up_axis=1
    lts convert --raw_path=raw/sand --output_path=datasets/Sand

    # what is this?
    lts import FOLDER

    # frames of MPM-NGF do not say their time step; a quarter of full size is scaled up
    lts import MPM-NGF/output --output_path=raw/ngf --dt=0.0166667 \\
        --length_scale=4 --force_scale=64
"""

import dataclasses
import os
import statistics
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from absl import flags
from tqdm import tqdm

from pca_tools import command, dataset, files, formats, legacy_pickles, raw_runs
from pca_tools.formats import full_space
from pca_tools.metadata import AXES, METADATA_NAME, RIGID_MOTIONS, SCHEMA_VERSION, SPLITS


def import_data(
    folder: str,
    output_path: str,
    *,
    dt: float | None = None,
    up_axis: int | None = None,
    body: str | None = None,
    name: str | None = None,
    length_scale: float = 1.0,
    force_scale: float = 1.0,
    check_units: bool = True,
) -> str:
    """Imports a folder; arguments as the flags of the same names. Returns what was done, as text.
    FileNotFoundError: there is no such folder. ValueError: data that are not known, damaged, or
    lack what nobody stated."""
    kind = formats.detect(folder)
    if kind in (formats.RAW, formats.DATASET):
        raise ValueError(formats.NO_IMPORT[kind].format(folder=folder))
    name = name or os.path.basename(os.path.abspath(folder))
    if kind == formats.AUTHORS:
        given = ('dt', dt, None), ('length_scale', length_scale, 1), ('force_scale', force_scale, 1)
        if other := [f'--{flag}={value}' for flag, value, usual in given if value != usual]:
            kept = 'its scores and forces are kept as they are, with their dt'
            raise ValueError(f'{folder}: {kept}: leave out {", ".join(other)}')
        return _import_authors(folder, output_path, name, body, 1 if up_axis is None else up_axis)
    data = formats.FORMATS[kind].read(folder, dt)
    body = body or full_space.body_motion(data)
    bounds = _three_bounds(data.bounds, length_scale)
    up, note = _up_axis(data, bounds) if up_axis is None else (up_axis, None)
    if lacking := _lacking(data, up, note):
        raise ValueError(f'{data.source}: does not say {", and ".join(lacking.values())}')
    data.notes += filter(None, [note])
    runs = _scaled(full_space.raw_mappings(data, body), length_scale, force_scale)
    raw_runs.write_raw(
        output_path, tqdm(runs, desc='import', unit='run'), data.dt, up_axis=up, body=body,
        bounds=bounds, name=name, check_units=check_units,
    )  # fmt: skip
    lines = [f'{output_path}: raw runs of {data.source}; body: {body}, {AXES[up]} up']
    lines += [f'note: {note}' for note in data.notes]
    lines.append(f'next: lts convert --raw_path={output_path} --output_path=DATASET')
    return '\n'.join(lines)


def _import_authors(
    folder: str, output_path: str, name: str, rigid_motion: str | None, up_axis: int
) -> str:
    """Makes a dataset of a folder of Subspace-Graph-Physics that states its scene, counts its keys,
    and has a manifest. Its subspace stays behind: the published eigenvectors are git-lfs
    pointers."""
    metadata = dataset.read_metadata(folder)
    splits = {
        split: dataset.read_split(folder, split)
        for split in SPLITS
        if os.path.exists(dataset.split_path(folder, split))
    }
    runs = [run for part in splits.values() for run in part]
    if not runs:
        raise ValueError(f'{folder}: holds no records')
    prescribed = runs[0].particle_type[0] == dataset.KINEMATIC_PARTICLE_ID
    rigid_motion = rigid_motion or ('prescribed' if prescribed else 'predicted')
    scene = {
        'name': name,
        'rigid_motion': rigid_motion,
        'rigid_edges': [],
        'context_names': [f'context_{i}' for i in range(len(metadata.get('context_mean', [])))],
        'force': 'rigid_body_force_mean' in metadata,
        'up_axis': up_axis,
    }
    metadata = {
        **metadata,
        'schema_version': SCHEMA_VERSION,
        'scene': scene,
        'particles_rigid': statistics.mode(run.n_rigid for run in runs),
        'frames_stored': runs[0].n_frames,
    }
    if n_soil := legacy_pickles.soil_particles(folder):
        metadata['n_soil'] = n_soil
    # Their ids repeat and are not as many as the records.
    metadata['source_split'] = metadata.pop('dataset_split', {})
    metadata['dataset_split'] = {
        split: [f'{split}_{index}' for index in range(len(part))] for split, part in splits.items()
    }

    def fill(temporary: str) -> None:
        listed: dict[str, dict[str, Any]] = {METADATA_NAME: {}}
        files.write_json(os.path.join(temporary, METADATA_NAME), metadata)
        for split, part in splits.items():
            path = dataset.split_path(temporary, split)
            kept = []
            for key, run in enumerate(part):
                is_mode = run.particle_type == dataset.MODE_PARTICLE_ID
                types = np.where(is_mode, run.particle_type, dataset.rigid_type(rigid_motion))
                kept.append(dataclasses.replace(run, key=key, particle_type=types))
            listed[os.path.basename(path)] = {'records': dataset.write_split(path, kept)}
        files.write_manifest(temporary, listed)

    files.write_folder_atomically(output_path, fill, replace=False)
    counts = {split: len(part) for split, part in splits.items()}
    return f'{output_path}: a dataset of {counts} records of {folder}; scores cannot be decoded'


def _up_axis(data: full_space.FullSpaceData, bounds) -> tuple[int | None, str | None]:
    """The axis that the data state, or else the one that they show; and how that is known."""
    if data.up_axis is not None:
        return data.up_axis, None
    up, reason = full_space.find_up_axis(data, bounds) if bounds else (None, 'it has no bounds')
    return up, reason if up is None else f'{AXES[up]} is taken for the upward axis: {reason}'


def _lacking(data: full_space.FullSpaceData, up: int | None, reason: str | None) -> dict[str, str]:
    """Flags that somebody has to give, and what each says."""
    lacking = {}
    if data.dt is None:
        lacking['--dt=SECONDS'] = 'its time step: give --dt, seconds a frame'
    if up is None:
        lacking['--up_axis=0|1|2'] = (
            f'which axis points up, and it cannot be inferred ({reason}): give --up_axis=0, 1 or 2'
        )
    return lacking


def explain(folder: str) -> str:
    """Returns what a folder is and what to do with it, with the flags that it surely needs; raises
    as `import_data`. No run is read: where there are bounds the upward axis may follow from all of
    them."""
    kind = formats.detect(folder)
    if kind in formats.NO_IMPORT:
        return formats.NO_IMPORT[kind].format(folder=folder)
    data = formats.FORMATS[kind].read(folder)
    lacking = _lacking(data, *((0, None) if data.bounds else _up_axis(data, None)))
    command_line = ' '.join([f'lts import {folder} --output_path=RAW', *lacking])
    return f'{folder}: this is {formats.FORMATS[kind].TITLE}; to use it: {command_line}'


def _scaled(
    runs: Iterator[dict[str, Any]], length: float, force: float
) -> Iterator[dict[str, Any]]:
    for run in runs:
        for key, factor in (('positions', length), ('rigid_positions', length), ('force', force)):
            if key in run and factor != 1.0:
                run[key] = run[key] * np.float64(factor)
        yield run


def _three_bounds(bounds: list[list[float]] | None, scale: float) -> list[list[float]] | None:
    """Bounds of three axes; a plane gets a third one that holds 0."""
    if bounds is None:
        return None
    scaled = [[scale * low, scale * high] for low, high in bounds]
    half = 0.5 * max(high - low for low, high in scaled)
    return scaled + [[-half, half]] * (3 - len(scaled))


def define_flags() -> None:
    flags.DEFINE_string(
        'output_path', None, 'Folder of the new raw runs; without it the data are only named.'
    )
    flags.DEFINE_float('dt', None, 'Seconds per frame, where the data do not say or say it wrong.')
    flags.DEFINE_integer('up_axis', None, 'Axis against gravity: 0, 1 or 2.')
    flags.DEFINE_enum(
        'body', None, RIGID_MOTIONS, 'What is known of the motion of the body; default by type.'
    )
    flags.DEFINE_string('name', None, 'Name of the scene. Default: that of the folder.')
    flags.DEFINE_float('length_scale', 1.0, 'Factor that makes metres of their lengths.')
    flags.DEFINE_float('force_scale', 1.0, 'Factor that makes newtons of their forces.')
    flags.DEFINE_bool(
        'check_units', True, 'Refuse positions and dt that are implausible in metres and seconds.'
    )


def main(values, arguments: Sequence[str]) -> None:
    if values.output_path is None:
        print(explain(arguments[0]))
        return
    names = ('dt', 'up_axis', 'body', 'name', 'length_scale', 'force_scale', 'check_units')
    options = {name: values[name].value for name in names}
    print(import_data(arguments[0], values.output_path, **options))


if __name__ == '__main__':
    define_flags()
    command.start_quietly(main, 1, 'lts import FOLDER --output_path=RAW')
