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
    own = np.array(errors, np.float64)
    failed = int((~np.isfinite(own)).sum())
    own = np.where(np.isfinite(own), own, np.inf)
    wins, ratio = {}, {}
    for name, others in baselines.items():
        theirs = np.array(others, np.float64)
        theirs = np.where(np.isfinite(theirs), theirs, np.inf)
        wins[name] = int((own < theirs).sum())
        ratio[name] = geometric_mean_ratio(own, theirs)
    return {
        'runs': len(own),
        'failed': failed,
        'median': _known(np.median(own)),
        'mean': _known(own.mean()),
        'worst': _known(own.max()),
        'wins': wins,
        'ratio': ratio,
    }


def geometric_mean_ratio(errors, others) -> float | None:
    """exp(mean(log(errors / others))), or None where an error is not finite or not positive."""
    both = np.array([errors, others], np.float64)
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
    return {
        'mean': float(np.mean(known)),
        'low': min(known),
        'high': max(known),
        'seeds': known,
    }


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
            kind: _of_kind(document['methods'], split, runs, kind)
            for kind in ([ALL] + kinds if len(kinds) > 1 else [ALL])
        }
    return result


def _of_kind(methods, split, runs, kind):
    chosen = [i for i, run in enumerate(runs) if kind in (ALL, run['kind'])]
    result = {}
    for quantity in QUANTITIES:
        # A run that hardly moves says nothing of soil, but its force is a force.
        judged = [i for i in chosen if quantity != 'soil_mm' or runs[i]['motion_mm'] >= QUIET_MM]
        rows = {m['name']: m for m in methods if _has(m, split, quantity)}
        if not judged or not rows:
            continue
        baselines = {
            name: _errors(m['seeds'][median_seed(m['seeds'])], split, judged, quantity)
            for name, m in rows.items()
            if m['baseline']
        }
        result[quantity] = {
            name: _with_seeds(
                [
                    figures(_errors(seed, split, judged, quantity), baselines)
                    for seed in method['seeds']
                ]
            )
            for name, method in rows.items()
        }
    return result


def _has(method, split, quantity):
    return any(quantity in run for run in method['seeds'][0]['runs'][split])


def _errors(seed, split, judged, quantity):
    values = (seed['runs'][split][i].get(quantity) for i in judged)
    return [math.nan if v is None else v for v in values]


def _with_seeds(rows):
    """Figures of several seeds -> each with mean and range."""
    result = {'runs': rows[0]['runs'], 'failed': over_seeds([r['failed'] for r in rows])}
    for key in ('median', 'mean', 'worst'):
        result[key] = over_seeds([r[key] for r in rows])
    for key in ('wins', 'ratio'):
        result[key] = {name: over_seeds([r[key][name] for r in rows]) for name in rows[0][key]}
    return result
