"""MPM-NGF: one folder per case, `<case>/frames/ds_0001.csv` and on.

No header. Row 0 holds the force on the body (x, y, z) in its first columns; each further row is
flag (0 soil, 1 body), x, y, z and more that is not read. A particle whose row is NaN stays where it
was.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator

import numpy as np

from pca_tools import files
from pca_tools.formats.full_space import (
    SOIL_TYPE,
    FullSpaceData,
    FullSpaceRun,
    check_run,
    in_space,
)

NAME = 'mpm_ngf'
TITLE = 'MPM-NGF (CSV frames)'
_FRAME = re.compile(r'ds_(\d+)\.csv')
_COLUMNS = 4


def cases(folder: str) -> list[str]:
    """Returns the names of the cases in a folder, those with frames."""
    return sorted(
        name
        for name in os.listdir(folder)
        if os.path.isdir(os.path.join(folder, name, 'frames'))
        and frames_of(os.path.join(folder, name, 'frames'))
    )


def frames_of(folder: str) -> list[str]:
    """Returns the paths of the frames in a folder, by their numbers."""
    numbered = {
        int(match[1]): name for name in os.listdir(folder) if (match := _FRAME.fullmatch(name))
    }
    return [os.path.join(folder, numbered[number]) for number in sorted(numbered)]


def read(folder: str, dt: float | None = None) -> FullSpaceData:
    """Opens a folder; `dt` is needed, the frames do not say it."""

    def runs() -> Iterator[FullSpaceRun]:
        for name in cases(folder):
            yield _run_of(name, frames_of(os.path.join(folder, name, 'frames')))

    return FullSpaceData(
        source=f'{folder} ({TITLE})',
        runs=runs,
        dt=dt,
        up_axis=1,
        rigid_motion='prescribed',
        notes=['all runs go to train, valid and test as the converter deals them'],
    )


def _run_of(name: str, paths: list[str]) -> FullSpaceRun:
    positions, forces, flags = [], [], None
    for path in paths:
        rows = _rows(path)
        if flags is None:
            flags = rows[1:, 0]
        if rows.shape[0] != len(flags) + 1:
            raise ValueError(f'{path}: has {len(rows) - 1} particles, frames before {len(flags)}')
        points = rows[1:, 1:4]
        lost = ~np.all(np.isfinite(points), axis=1)
        if lost.any():
            if not positions:
                raise ValueError(f'{path}: the first frame has {lost.sum()} NaN particles')
            points = np.where(lost[:, None], positions[-1], points)
        positions.append(points)
        forces.append(rows[0, :3])
    if not np.all(np.isin(flags, (0, 1))):
        raise ValueError(f'{paths[0]}: the first column must be 0 (soil) or 1 (body)')
    run = FullSpaceRun(
        name,
        '',
        np.array(positions, np.float32),
        np.where(flags == 0, SOIL_TYPE, 3).astype(np.int64),
        force=np.array(forces, np.float32) if np.any(flags == 1) else None,
    )
    return check_run(run, paths[0])


def _rows(path: str) -> np.ndarray:
    """Returns [1 + P, 4] numbers of one frame."""
    files.refuse_git_lfs_pointer(path)
    try:
        rows = np.genfromtxt(path, delimiter=',', usecols=range(_COLUMNS), ndmin=2)
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
        flags = (run.particle_type != SOIL_TYPE).astype(np.float64)
        for index, frame in enumerate(in_space(run.positions)):
            force = np.zeros(3) if run.force is None else run.force[index]
            rows = np.zeros((len(frame) + 1, _COLUMNS + 1))
            rows[0, :3] = force
            rows[1:, 0], rows[1:, 1:4] = flags, frame
            path = os.path.join(frames, f'ds_{index + 1:04d}.csv')
            np.savetxt(path, rows, fmt='%.9g', delimiter=',')
