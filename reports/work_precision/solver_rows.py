"""Rows of the solver itself on coarser grids, from the JSON of `reports coarse_solver`."""

import os

from pca_tools import files
from reports import markdown
from reports.timing import Timing
from reports.work_precision.points import OK, WorkPrecisionPoint

FAMILY = 'solver on coarser grids'
FINE = 'solver'


def read(path: str) -> list[WorkPrecisionPoint]:
    """The rows as points of the test split: the fine solver (a time, no error), then the coarse.

    Args:
      path: JSON with 'runs': method -> rows with errors in full space and CPU seconds.

    Raises:
      FileNotFoundError, ValueError: no such file, or one of another kind.
    """
    values = files.read_json(path)
    try:
        return [_point(path, name, runs) for name, runs in values['runs'].items()]
    except (KeyError, TypeError, AttributeError, IndexError) as error:
        raise ValueError(f'{path}: not the rows of reports coarse_solver: {error!r}') from error


def per_case(*paths: str) -> str:
    """Every case of the solver on coarser grids: soil error in full space, force, time."""
    header = ('scene', 'cells', 'case', 'soil RMS mm', 'force rel. L2', 'CPU s per simulated s')
    lines = []
    for path in paths:
        values = files.read_json(path)
        for name, runs in values['runs'].items():
            cells = 'fine' if name == FINE else f'x {name.removeprefix(f"{FINE}_x")}'
            lines += [
                (values['scene'], cells, run['record'], run.get('soil_rms_mm'),
                 run.get('force_relative_l2'), run['seconds_per_simulated_second'])
                for run in runs
            ]  # fmt: skip
    return markdown.table(header, lines)


def _point(path, name, runs):
    status = next((run['status'] for run in runs if run['status'] != OK), OK)
    errors = {}
    if name != FINE:
        errors = {
            'soil_mse_full': [run.get('soil_mse') for run in runs],
            'soil_rms_mm_full': [run.get('soil_rms_mm') for run in runs],
            'force_relative_l2': [run.get('force_relative_l2') for run in runs],
        }
    cells = name.removeprefix(f'{FINE}_x')
    return WorkPrecisionPoint(
        'solver' if name == FINE else f'solver, cells x {cells}',
        (FAMILY,),
        0,
        f'{os.path.basename(path)} {name}',
        status=status,
        note=f'{len(runs)} test cases, one thread, CPU time',
        runs={'test': errors} if errors else {},
        rollout=Timing(tuple(run['milliseconds_per_step'] for run in runs)),
    )
