"""How far the ground truth itself is from finer solutions: `mpm/verification/ladder.json`."""

import os

import numpy as np

from mpm.verification import ladder
from pca_tools import files
from reports.record import ROOT

LADDER = os.path.join(ROOT, 'mpm', 'verification', 'ladder.json')
_SCENES = {'blade': 'excavation', 'wheel': 'wheel'}


def errors(tool: str, path: str = LADDER) -> dict:
    """Errors of the solver as it makes the data, over the cases of a tool.

    Args:
      tool: 'blade' or 'wheel'.
      path: of the ladder.

    Returns:
      `cases`; against cells that are a third as long across: `surface_mm` of the whole bed at the
      end and `force_relative_l2` of means over five frames; against the limit of fine cells:
      `drawbar_relative_l2`, of the mean force along the way (upwards where that matters). Each a
      list with a number a case.
    """
    names = 'cases', 'surface_mm', 'force_relative_l2', 'drawbar_relative_l2'
    found: dict = {name: [] for name in names}
    for name, runs in files.read_json(path)['cases'].items():
        if not name.startswith(_SCENES[tool]) or 'cubic' not in runs:
            continue
        compared = ladder.compared(runs['base'], runs['cubic'])
        cells, forces = ladder.over_cells(name, runs)
        base = np.mean(runs['base']['force'], axis=0)[ladder.CASES[name][2]]
        limit = ladder.limit(cells, forces)[0]
        values = name, compared['surface_mm'], compared['force_5_frames'], abs(base / limit - 1.0)
        for column, value in zip(found.values(), values, strict=True):
            column.append(value if isinstance(value, str) else float(f'{value:.4g}'))
    return found
