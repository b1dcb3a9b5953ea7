"""Whether a method knows how sure it is: a bound of each frame, fitted on valid, judged on test.

The seeds of a method differ where the data do not tell. The bound of a frame is a constant, a share
of their spread and a share of what is predicted, as a swept field's own
(`swept_field.calibration`); of a method of one seed, the constant and that size. It is fitted so
that 95 % of the frames of nine of ten runs keep it, on runs like those of valid.
"""

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.swept_field import calibration

UNITS = {'soil': 'mm', 'force': 'N'}


def run_signs(predictions: list, truth, reader, indices) -> dict:
    """Errors of one run and what they are told by.

    Args:
      predictions: `RunPrediction` of each seed.
      truth: `Truth` of the run.
      reader: `truth.TruthReader`, for decoding.
      indices: int [P] of the truth's particles.

    Returns:
      quantity -> (errors [F] of the mean over seeds, spreads [F], sizes [F]), in `UNITS`; of the
      quantities that the method and the data have.
    """
    found = {}
    soil = [p for p in (_soil(p, truth, reader, indices) for p in predictions) if p is not None]
    if soil:
        found['soil'] = _signs(1e3 * np.stack(soil), 1e3 * (truth.particles - truth.start))
    if truth.force is not None and all(p.force is not None for p in predictions):
        force = np.stack([p.force[truth.frames - H] for p in predictions])
        found['force'] = _signs(force, truth.force[truth.frames - H])
    return found


def _soil(prediction, truth, reader, indices):
    """[F, P, 3] m, how far the particles went."""
    if prediction.particles is not None:
        return prediction.particles(truth.frames, indices) - truth.start
    if prediction.modes is not None:
        return reader.decode(prediction.modes[truth.frames - H], indices) - truth.start
    return None


def _signs(predicted, truth):
    """Of predictions [M, F, ...] and their truth [F, ...]."""
    off = (predicted.mean(axis=0) - truth)[None]
    return calibration.size(off), calibration.spread(predicted), calibration.size(predicted)


def judged(runs: dict, quantity: str) -> dict | None:
    """The bound of one quantity of one method, and whether it holds.

    Args:
      runs: split -> what `run_signs` says of the quantity, by run.
      quantity: of `UNITS`.

    Returns:
      `weights` of the constant, spread and size; `bound` and `error`, means over the frames of
      test; `within`, the share of these that keep their bound; `runs_within`, the share of
      the runs of which 95 % do; `curve`, see `calibration.reliability`. None where a prediction
      is not finite or a split has no run.
    """
    fitted, seen = runs['valid'], runs['test']
    if not (fitted and seen) or not all(np.isfinite(run).all() for run in [*fitted, *seen]):
        return None
    weights = calibration.calibrate(fitted, quantity)
    limits = [calibration.bound(spreads, sizes, weights) for _, spreads, sizes in seen]
    kept = [errors <= limit for (errors, _, _), limit in zip(seen, limits, strict=True)]
    enough = [one.mean() >= calibration.FRAMES_WITHIN for one in kept]
    return {
        'weights': weights,
        'bound': float(np.concatenate(limits).mean()),
        'error': float(np.concatenate([errors for errors, _, _ in seen]).mean()),
        'within': float(np.concatenate(kept).mean()),
        'runs_within': float(np.mean(enough)),
        'curve': calibration.reliability(seen, weights),
    }
