"""A path of the tool from a CSV file, such as a person's own recording.

The file has a header line and the columns, in any order,

    time_s, x_m, y_m, angle_deg [, z_m] [, load_N]

x and y of the body's reference point (the middle of the blade's round lower edge, the wheel's
axle) in the frame of the scene, whose flat surface lies at y = 0.25 m (excavation) or 0.158 m
(wheel); the angle is counter-clockwise seen with x to the right and y up, so a blade that leans
its top back by 20 degrees has -20. y is not used where the height is free; only there is `load_N`
read (without it the load of the case whose context is used). z is the place across of the middle of
the tool; without it the tool is in the middle of the bin. The first row is the run's time 0;
before it and after the last row the tool rests. A run has 320 frames (5.33 s), more if the file
lasts longer.

Between the rows each column follows a monotone cubic Hermite curve (PCHIP: F. N. Fritsch, J.
Butland 1984, SIAM J. Sci. Stat. Comput. 5, 300): the velocity is continuous and no curve leaves
the range of the two rows beside it, so a path whose rows keep clear of the floor does so in
between.
"""

import os
import re
from dataclasses import dataclass

import numpy as np

from mpm import bodies, scenes
from mpm.motions.drive import Drive, poses, under_load
from mpm.motions.grid import REST_FRAMES
from pca_tools.files import sha256_of_file
from pca_tools.storage import csv_rows

COLUMNS = ('time_s', 'x_m', 'y_m', 'angle_deg')
LOAD, ACROSS = 'load_N', 'z_m'
MAX_ROWS = 1_000_000
# Usual intervals between two rows, from which on rows are taken to be missing.
GAP = 10.0
# Values beyond these are taken for other units.
MAX_PLACE = 2.0  # m
MAX_TIME = 60.0  # s


@dataclass(frozen=True)
class Recording:
    """A run along the path of a file."""

    path: str  # of the CSV file
    like_case: int  # case of the grid whose soil, gravity, wheel and load are used (wheel)
    blade_width: float = bodies.BLADE_WIDTH  # m (excavation)

    @property
    def case(self) -> str:
        """The run's id: 'path_' and the file's name without its ending."""
        stem = os.path.splitext(os.path.basename(self.path))[0]
        return 'path_' + re.sub(r'[^A-Za-z0-9.-]+', '-', stem)


def read_rows(path: str) -> dict[str, np.ndarray]:
    """Reads a file of a path: column name -> float64 [K], K >= 2; the times begin with 0.

    Raises as `csv_rows.rows`. ValueError, with the file and the line: a missing column, a time that
    does not follow or a value in other units.
    """

    def numbers_of(header):
        if lacking := [name for name in COLUMNS if name not in header]:
            raise ValueError(
                f'{path}, line 1: lacks the columns {lacking}; found {header}, expected '
                f'{",".join(COLUMNS)} and perhaps {ACROSS}, {LOAD}'
            )
        return [name for name in header if name in (*COLUMNS, ACROSS, LOAD)]

    rows, lines = [], []
    for line, texts, values in csv_rows.rows(path, numbers_of):
        for name in {'x_m', 'y_m', ACROSS} & values.keys():
            if abs(values[name]) > MAX_PLACE:
                raise ValueError(
                    f'{path}, line {line}: {name} is {texts[name]}, farther than {MAX_PLACE} m '
                    'from the origin; are these millimetres?'
                )
        if len(rows) == MAX_ROWS:
            raise ValueError(f'{path}: has more than {MAX_ROWS} rows')
        rows.append(values)
        lines.append(line)
    if len(rows) < 2:
        raise ValueError(f'{path}: has {len(rows)} rows, at least 2 are needed')
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    times = columns['time_s']
    steps = np.diff(times)
    k, usual = int(np.argmin(steps)), float(np.median(steps))
    if not steps[k] > 0.0:
        raise ValueError(
            f'{path}, line {lines[k + 1]}: time_s is {times[k + 1]:.6g} after {times[k]:.6g}; '
            'times must ascend'
        )
    k = int(np.argmax(steps))
    if steps[k] > GAP * usual:
        raise ValueError(
            f'{path}, lines {lines[k]} to {lines[k + 1]}: a gap of {steps[k]:.4g} s between '
            f'rows that are usually {usual:.4g} s apart; fill it or resample the file'
        )
    columns['time_s'] = times - times[0]
    if (lasts := columns['time_s'][-1]) > MAX_TIME:
        raise ValueError(
            f'{path}, line {lines[-1]}: lasts {lasts:.6g} s, more than {MAX_TIME:g}; are these '
            'milliseconds?'
        )
    return columns


def recorded_drive(
    scene: scenes.Scene, recording: Recording, tool: dict | None = None
) -> tuple[Drive, dict, float]:
    """Returns the drive along the path of a file, its parameters (JSON-compatible), its seconds;
    raises as `read_rows`. Without a tool it is the blade or the wheel that the recording says."""
    from scipy.interpolate import PchipInterpolator  # slow to load, and help does not wait for it

    rows = read_rows(recording.path)
    times = rows['time_s']
    rows.setdefault(ACROSS, np.full(len(times), scene.bin.z_middle))
    curves = [PchipInterpolator(times, rows[name]) for name in (*COLUMNS[1:], ACROSS)]

    def pose(at):
        at = np.clip(np.asarray(at, np.float64), 0.0, times[-1])
        x, y, angle_deg, z = (curve(at) for curve in curves)
        return poses(at, x, y, np.radians(angle_deg), z)

    parameters: dict = {'kind': 'path', 'path_sha256': sha256_of_file(recording.path)}
    if scene.rigid_motion == 'prescribed':
        body, kept = bodies.blade_or(tool, recording.blade_width)
        return Drive(body, pose), parameters | kept, float(times[-1])
    parameters |= scene.parameters(recording.like_case)
    parameters.pop('slip_percent')
    if tool is None:
        body = bodies.make_wheel(parameters['diameter_m'])
    else:
        body = bodies.tool_body(tool)
        parameters |= {'tool': tool, 'diameter_m': 2.0 * tool['radius']}
    usual = np.full(len(times), scenes.wheel_load(parameters))
    load = PchipInterpolator(times, rows.get(LOAD, usual))
    machine = under_load(lambda at: load(np.clip(at, 0.0, times[-1])))
    return Drive(body, pose, machine, rest=REST_FRAMES), parameters, float(times[-1])
