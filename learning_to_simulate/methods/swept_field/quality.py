"""How far a prediction can be trusted: ranges of the training paths, and a bound of the error.

Members of a field that were trained alike differ where the data do not tell, and the error grows
with what is predicted. How much, is measured on valid: the bound of a frame is a weighted sum of a
constant, that spread and that size, which 95 % of the frames of a run keep, for 9 of 10 runs like
those of valid.
"""

import numpy as np
from scipy import optimize

from learning_to_simulate.methods.swept_field import tool_path
from learning_to_simulate.rollout_status import Judgement, RolloutStatus

FRAMES_WITHIN, RUNS_WITHIN = 0.95, 0.9
# Share of its training range by which a scalar may leave it.
MARGIN = 0.05
# What any frame may be wrong by, however small all that is predicted: mm of soil, N of force.
FLOORS = {'soil': 0.3, 'force': 3.0}


def spread(values, xp=np):
    """Root mean square [T] of the standard deviation over members of values [M, T, ...]."""
    std = xp.std(xp.asarray(values, np.float64), axis=0)
    return xp.sqrt(xp.mean(std**2, axis=tuple(range(1, std.ndim))))


def size(values, xp=np):
    """Root mean square [T] of the mean over members of values [M, T, ...]."""
    mean = xp.mean(xp.asarray(values, np.float64), axis=0)
    return xp.sqrt(xp.mean(mean**2, axis=tuple(range(1, mean.ndim))))


def bound(spreads, sizes, weights, xp=np):
    """What the error of a frame is expected to keep; spreads and sizes [F], weights [3] of
    `calibrate`."""
    return xp.dot(_signs(spreads, sizes, xp), np.asarray(weights))


def calibrate(runs, kind: str) -> list[float]:
    """The weights of a bound.

    A non-negative fit of the errors, each run counting alike, scaled by a conformal prediction over
    runs (Vovk et al. 2005, Algorithmic Learning in a Random World), since the frames of one run are
    alike: the score of a run is the factor that 95 % of its frames need, and of n such runs the
    factor is the score number 0.9 (n + 1). A further run, exchangeable with them, then has 95 % of
    its frames within with a probability of at least 0.9; with fewer than nine runs, n / (n + 1).

    Args:
      runs: of valid, each (errors [F], spreads [F], sizes [F]).
      kind: of `FLOORS`, whose unit all have.
    """
    signs = np.concatenate([_signs(s, z) for _, s, z in runs])
    errors = np.concatenate([e for e, _, _ in runs])
    share = np.concatenate([np.full(len(e), 1.0 / len(e)) for e, _, _ in runs])
    weights, _ = optimize.nnls(np.sqrt(share)[:, None] * signs, np.sqrt(share) * errors)
    weights[0] = max(weights[0], FLOORS[kind])
    scores = sorted(
        np.quantile(e / (_signs(s, z) @ weights), FRAMES_WITHIN, method='higher')
        for e, s, z in runs
    )
    factor = scores[min(int(np.ceil(RUNS_WITHIN * (len(runs) + 1))), len(runs)) - 1]
    return (factor * weights).tolist()


def reliability(runs, weights, n_bin: int = 5) -> list[dict]:
    """Share of frames within their bound, in `n_bin` groups of equal size by that bound; runs as of
    `calibrate`."""
    errors, spreads, sizes = (np.concatenate(column) for column in zip(*runs, strict=True))
    limits = bound(spreads, sizes, weights)
    order = np.argsort(limits)
    return [
        {
            'bound': float(limits[part].mean()),
            'error': float(errors[part].mean()),
            'within': float((errors[part] <= limits[part]).mean()),
        }
        for part in np.array_split(order, n_bin)
        if len(part)
    ]


def _signs(spreads, sizes, xp=np):
    """[F, 3] of what an error grows with."""
    return xp.stack([xp.ones_like(spreads), spreads, sizes], axis=-1)


def judge(
    scalars, ranges: dict, first: int = 0, finite: bool = True, names=tool_path.SCALARS
) -> Judgement:
    """The status of a path.

    Args:
      scalars: [T, S] of its frames.
      ranges: of the training paths.
      first: number of its first frame.
      finite: whether all that was predicted is.
      names: S, of the scalars; those of a blade where nothing else is said.

    Returns:
      OK: finite, and all scalars within their training ranges, widened by `MARGIN` of themselves
      and by rounding; the error is then what `bound` says. EXTRAPOLATING: the first frame that is
      not.
    """
    if not finite:
        return Judgement(RolloutStatus.NON_FINITE, first, -1, 'a prediction is not finite')
    bad, low, high = _outside(scalars, ranges, names)
    if not bad.any():
        return Judgement(RolloutStatus.OK)
    frame, which = (int(i) for i in np.argwhere(bad)[0])
    return Judgement(
        RolloutStatus.EXTRAPOLATING,
        first + frame,
        -1,
        f'{names[which]} {scalars[frame, which]:.4g} is outside '
        f'[{low[which]:.4g}, {high[which]:.4g}] of training',
    )


def statuses(scalars, ranges: dict, finite, names=tool_path.SCALARS) -> list[RolloutStatus]:
    """The status of each frame alone; arguments as of `judge`, `finite` bool [T]."""
    found = np.where(_outside(scalars, ranges, names)[0].any(axis=1), 1, 0)
    kinds = (RolloutStatus.OK, RolloutStatus.EXTRAPOLATING, RolloutStatus.NON_FINITE)
    return [kinds[i] for i in np.where(finite, found, 2)]


def _outside(scalars, ranges, names):
    """bool [T, S], and the ranges [S] that hold without the margin."""
    low, high = np.array([ranges[name] for name in names]).T
    least, most = limits(ranges, names)
    return ~((scalars >= least) & (scalars <= most)), low, high


def limits(ranges: dict, names=tool_path.SCALARS) -> np.ndarray:
    """[2, S] least and largest value of each scalar that is not outside."""
    low, high = np.array([ranges[name] for name in names]).T
    extra = MARGIN * (high - low) + 1e-6
    return np.stack([low - extra, high + extra])
