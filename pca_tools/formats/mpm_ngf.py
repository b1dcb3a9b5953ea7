"""MPM-NGF: one folder per case, `<case>/frames/ds_0001.csv` and on.

No header. Row 0 holds the force on the body (x, y, z) in its first columns; each further row is
flag (0 soil, 1 body), x, y, z and more that is not read. A particle whose row is NaN stays where it
was.
"""

import os
import re

import numpy as np

from pca_tools import files
from pca_tools.formats import full_space
from pca_tools.formats.full_space import SOIL_TYPE, FullSpaceData, FullSpaceRun

TITLE = 'MPM-NGF (CSV frames)'
_FRAME = re.compile(r'ds_(\d+)\.csv')


def cases(folder: str) -> dict[str, list[str]]:
    """Returns case -> paths of its frames by their numbers, of those that have frames."""
    found = {}
    for name in sorted(os.listdir(folder)):
        frames = os.path.join(folder, name, 'frames')
        names = os.listdir(frames) if os.path.isdir(frames) else []
        numbered = {int(match[1]): match[0] for match in map(_FRAME.fullmatch, names) if match}
        if numbered:
            found[name] = [os.path.join(frames, numbered[number]) for number in sorted(numbered)]
    return found


def read(folder: str, dt: float | None = None) -> FullSpaceData:
    """Opens a folder; `dt` is needed, the frames do not say it."""
    return FullSpaceData(
        source=f'{folder} ({TITLE})',
        runs=lambda: (_run_of(name, paths) for name, paths in cases(folder).items()),
        dt=dt,
        up_axis=1,
        rigid_motion='prescribed',
        notes=['all runs go to train, valid and test as the converter deals them'],
    )


def _run_of(name: str, paths: list[str]) -> FullSpaceRun:
    positions, forces, flags = [], [], np.empty(0)
    for path in paths:
        rows = _rows(path)
        points = rows[1:, 1:4]
        lost = ~np.all(np.isfinite(points), axis=1)
        if not positions:
            flags = rows[1:, 0]
            if lost.any():
                raise ValueError(f'{path}: the first frame has {lost.sum()} NaN particles')
        elif len(points) != len(flags):
            raise ValueError(f'{path}: has {len(points)} particles, frames before {len(flags)}')
        else:
            points = np.where(lost[:, None], positions[-1], points)
        positions.append(points)
        forces.append(rows[0, :3])
    if not np.all(np.isin(flags, (0, 1))):
        raise ValueError(f'{paths[0]}: the first column must be 0 (soil) or 1 (body)')
    types = np.where(flags == 0, SOIL_TYPE, 3).astype(np.int64)
    force = np.array(forces, np.float32) if np.any(flags == 1) else None
    run = FullSpaceRun(name, '', np.array(positions, np.float32), types, force=force)
    return full_space.check_run(run, paths[0])


def _rows(path: str) -> np.ndarray:
    """Returns [1 + P, 4] numbers of one frame."""
    files.refuse_git_lfs_pointer(path)
    try:
        rows = np.genfromtxt(path, delimiter=',', usecols=range(4), ndmin=2)
    except ValueError as error:
        raise ValueError(f'{path}: is not a table of numbers: {error}') from error
    if len(rows) < 2 or not np.all(np.isfinite(rows[0, :3])):
        raise ValueError(f'{path}: a row with the force and one row per particle were expected')
    return rows


def write(folder: str, data: FullSpaceData) -> None:
    """Writes one folder per run; nine digits, which give every float32 back."""
    for run in data.runs():
        frames = os.path.join(folder, run.name, 'frames')
        os.makedirs(frames)
        for index, points in enumerate(full_space.in_space(run.positions)):
            rows = np.zeros((len(points) + 1, 5))
            rows[0, :3] = 0.0 if run.force is None else run.force[index]
            rows[1:, 0], rows[1:, 1:4] = run.particle_type != SOIL_TYPE, points
            path = os.path.join(frames, f'ds_{index + 1:04d}.csv')
            np.savetxt(path, rows, fmt='%.9g', delimiter=',')
