"""Mean errors of runs at constant speed, and of runs driven freely, by method and seed."""

import numpy as np

from reports.protocol import over_runs

QUANTITIES = {'soil_mm': 'soil, mm', 'force_l2': 'force, rel. L2'}
GRID, DRIVEN = 'grid', 'driven'  # kinds of runs: of constant speed, and all others


def condense(document: dict, split: str = 'test') -> dict:
    """Means over the runs of a split, of each method.

    Args:
      document: of `protocol.protocol`.
      split: of it.

    Returns:
      `grid` and `driven` (those there are) -> `runs`, and quantity -> method -> one value a seed.
      Runs whose soil hardly moves count for the force alone, as in the protocol.
    """
    runs = document['runs'][split]
    found: dict[str, dict] = {}
    for kind in (GRID, DRIVEN):
        chosen = [i for i, run in enumerate(runs) if (run['kind'] == GRID) == (kind == GRID)]
        if not chosen:
            continue
        found[kind] = {'runs': len(chosen)} | {q: {} for q in QUANTITIES}
        for quantity in QUANTITIES:
            judged = [
                i for i in chosen
                if quantity != 'soil_mm' or runs[i]['motion_mm'] >= over_runs.QUIET_MM
            ]  # fmt: skip
            for method in document['methods']:
                errors = [[s['runs'][split][i].get(quantity) for i in judged]
                          for s in method['seeds']]  # fmt: skip
                if judged and None not in sum(errors, []):
                    found[kind][quantity][method['name']] = [float(np.mean(e)) for e in errors]
    return found
