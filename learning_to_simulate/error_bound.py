"""A bound of the error of an ensemble, frame by frame.

Members that were trained alike differ where the data do not tell, and the error grows with what is
predicted. How much, is measured on valid: the bound of a frame is a weighted sum of a constant, the
spread sigma over members and the size mu of what is predicted,

    bound = a_0 + a_1 sigma + a_2 mu,                                                           (1)

which 95 % of the frames of a run keep, for 9 of 10 runs like those of valid.
"""

import numpy as np

FRAMES_WITHIN, RUNS_WITHIN = 0.95, 0.9
LEAST = 3.0  # N: what any frame may be wrong by, however small all that is predicted


def bound(spreads, sizes, weights) -> np.ndarray:
    """(1) [F] of spreads and sizes [F] and weights [3] of `calibrate`."""
    return _signs(spreads, sizes) @ np.asarray(weights)


def calibrate(runs) -> list[float]:
    """The weights of a bound.

    A non-negative fit of the errors, each run counting alike, scaled by a conformal prediction over
    runs (Vovk et al. 2005, Algorithmic Learning in a Random World), since the frames of one run are
    alike: the score of a run is the factor that 95 % of its frames need, and of n such runs the
    factor is the score number 0.9 (n + 1). A further run, exchangeable with them, then has 95 % of
    its frames within with a probability of at least 0.9; with fewer than nine runs, n / (n + 1).

    Args:
      runs: of valid, each (errors [F], spreads [F], sizes [F]).
    """
    from scipy import optimize  # a live step does not load it

    signs = np.concatenate([_signs(s, z) for _, s, z in runs])
    errors = np.concatenate([e for e, _, _ in runs])
    share = np.concatenate([np.full(len(e), 1.0 / len(e)) for e, _, _ in runs])
    weights, _ = optimize.nnls(np.sqrt(share)[:, None] * signs, np.sqrt(share) * errors)
    weights[0] = max(weights[0], LEAST)
    factor = of_runs(
        np.quantile(e / (_signs(s, z) @ weights), FRAMES_WITHIN, method='higher')
        for e, s, z in runs
    )
    return (factor * weights).tolist()


def of_runs(scores) -> float:
    """The score that 9 of 10 further runs do not exceed, of those of n runs; see `calibrate`."""
    ordered = sorted(float(score) for score in scores)
    n = len(ordered)
    return ordered[min(int(np.ceil(RUNS_WITHIN * (n + 1))), n) - 1]


def _signs(spreads, sizes):
    """[F, 3] of what an error grows with."""
    return np.stack([np.ones_like(spreads), spreads, sizes], axis=-1)
