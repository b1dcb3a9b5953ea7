"""Rows of the solver itself on coarser grids, from the JSON of `reports coarse_solver`."""

import os

import numpy as np

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


def means(path: str) -> dict[str, dict]:
    """Name of a coarser solver -> mean over its runs: `soil_mm`, `force_l2`, `ms`; and `runs`.

    Args:
      path: JSON of `reports coarse_solver`.

    Raises:
      FileNotFoundError: no such file.
    """
    found = {}
    for name, runs in files.read_json(path)['runs'].items():
        if name != FINE:
            wanted = ('soil_rms_mm', 'force_relative_l2', 'milliseconds_per_step')
            soil, force, ms = (float(np.mean([run[key] for run in runs])) for key in wanted)
            title = f'{_title(name)} ({len(runs)} runs)'
            found[title] = {'runs': len(runs), 'soil_mm': soil, 'force_l2': force, 'ms': ms}
    return found


def beside(solver_path: str, protocol_path: str, quantity: str, *methods: str) -> str:
    """Errors of the solver on coarser cells beside those of methods, run by run.

    Args:
      solver_path: JSON of `reports coarse_solver`; its runs are test runs of the protocol.
      protocol_path: JSON of `reports.protocol`.
      quantity: 'soil_mm' or 'force_l2'.
      *methods: of the protocol; of one with seeds the mean over them.

    Raises:
      KeyError: a run or a method that the protocol lacks.
    """
    key = {'soil_mm': 'soil_rms_mm', 'force_l2': 'force_relative_l2'}[quantity]
    coarse = {n: runs for n, runs in files.read_json(solver_path)['runs'].items() if n != FINE}
    protocol = files.read_json(protocol_path)
    place = {str(run['case']): i for i, run in enumerate(protocol['runs']['test'])}
    judged = {method['name']: method['seeds'] for method in protocol['methods']}
    cases = [str(run['record']) for run in next(iter(coarse.values()))]
    columns = [
        [float(np.mean([s['runs']['test'][place[c]][quantity] for s in judged[m]])) for c in cases]
        for m in methods
    ] + [[run[key] for run in runs] for runs in coarse.values()]
    lines = [(case, *values) for case, values in zip(cases, zip(*columns), strict=True)]
    lines.append(('**mean**', *(float(np.mean(column)) for column in columns)))
    return markdown.table(('run', *methods, *map(_title, coarse)), lines)


def _title(name):
    return f'solver, cells x {name.removeprefix(f"{FINE}_x")}'


def _point(path, name, runs):
    status = next((run['status'] for run in runs if run['status'] != OK), OK)
    errors = {}
    if name != FINE:
        errors = {
            'soil_mse_full': [run.get('soil_mse') for run in runs],
            'soil_rms_mm_full': [run.get('soil_rms_mm') for run in runs],
            'force_relative_l2': [run.get('force_relative_l2') for run in runs],
        }
    return WorkPrecisionPoint(
        'solver' if name == FINE else _title(name),
        (FAMILY,),
        0,
        f'{os.path.basename(path)} {name}',
        status=status,
        note=f'{len(runs)} test cases, one thread, CPU time',
        runs={'test': errors} if errors else {},
        rollout=Timing(tuple(run['milliseconds_per_step'] for run in runs)),
    )
