"""How far a prediction can be trusted: what training knew, and a bound of the error.

A frame is judged by numbers, each within limits: the scalars of the path, which training had within
some range, and `CONDITIONS`, which all of training had as they should be and which no network sees:
whether the tool stands upright in the plane of travel, over the middle of the bed, on a bed of
usual heights, in frames of a usual length. In the air all conditions are free.

Members of a field that were trained alike differ where the data do not tell, and the error grows
with what is predicted. How much, is measured on valid: the bound of a frame is a weighted sum of a
constant, the spread sigma over members and the size mu of what is predicted (docs/swept_field.md),

    bound = a_0 + a_1 sigma + a_2 mu,                                                           (15)

which 95 % of the frames of a run keep, for 9 of 10 runs like those of valid.
"""

import numpy as np

from learning_to_simulate.rollout_status import Ranges

FRAMES_WITHIN, RUNS_WITHIN = 0.95, 0.9
# Share of its training range by which a scalar may leave it.
MARGIN = 0.05
# What any frame may be wrong by, however small all that is predicted: mm of soil, N of force.
FLOORS = {'soil': 0.3, 'force': 3.0}
# What no network sees: name -> (least, most). The tool's rotation out of the plane of travel, rad
# (2 degrees); its distance from the middle plane of the bed, m (particles are about so far apart);
# speed across over speed; lowest and highest place of the bed from its level, m (cuts and heaps of
# training, rounded up); duration of a frame, s (twice the shortest memory of the velocity).
CONDITIONS = {
    'yaw': (-0.035, 0.035),
    'roll': (-0.035, 0.035),
    'aside': (-0.02, 0.02),
    'drift': (0.0, 0.05),
    'bed_low': (-0.15, 0.15),
    'bed_high': (-0.15, 0.15),
    'frame_time': (0.0, 0.1),
}
# What ranges hold at least, and models may leave out; `pressed` is (20) of `tool.blade`, m.
USUAL = CONDITIONS | {'pressed': (0.0, 0.02)}
# Below this speed (m/s) a drift is a share of it: a tool that stands may tremble.
LEAST_SPEED = 0.04


def limits_of(ranges: dict, scalars) -> Ranges:
    """What frames of a field are judged by: scalars, then `CONDITIONS`.

    Args:
      ranges: name -> (low, high) of a model; those of `USUAL` it may leave out.
      scalars: names. Their ranges are widened by `MARGIN` of themselves, all by rounding.

    Raises:
      KeyError: a scalar has no range.
    """
    names = (*scalars, *CONDITIONS)
    low, high = np.array([(USUAL | ranges)[name] for name in names], float).T
    is_scalar = np.arange(len(names)) < len(scalars)
    extra = np.where(is_scalar, MARGIN * (high - low), 0.0) + 1e-6
    return Ranges(names, low, high, np.stack([low - extra, high + extra]))


def conditions(axes, pose, before, dt, frames, in_soil) -> np.ndarray:
    """Scalars and `CONDITIONS` [T, J] of frames, as `Ranges` judges them.

    Args:
      axes: of the scene.
      pose: [T, 7] of the tool, world.
      before: [T, 7] likewise, one frame before; its own pose in a first frame.
      dt: s, a number or [T].
      frames: `swept.Frame` of them; its bins' second channel is the surface from the level.
      in_soil: bool [T]: whether the tool may touch soil; where not, conditions are 0.
    """
    pose, before = np.asarray(pose, float), np.asarray(before, float)
    turned = axes.sideways(pose)
    step = axes.points(pose[:, :3]) - axes.points(before[:, :3])
    way = np.hypot(step[:, 0], step[:, 1])
    surface = frames.bins[..., 1]
    found = np.stack(
        [
            *turned.T,
            axes.points(pose[:, :3])[:, 2],
            np.abs(step[:, 2]) / np.maximum(way, LEAST_SPEED * dt),
            surface.min(axis=1),
            surface.max(axis=1),
            np.broadcast_to(dt, len(pose)),
        ],
        axis=1,
    )
    return np.concatenate([frames.scalars, np.where(in_soil[:, None], found, 0.0)], axis=1)


def spread(values) -> np.ndarray:
    """Root mean square [T] of the standard deviation over members of values [M, T, ...]."""
    return _rms(np.std(np.asarray(values, np.float64), axis=0))


def size(values) -> np.ndarray:
    """Root mean square [T] of the mean over members of values [M, T, ...]."""
    return _rms(np.mean(np.asarray(values, np.float64), axis=0))


def _rms(values):
    return np.sqrt(np.mean(values**2, axis=tuple(range(1, values.ndim))))


def bound(spreads, sizes, weights) -> np.ndarray:
    """(15) [F] of spreads and sizes [F] and weights [3] of `calibrate`."""
    return _signs(spreads, sizes) @ np.asarray(weights)


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
    from scipy import optimize  # a live step does not load it

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


def _signs(spreads, sizes):
    """[F, 3] of what an error grows with."""
    return np.stack([np.ones_like(spreads), spreads, sizes], axis=-1)
