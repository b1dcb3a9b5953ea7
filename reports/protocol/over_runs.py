"""Figures over runs and seeds: medians, means, worst, wins, geometric means of ratios.

Runs come first: every figure is made from the errors of single runs, and a mean never stands
without its median, its worst run and the number of runs on which a method beats each baseline.
"""

import math
from collections.abc import Sequence

import numpy as np

# Runs whose soil moves less (root mean square, mm) are listed apart: no method can be ranked there.
QUIET_MM = 1.0
# Errors of a run that are compared, and what tables call them.
QUANTITIES = {
    'soil_mm': 'soil, mm',
    'force_l2': 'force, relative L2',
    'drawbar_l2': 'force along the way, relative L2',
    'height_mm': "body's height, mm",
    'torque_l2': 'torque, relative L2',
    'pitch_l2': 'torque in the plane of travel, relative L2',
}
ALL = 'all'
GRID, DRIVEN = 'grid', 'driven'  # runs of the case grid at constant speed, and all others


def figures(errors: Sequence[float], baselines: dict[str, Sequence[float]]) -> dict:
    """Figures of one method and seed over runs.

    Args:
      errors: one per run, in any unit; NaN or infinite where the method failed.
      baselines: name -> errors of the same runs.

    Returns:
      `runs`, `failed`; `median`, `mean`, `worst` (None where a run failed, but for the median,
      which is None where half of them did); per baseline `wins` (on how many runs the error is
      strictly smaller) and `ratio` (geometric mean over runs of error / baseline's error; None
      where a run failed or an error is 0).
    """
    own, *others = (_or_infinite(values) for values in (errors, *baselines.values()))
    return {
        'runs': len(own),
        'failed': int(np.isinf(own).sum()),
        'median': _known(np.median(own)),
        'mean': _known(own.mean()),
        'worst': _known(own.max()),
        'wins': {name: int((own < theirs).sum()) for name, theirs in zip(baselines, others)},
        'ratio': {name: _mean_ratio(own, theirs) for name, theirs in zip(baselines, others)},
    }


def _or_infinite(errors):
    own = np.array(errors, np.float64)
    return np.where(np.isfinite(own), own, np.inf)


def _mean_ratio(errors, others) -> float | None:
    """exp(mean(log(errors / others))), or None where an error is not finite or not positive."""
    both = np.array([errors, others])
    if not (np.isfinite(both).all() and (both > 0).all()):
        return None
    return float(np.exp(np.mean(np.log(both[0] / both[1]))))


def _known(value):
    return float(value) if math.isfinite(value) else None


def over_seeds(values: Sequence[float | None]) -> dict | None:
    """Mean and range over seeds, and the values; None where a seed has none."""
    known = [float(v) for v in values if v is not None]
    if len(known) < len(values) or not known:
        return None
    return {'mean': float(np.mean(known)), 'low': min(known), 'high': max(known), 'seeds': known}


def median_seed(seeds: Sequence[dict]) -> int:
    """Index of the seed that is shipped: the median of its kind on *valid*.

    Args:
      seeds: as in the document: `runs` -> 'valid' -> errors per run.

    Returns:
      index of the lower median of the mean soil error on valid, of the force's where the method
      says nothing of soil; failed runs are the worst.
    """

    def score(seed):
        for key in QUANTITIES:
            errors = [run[key] for run in seed['runs']['valid'] if key in run]
            if errors:
                mean = float(np.mean([math.inf if e is None else e for e in errors]))
                return math.inf if math.isnan(mean) else mean
        return math.inf

    order = sorted(range(len(seeds)), key=lambda i: (score(seeds[i]), i))
    return order[(len(order) - 1) // 2]


def summarise(document: dict) -> dict:
    """All figures of a document, by split, kind of run, quantity and method.

    Args:
      document: `runs` (split -> facts of every run) and `methods` (name, baseline, seeds).

    Returns:
      split -> kind (and `ALL`) -> quantity -> method -> figures, each with mean and range over
      seeds; wins and ratios by baseline. A baseline with seeds stands as its median seed.
    """
    result = {}
    for split, runs in document['runs'].items():
        kinds = sorted({run['kind'] for run in runs})
        result[split] = {
            kind: _of_kind(
                document['methods'], split, runs,
                [i for i, run in enumerate(runs) if kind in (ALL, run['kind'])],
            )
            for kind in ([ALL] + kinds if len(kinds) > 1 else [ALL])
        }  # fmt: skip
    return result


def condense(document: dict, split: str = 'test') -> dict:
    """Means over the runs of the grid, and over those that are driven freely, of each method.

    Returns:
      `GRID` and `DRIVEN` (those there are) -> `runs`, and quantity -> method -> one value a seed; a
      method of which a run failed is absent.
    """
    runs = document['runs'][split]
    found: dict[str, dict] = {}
    for kind in (GRID, DRIVEN):
        chosen = [i for i, run in enumerate(runs) if (run['kind'] == GRID) == (kind == GRID)]
        if not chosen:
            continue
        found[kind] = {'runs': len(chosen), 'soil_mm': {}, 'force_l2': {}}
        for quantity in ('soil_mm', 'force_l2'):
            judged = _judged(runs, chosen, quantity)
            for method in document['methods']:
                errors = np.array([_errors(s, split, judged, quantity) for s in method['seeds']])
                if judged and np.isfinite(errors).all():
                    found[kind][quantity][method['name']] = errors.mean(axis=1).tolist()
    return found


def _judged(runs, chosen, quantity):
    """Of the chosen runs, those that count: one that hardly moves says nothing of soil, but its
    force is a force."""
    return [i for i in chosen if quantity != 'soil_mm' or runs[i]['motion_mm'] >= QUIET_MM]


def _of_kind(methods, split, runs, chosen):
    result = {}
    for quantity in QUANTITIES:
        judged = _judged(runs, chosen, quantity)
        rows = {
            m['name']: m
            for m in methods
            if any(quantity in run for run in m['seeds'][0]['runs'][split])
        }
        if not judged:
            continue
        baselines = {
            name: _errors(m['seeds'][median_seed(m['seeds'])], split, judged, quantity)
            for name, m in rows.items()
            if m['baseline']
        }
        if rows:
            result[quantity] = {
                name: _with_seeds(
                    [figures(_errors(s, split, judged, quantity), baselines) for s in m['seeds']]
                )
                for name, m in rows.items()
            }
    return result


def _errors(seed, split, judged, quantity):
    values = (seed['runs'][split][i].get(quantity) for i in judged)
    return [math.nan if v is None else v for v in values]


def _with_seeds(rows):
    """Figures of several seeds -> each with mean and range."""
    result = {'runs': rows[0]['runs']}
    for key in ('failed', 'median', 'mean', 'worst'):
        result[key] = over_seeds([row[key] for row in rows])
    for key in ('wins', 'ratio'):
        result[key] = {name: over_seeds([row[key][name] for row in rows]) for name in rows[0][key]}
    return result
