"""Whether a method knows how sure it is: a bound of each frame, fitted on valid, judged on test.

The seeds of a method differ where the data do not tell. The bound of a frame is a constant, a share
of their spread and a share of what is predicted, as a swept field's own (`swept_field.quality`);
of a method of one seed, the constant and that size. It is fitted so that 95 % of the frames
of nine of ten runs keep it, on runs like those of valid.
"""

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.methods.swept_field import quality

UNITS = {'soil': 'mm', 'force': 'N'}


def run_signs(predictions: list, truth) -> dict:
    """Errors of one run and what they are told by.

    Args:
      predictions: `RunPrediction` of each seed.
      truth: `Truth` of the run.

    Returns:
      quantity -> (errors [F] of the mean over seeds, spreads [F], sizes [F]), in `UNITS`; of the
      quantities that the method and the data have.
    """
    found, start, frames = {}, truth.soil.start, truth.soil.frames - H
    soil = [p for p in (p.soil(truth) for p in predictions) if p is not None]
    if soil:
        found['soil'] = _signs(1e3 * (np.stack(soil) - start), 1e3 * (truth.soil.particles - start))
    if truth.force is not None and all(p.force is not None for p in predictions):
        force = np.stack([p.force[frames] for p in predictions])
        found['force'] = _signs(force, truth.force[frames])
    return found


def _signs(predicted, truth):
    """Of predictions [M, F, ...] and their truth [F, ...]."""
    off = (predicted.mean(axis=0) - truth)[None]
    return quality.size(off), quality.spread(predicted), quality.size(predicted)


def judged(runs: dict, quantity: str) -> dict | None:
    """The bound of one quantity of one method, and whether it holds.

    Args:
      runs: split -> what `run_signs` says of the quantity, by run.
      quantity: of `UNITS`.

    Returns:
      `weights` of the constant, spread and size; `bound` and `error`, means over the frames of
      test; `within`, the share of these that keep their bound; `runs_within`, the share of
      the runs of which 95 % do; `curve`, see `quality.reliability`. None where a prediction is not
      finite or a split has no run.
    """
    fitted, seen = runs['valid'], runs['test']
    if not (fitted and seen) or not all(np.isfinite(run).all() for run in [*fitted, *seen]):
        return None
    weights = quality.calibrate(fitted, quantity)
    limits = [quality.bound(spreads, sizes, weights) for _, spreads, sizes in seen]
    kept = [errors <= limit for (errors, _, _), limit in zip(seen, limits, strict=True)]
    enough = [one.mean() >= quality.FRAMES_WITHIN for one in kept]
    return {
        'weights': weights,
        'bound': float(np.concatenate(limits).mean()),
        'error': float(np.concatenate([errors for errors, _, _ in seen]).mean()),
        'within': float(np.concatenate(kept).mean()),
        'runs_within': float(np.mean(enough)),
        'curve': quality.reliability(seen, weights),
    }
