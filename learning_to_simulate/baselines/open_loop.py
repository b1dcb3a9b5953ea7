"""Methods that feed nothing back: every frame follows from the known motion alone.

The baselines of the protocol are of this kind. They take the same `RunGroup`s as the networks and
answer with the same frames and nodes, so that one evaluation judges all of them.
"""

from typing import NamedTuple

import numpy as np

from learning_to_simulate import metrics
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.scene import RigidMotion

SOIL, FORCE, HEIGHT = 'soil', 'force', 'height'  # outputs; the height is that of a driven body


class Prediction(NamedTuple):
    """Predicted frames H .. T - 1 of S runs."""

    position: np.ndarray  # float64 [S, T - H, V, D], m; what is not predicted stays still
    force: np.ndarray | None  # float64 [S, T - H, D], N


def held_position(group, scene, height=None) -> np.ndarray:
    """Positions [S, T - H, V, D] of soil that stays still and of the body as it is known.

    Args:
      group: `RunGroup` of S runs.
      scene: says what of the body's motion is given.
      height: [S, T - H] predicted height of a driven body's mean particle, m; None: it is held.
    """
    n_frame = group.position.shape[1] - H
    position = metrics.stay_still(group.position[:, :H], n_frame)
    body = group.position[:, H:, : group.n_rigid].copy()
    if scene.rigid_motion == RigidMotion.DRIVEN:
        up = scene.up_axis
        centre = body[..., up].mean(axis=2)
        if height is None:
            height = group.position[:, H - 1 : H, : group.n_rigid, up].mean(axis=2)
        body[..., up] += (height - centre)[:, :, None]
    if scene.rigid_motion.is_known:
        position[:, :, : group.n_rigid] = body
    return position
