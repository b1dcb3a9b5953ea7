"""Series of `.vtp`, one point cloud per frame: a `.pvd` per run, or a folder of `.vtp` per run."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator

import numpy as np

from pca_tools.formats.full_space import (
    SOIL_TYPE,
    FullSpaceData,
    FullSpaceRun,
    check_run,
    in_space,
    type_column,
)
from pca_tools.formats.vtp_files import (
    read_collection,
    read_points,
    write_collection,
    write_points,
)

NAME = 'vtp'
TITLE = 'a series of VTP files'
_TYPE_NAMES = ('particle_type', 'type', 'tag')
# Times of a .pvd are printed with nine digits.
_EVEN_STEPS = 1e-4


def series_of(folder: str) -> dict[str, list[tuple[float | None, str]]]:
    """Returns run -> (time or None, path) of its frames; empty where the folder holds no series."""
    names = sorted(os.listdir(folder))
    collections = [name for name in names if name.endswith('.pvd')]
    if collections:
        return {
            name.removesuffix('.pvd'): read_collection(os.path.join(folder, name))  # type: ignore[misc]
            for name in collections
        }
    series = {name: _frames(os.path.join(folder, name)) for name in names}
    series = {name: frames for name, frames in series.items() if frames}
    own = _frames(folder)
    return {os.path.basename(os.path.abspath(folder)): own} if own else series  # type: ignore[dict-item, return-value]


def _frames(folder: str) -> list[tuple[None, str]]:
    """Returns the `.vtp` of a folder by the last number in their names."""
    if not os.path.isdir(folder):
        return []
    names = [name for name in os.listdir(folder) if name.endswith('.vtp')]

    def number(name: str) -> tuple[int, str]:
        found = re.findall(r'\d+', name)
        return (int(found[-1]) if found else -1, name)

    return [(None, os.path.join(folder, name)) for name in sorted(names, key=number)]


def read(folder: str, dt: float | None = None) -> FullSpaceData:
    """Opens a folder; `dt` is needed where no `.pvd` gives the times."""
    series = series_of(folder)
    dts = {name: _dt(name, [time for time, _ in frames]) for name, frames in series.items()}
    stated = sorted({dt for dt in dts.values() if dt is not None})
    if len(stated) > 1 and stated[-1] - stated[0] > _EVEN_STEPS * stated[-1]:
        raise ValueError(f'{folder}: runs have different times a frame: {dts}')

    def runs() -> Iterator[FullSpaceRun]:
        for name, frames in series.items():
            yield _run_of(name, [path for _, path in frames])

    return FullSpaceData(
        source=f'{folder} ({TITLE})', runs=runs, dt=dt or (stated[0] if stated else None)
    )


def _dt(name: str, times: list[float | None]) -> float | None:
    if len(times) < 2 or times[0] is None:
        return None
    steps = np.diff(np.array(times, np.float64))
    if np.ptp(steps) > _EVEN_STEPS * abs(steps.mean()) or steps.mean() <= 0:
        raise ValueError(f'{name}: its frames are not evenly spaced in time: {steps[:5]}')
    return float(steps.mean())


def _run_of(name: str, paths: list[str]) -> FullSpaceRun:
    frames = [read_points(path) for path in paths]
    counts = sorted({len(points) for points, _, _ in frames})
    if len(counts) != 1:
        raise ValueError(f'{paths[0]}: the frames of its run have {counts} points')
    data, fields = frames[0][1], [field for _, _, field in frames]
    key = next((key for key in _TYPE_NAMES if key in data), None)
    types = type_column(data[key] if key else np.int64(SOIL_TYPE), counts[0], paths[0])
    force = None
    if all('force' in field for field in fields):
        force = np.array([field['force'].ravel() for field in fields])
    split = next((split for split in ('train', 'valid', 'test') if name.startswith(split)), '')
    positions = np.stack([points for points, _, _ in frames])
    return check_run(FullSpaceRun(name, split, positions, types, force), paths[0])


def write(folder: str, data: FullSpaceData) -> None:
    """Writes `<run>.pvd` and `<run>/00000.vtp` and on for every run."""
    for run in data.runs():
        os.mkdir(os.path.join(folder, run.name))
        listed = []
        for index, frame in enumerate(np.asarray(in_space(run.positions), np.float32)):
            time = index * (data.dt or 1.0)
            fields = {'time': np.array([time])}
            if run.force is not None:
                fields['force'] = run.force[index]
            name = f'{run.name}/{index:05d}.vtp'
            types = {'particle_type': run.particle_type.astype(np.int32)}
            write_points(os.path.join(folder, name), frame, types, fields)
            listed.append((time, name))
        write_collection(os.path.join(folder, f'{run.name}.pvd'), listed)
