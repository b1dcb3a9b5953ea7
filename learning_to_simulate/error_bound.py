"""A bound of the error of an ensemble, frame by frame.

Members that were trained alike differ where the data do not tell, and the error grows with what is
predicted. How much, is measured on valid: the bound of a frame is a weighted sum of a constant, the
spread sigma over members and the size mu of what is predicted,

    bound = a_0 + a_1 sigma + a_2 mu,                                                           (1)

which 95 % of the frames of a run keep, for 9 of 10 runs like those of valid.
"""

import math

import numpy as np

FRAMES_WITHIN, RUNS_WITHIN = 0.95, 0.9
# How sure it is that so many of all further runs keep a bound, where there are runs enough to say;
# how many runs of a kind have a bound of their own.
SURE, ENOUGH = 0.8, 9
LEAST = 3.0  # N: what any frame may be wrong by, however small all that is predicted


def bound(spreads, sizes, weights) -> np.ndarray:
    """(1) [F] of spreads and sizes [F] and weights [3]."""
    return _signs(spreads, sizes) @ np.asarray(weights)


def calibrate(runs, kinds=None) -> list[float]:
    """The weights of a bound, of valid runs, each (errors [F], spreads [F], sizes [F]), and their
    kinds as of `of_runs`.

    A non-negative fit of the errors, each run counting alike, scaled by a conformal prediction over
    runs (Vovk et al. 2005, Algorithmic Learning in a Random World), since the frames of one run are
    alike: the score of a run is the factor that 95 % of its frames need.
    """
    from scipy import optimize  # a live step does not load it

    signs = np.concatenate([_signs(s, z) for _, s, z in runs])
    errors = np.concatenate([e for e, _, _ in runs])
    share = np.concatenate([np.full(len(e), 1.0 / len(e)) for e, _, _ in runs])
    weights, _ = optimize.nnls(np.sqrt(share)[:, None] * signs, np.sqrt(share) * errors)
    weights[0] = max(weights[0], LEAST)
    scores = [
        np.quantile(e / (_signs(s, z) @ weights), FRAMES_WITHIN, method='higher')
        for e, s, z in runs
    ]
    return (of_runs(scores, kinds) * weights).tolist()


def of_runs(scores, kinds=None) -> float:
    """The score that 9 of 10 further runs do not exceed.

    Of n scores in their order it is number k. With k = 0.9 (n + 1) a further run, exchangeable with
    them, keeps it with a probability of at least 0.9 (conformal); but with these very n runs the
    share that keeps it is often less. So k is the least with which that share is at least 0.9 with
    a probability of `SURE` (Wilks 1941, Ann. Math. Stat. 12): of k of n, the binomial of n and 0.9
    lies below k. With too few runs for that it is the largest.

    The result is no less than that of any kind of which there are `ENOUGH` runs, since nobody says
    in use of which kind a run is; kinds are None where all are of one.
    """
    scores = [float(score) for score in scores]
    kinds = [''] * len(scores) if kinds is None else list(kinds)
    groups = [[s for s, k in zip(scores, kinds, strict=True) if k == kind] for kind in set(kinds)]
    return max(map(_of_kind, [scores, *(g for g in groups if len(g) >= ENOUGH)]))


def _of_kind(scores):
    from scipy import stats  # a live step does not load it

    ordered, n = sorted(scores), len(scores)
    for k in range(min(math.ceil(RUNS_WITHIN * (n + 1)), n), n):
        if stats.binom.cdf(k - 1, n, RUNS_WITHIN) >= SURE:
            return ordered[k - 1]
    return ordered[-1]


def _signs(spreads, sizes):
    return np.stack([np.ones_like(spreads), spreads, sizes], axis=-1)
