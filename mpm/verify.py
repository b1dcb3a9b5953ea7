"""Checks of the solver with numbers, as a table.

Examples:
    python -m mpm.verify --list_rows
    python -m mpm.verify --raw_path=raw --json=verify.json
    python -m mpm.verify --rows=free_fall,momentum

Each row is written to JSON when it is made; the same command goes on with those that are absent.
Runs that a row needs are read from RAW_PATH/excavation and RAW_PATH/wheel; those that are not
there are simulated into it (about two minutes each). All rows take an hour and a half of one core.
The exit code is 1 if a check fails.
"""

import os
import sys
from functools import partial

from absl import app, flags, logging
from tqdm import tqdm

from mpm.scenes import EXCAVATION, FRAMES, SCENES, WHEEL
from mpm.verification import convergence, density, kernel_rows, run_rows
from mpm.verification.rows import Table

_RAW_PATH = flags.DEFINE_string(
    'raw_path', os.path.join('outputs', 'verify'), 'Folder with the raw runs of both scenes.'
)
_JSON = flags.DEFINE_string(
    'json', os.path.join('outputs', 'verify.json'), 'Where rows are kept; those there are not made.'
)
_ROWS = flags.DEFINE_list('rows', None, 'Only these rows, by name (see --list_rows).')
_LIST = flags.DEFINE_bool('list_rows', False, 'Only name the rows.')

HALVED_CASES = (186, 78, 146, 22, 188)  # motion 2: the blade is in the soil from the beginning
SHORT_CUT_CASES = (186, 78, 123, 146)
DENSITY_CASES = (186, 123, 146)
WHEEL_CASES = (122, 203)
DRIVEN = FRAMES - 1
SHORT_CUT_FRAMES = 160
COLUMN_ASPECTS = (0.5, 1.0, 2.0, 3.0, 5.0)  # height over length


def rows_of(raw_path: str) -> dict:
    """Returns name -> function that makes the checks of that name, those that cost least first."""
    rows = {
        'free_fall': kernel_rows.free_fall,
        'shear': kernel_rows.shear,
        'momentum': kernel_rows.momentum,
        'incline_flow': kernel_rows.incline_flow,
        'incline_exchange': kernel_rows.incline_exchange,
        'incline_halt': kernel_rows.incline_halt,
    }
    for aspect in COLUMN_ASPECTS:
        rows[f'column_{aspect:g}'] = partial(kernel_rows.column, aspect)
    for scene in SCENES.values():
        rows[f'packing_{scene.name}'] = partial(run_rows.packed_soil, scene, raw_path)
    frames = convergence.HALVED_FRAMES
    for case in HALVED_CASES:
        rows[f'halved_{case}'] = partial(convergence.halved_step, EXCAVATION, case, frames)
    for case in run_rows.EARTHMOVING_CASES:
        rows[f'earthmoving_{case}'] = partial(run_rows.earthmoving_case, case, raw_path)
    for case in run_rows.SAW_TOOTH_CASES:
        rows[f'saw_tooth_{case}'] = partial(run_rows.saw_tooth_case, case, raw_path)
    rows['press_rate'] = run_rows.press_rate
    rows['set_down'] = run_rows.set_down
    rows['depth_exponent'] = partial(run_rows.depth_exponent, raw_path)
    rows['wheel_slip'] = partial(run_rows.wheel_slip, raw_path)
    rows['wheel_load'] = partial(run_rows.wheel_load, raw_path)
    for scene in SCENES.values():
        rows[f'leak_{scene.name}'] = partial(run_rows.leak, scene, raw_path)
    for case in DENSITY_CASES:
        rows[f'density_{case}'] = partial(density.moved_soil, case, DRIVEN)
    for option in convergence.SHORT_CUTS:
        for case in SHORT_CUT_CASES:
            rows[f'{option}_{case}'] = partial(
                convergence.short_cut, option, EXCAVATION, case, SHORT_CUT_FRAMES
            )
        rows[f'{option}_wheel_122'] = partial(
            convergence.short_cut, option, WHEEL, 122, SHORT_CUT_FRAMES
        )
    for case in WHEEL_CASES:
        rows[f'halved_wheel_{case}'] = partial(
            convergence.halved_step, WHEEL, case, SHORT_CUT_FRAMES
        )
    return rows


def run_rows_of(raw_path: str, path: str, names: list[str] | None) -> Table:
    """Makes the rows that a table does not hold yet; returns it.

    Raises:
        ValueError: an unknown name, or a file that is no table of this solver.
        OSError: if the disk is full.
    """
    rows = rows_of(raw_path)
    unknown = sorted(set(names or ()) - set(rows))
    if unknown:
        raise ValueError(f'unknown rows {unknown}; there are {", ".join(rows)}')
    os.makedirs(os.path.dirname(path) or '.', exist_ok=True)
    table = Table(path)
    with tqdm(names or list(rows), unit='row') as bar:
        for name in bar:
            bar.set_description(name)
            table.add(name, rows[name])
    return table


def main(argv):
    if len(argv) > 1:
        raise app.UsageError(f'unknown arguments: {argv[1:]}')
    if _LIST.value:
        print('\n'.join(rows_of(_RAW_PATH.value)))
        return
    try:
        table = run_rows_of(_RAW_PATH.value, _JSON.value, _ROWS.value)
    except (ValueError, OSError) as error:
        logging.error('%s', error)
        sys.exit(1)
    print(table.text())
    count = sum(len(entry['checks']) for entry in table.entries.values())
    seconds = sum(entry['cpu_s'] for entry in table.entries.values())
    print(f'{count - len(table.failed)} of {count} checks pass; {seconds:.0f} s of CPU')
    if table.failed:
        print('failed: ' + '; '.join(table.failed))
        sys.exit(1)


if __name__ == '__main__':
    app.run(main)
