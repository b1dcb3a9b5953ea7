"""The loads on the body, side by side: the force, N, and behind it, where a model predicts it, the
torque about the body's reference point, N m.

Inside a model they are one output; whoever hands them out splits them.
"""

import numpy as np

from learning_to_simulate.normalization import Statistics

NAMES = 'force', 'torque'


def scales(statistics: Statistics) -> list[tuple[np.ndarray, np.ndarray]]:
    """Mean and spread of each load that is predicted, float64 [D] (of several bodies [B D])."""
    pairs = ((getattr(statistics, f'{n}_mean'), getattr(statistics, f'{n}_std')) for n in NAMES)
    return [pair for pair in pairs if pair[0] is not None]


def scale(statistics: Statistics) -> tuple[np.ndarray, np.ndarray]:
    """Mean and spread of the loads side by side, float64 [F]; F is 0 where none is predicted."""
    empty = np.zeros(0)
    mean, std = zip((empty, empty), *scales(statistics))
    return np.concatenate(mean), np.concatenate(std)


def split(values, statistics: Statistics):
    """The force [..., D] and the torque [..., D] of loads [..., F]; None for what is not there."""
    if values is None or statistics.torque_mean is None:
        return values, None
    size = len(statistics.force_mean)
    return values[..., :size], values[..., size:]
