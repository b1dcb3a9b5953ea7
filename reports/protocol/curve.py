"""What a training logged of valid at its checkpoints, and whether that had become flat."""

import glob
import os

import numpy as np

from learning_to_simulate import command

_NAMES = {'rollout_error_mse': 'soil_mse', 'force_error_mse': 'force_mse'}


def of_training(model_path: str) -> list[dict]:
    """What the training logged of valid: [{step, soil_mse, force_mse}], by step.

    Steps that were trained twice, after a training was killed, count as they were last. Empty for a
    method that is fitted at once.
    """
    command.import_tensorflow()
    import tensorflow as tf

    found: dict[int, dict] = {}
    for path in sorted(glob.glob(os.path.join(model_path, 'events.*'))):
        for event in tf.compat.v1.train.summary_iterator(path):
            for value in event.summary.value:
                if value.tag in _NAMES:
                    number = float(tf.make_ndarray(value.tensor))
                    row = found.setdefault(event.step + 1, {'step': event.step + 1})
                    row[_NAMES[value.tag]] = number if np.isfinite(number) else None
    return [found[step] for step in sorted(found)]


def change(points: list[dict], key: str) -> float | None:
    """Mean over the last quarter of the checkpoints, over that of the quarter before; None where
    one of them has no number, or there are fewer than four."""
    n = len(points) // 4
    known = [row[key] for row in points[-2 * n :] if n and row.get(key) is not None]
    return float(np.mean(known[n:]) / np.mean(known[:n])) if n and len(known) == 2 * n else None
