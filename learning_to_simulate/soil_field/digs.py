"""Recorded digs, to which a soil is fitted: from a CSV file, or runs of datasets.

The file has a header line and, in any order, the columns

    [run,] time_s, x_m, y_m, angle_deg [, z_m]           of a tool that moves along x, or
    [run,] time_s, x_m, y_m, z_m, qw, qx, qy, qz         of any pose, and
    force_x_N, force_y_N, force_z_N                      one of them at least

y is up, the force acts on the tool (docs/axes.md). Rows of one run follow each other; the force of
a row is the mean since the row before. A row whose forces are all empty only moves the tool.
"""

import dataclasses
import math

import numpy as np

from learning_to_simulate.soil_field import runs as runs_lib
from learning_to_simulate.soil_field.engine import FASTEST
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Soil, Tool
from pca_tools import dataset
from pca_tools.storage import csv_rows

FORCES = ('force_x_N', 'force_y_N', 'force_z_N')
PLANE, SPACE = ('x_m', 'y_m', 'angle_deg'), ('x_m', 'y_m', 'z_m', 'qw', 'qx', 'qy', 'qz')
SLOWEST_ROWS = 0.25  # s, between two rows
MARGIN = 1.5  # m of flat ground about a path


@dataclasses.dataclass(frozen=True)
class Dig:
    """One recorded way of a tool.

    Attributes:
      name: of the run.
      tool: what went.
      terrain: before it came; of its soil gravity counts alone.
      times: float64 [T], s, ascending.
      pose: float64 [T, 7].
      force: float64 [T, 3] of the soil on the tool, N, world; NaN where it was not measured.
    """

    name: str
    tool: Tool
    terrain: Terrain
    times: np.ndarray
    pose: np.ndarray
    force: np.ndarray


def of_dataset(folders: str, cases: list[str]) -> list[Dig]:
    """Runs of datasets (folders, separated by commas) by their cases, such as soils_0007, with
    drawbar and vertical force, each on its own bed; FileNotFoundError, or ValueError for a case
    that is not in them."""
    found = {}
    for folder in folders.split(','):
        known = dataset.read_metadata(folder).get('cases', {})
        for split, entries in known.items():
            if {str(entry['case']) for entry in entries} & set(cases):
                found |= {run.case: run for run in runs_lib.read(folder, split)}
    if not cases or (lacking := [case for case in cases if case not in found]):
        raise ValueError(
            f'{folders}: name its runs by --cases' if not cases else
            f'{folders}: has no runs {lacking}'
        )  # fmt: skip
    digs = []
    for run in (found[case] for case in cases):
        force = np.array(run.force, np.float64)
        force[0], force[:, 2] = np.nan, np.nan  # the first repeats the second
        times = run.dt * np.arange(len(force))
        digs.append(Dig(run.case, run.tool, run.before(), times, run.pose, force))
    return digs


def read(path: str, tool: Tool, terrain: Terrain | None, surface: float, gravity: float) -> list:
    """The digs of a CSV file: runs of one tool, each begins on the terrain (None: flat ground at a
    surface, m) under a gravity, m/s2.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: missing columns, a cell that is no finite number, times that do not ascend, other
        units, a run of one row; with file and line.
    """
    if not 0 < gravity < math.inf or not math.isfinite(surface):
        raise ValueError(f'gravity is {gravity} m/s2 and the surface at {surface} m')
    digs = []
    for name, lines in _rows(path).items():
        where = f'{path}, run {name}' if name else path
        if len(lines) < 2:
            raise ValueError(f'{where}: has {len(lines)} row, at least 2 are needed')
        numbers = [number for number, _ in lines]
        columns = {key: np.array([row[key] for _, row in lines]) for key in lines[0][1]}
        times, pose = columns['time_s'], _poses(columns, terrain)
        _check(path, numbers, times, pose)
        force = np.stack([columns.get(key, np.full(len(times), np.nan)) for key in FORCES], axis=1)
        ground = _flat(pose, surface, gravity) if terrain is None else terrain
        digs.append(Dig(name or 'run', tool, ground, times - times[0], pose, force))
    if not digs:
        raise ValueError(f'{path}: has no rows')
    return digs


def _rows(path):
    """Name of a run -> its lines, as numbers and their values."""

    def numbers_of(header):
        needed = ('time_s', *(SPACE if 'qw' in header else PLANE))
        lacking = [name for name in needed if name not in header]
        if lacking or not set(FORCES) & set(header):
            lacking = lacking or ['one of ' + ', '.join(FORCES)]
            raise ValueError(
                f'{path}, line 1: lacks {", ".join(lacking)}; found {", ".join(header)}; '
                f'expected [run], time_s, {", ".join(PLANE)} (or {", ".join(SPACE)}), force_x_N'
            )
        return [name for name in ('z_m', *needed, *FORCES) if name in header]

    runs: dict[str, list] = {}
    for number, texts, values in csv_rows.rows(path, numbers_of, may_be_empty=FORCES):
        runs.setdefault(texts.get('run', ''), []).append((number, values))
    return runs


def _poses(columns, terrain):
    if 'qw' in columns:
        return np.stack([columns[name] for name in SPACE], axis=1)
    middle = 0.0
    if terrain is not None:
        middle = float(terrain.corner[1] + terrain.cell[1] * terrain.shape[1] / 2)
    half, zero = np.radians(columns['angle_deg']) / 2, 0.0 * columns['x_m']
    across = columns.get('z_m', zero + middle)
    return np.stack(
        [columns['x_m'], columns['y_m'], across, np.cos(half), zero, zero, np.sin(half)], axis=1
    )


def _check(path, numbers, times, pose):
    def refuse(is_wrong, values, what):
        if is_wrong.any():
            k = int(np.argmax(is_wrong)) - len(is_wrong)  # counted from the end
            raise ValueError(f'{path}, line {numbers[k]}: {what.format(values[k])}')

    steps, norm = np.diff(times), np.linalg.norm(pose[:, 3:], axis=1)
    refuse(steps <= 0, times, 'time_s is {:.6g}; times of a run must ascend')
    far = f'at most {SLOWEST_ROWS} are taken; are these milliseconds?'
    refuse(
        steps > SLOWEST_ROWS, steps, f'time_s comes {{:.4g}} s after that of the row before, {far}'
    )
    speed = np.linalg.norm(np.diff(pose[:, :3], axis=0), axis=1) / steps
    far = f'at most {FASTEST} are taken; are these millimetres?'
    refuse(speed > FASTEST, speed, f'the tool jumps at {{:.4g}} m/s, {far}')
    refuse(np.abs(norm - 1) > 0.01, norm, 'the quaternion has length {:.4g}, not 1')


def _flat(pose, surface, gravity):
    low, high = (f(pose[:, [0, 2]], axis=0) for f in (np.min, np.max))
    return Terrain.flat(
        high - low + 2 * MARGIN, surface, corner=low - MARGIN, soil=Soil(gravity=gravity)
    )
