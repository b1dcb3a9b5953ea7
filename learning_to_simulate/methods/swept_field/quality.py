"""How far a prediction can be trusted: ranges of the training paths, and spread over members.

Members of a field that were trained alike differ where the data do not tell. Their spread says
which frames are uncertain; how large the error then is, is measured on valid: `bound` is what 95 %
of its frames keep.
"""

import numpy as np

from learning_to_simulate.methods.swept_field import tool_path
from learning_to_simulate.rollout_status import Judgement, RolloutStatus

CONFIDENCE = 0.95
# Share of its training range by which a scalar may leave it.
MARGIN = 0.05
# What any frame may be wrong by, however much the members agree: mm of soil, N of force.
FLOORS = {'soil': 0.2, 'force': 3.0}


def spread(values) -> np.ndarray:
    """Root mean square [T] of the standard deviation over members of values [M, T, ...]."""
    std = np.asarray(values, np.float64).std(axis=0)
    return np.sqrt((std**2).mean(axis=tuple(range(1, std.ndim))))


def calibrate(errors, spreads, kind: str) -> float:
    """The factor by which spreads plus the floor bound `CONFIDENCE` of the errors.

    Args:
      errors, spreads: [F] of frames of valid.
      kind: of `FLOORS`, whose unit both have.
    """
    return float(np.quantile(errors / (spreads + FLOORS[kind]), CONFIDENCE))


def bound(spreads, factor: float, kind: str):
    """What the error of a frame is expected to keep, in 95 % of frames like those of valid."""
    return factor * (np.asarray(spreads) + FLOORS[kind])


def reliability(errors, spreads, factor: float, kind: str, n_bin: int = 5) -> list[dict]:
    """Share of frames within their bound, in `n_bin` groups of equal size by that bound."""
    limits = bound(spreads, factor, kind)
    order = np.argsort(limits)
    return [
        {
            'bound': float(limits[part].mean()),
            'error': float(np.asarray(errors)[part].mean()),
            'within': float((np.asarray(errors)[part] <= limits[part]).mean()),
        }
        for part in np.array_split(order, n_bin)
        if len(part)
    ]


def judge(scalars, ranges: dict, first: int = 0, finite: bool = True) -> Judgement:
    """The status of a path.

    Args:
      scalars: [T, len(SCALARS)] of its frames.
      ranges: of the training paths.
      first: number of its first frame.
      finite: whether all that was predicted is.

    Returns:
      OK: finite, and all scalars within their training ranges, widened by `MARGIN` of themselves
      and by rounding; the error is then what `bound` says. EXTRAPOLATING: the first frame that is
      not.
    """
    if not finite:
        return Judgement(RolloutStatus.NON_FINITE, first, -1, 'a prediction is not finite')
    bad, low, high = _outside(scalars, ranges)
    if not bad.any():
        return Judgement(RolloutStatus.OK)
    frame, which = (int(i) for i in np.argwhere(bad)[0])
    return Judgement(
        RolloutStatus.EXTRAPOLATING,
        first + frame,
        -1,
        f'{tool_path.SCALARS[which]} {scalars[frame, which]:.4g} is outside '
        f'[{low[which]:.4g}, {high[which]:.4g}] of training',
    )


def statuses(scalars, ranges: dict, finite) -> list[RolloutStatus]:
    """The status of each frame alone; arguments as of `judge`, `finite` bool [T]."""
    found = np.where(_outside(scalars, ranges)[0].any(axis=1), 1, 0)
    kinds = (RolloutStatus.OK, RolloutStatus.EXTRAPOLATING, RolloutStatus.NON_FINITE)
    return [kinds[i] for i in np.where(finite, found, 2)]


def _outside(scalars, ranges):
    """bool [T, S], and the ranges [S] that hold without the margin."""
    low, high = np.array([ranges[name] for name in tool_path.SCALARS]).T
    extra = MARGIN * (high - low) + 1e-6
    return ~((scalars >= low - extra) & (scalars <= high + extra)), low, high
