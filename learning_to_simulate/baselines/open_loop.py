"""Methods that feed nothing back: every frame follows from the known motion alone.

The baselines of the protocol are of this kind. They take the same `RunGroup`s as the networks and
answer with the same frames and nodes, so that one evaluation judges all of them.
"""

from typing import NamedTuple

import numpy as np

from learning_to_simulate import metrics
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.scene import RigidMotion

SOIL, FORCE, HEIGHT, TORQUE = 'soil', 'force', 'height', 'torque'


class Prediction(NamedTuple):
    """Predicted frames H .. T - 1 of S runs."""

    position: np.ndarray  # float64 [S, T - H, V, D], m; what is not predicted stays still
    force: np.ndarray | None  # float64 [S, T - H, D], N
    # Which of SOIL, FORCE, HEIGHT (of a driven body), TORQUE the method says anything of; an error
    # of the others would be that of persistence.
    predicts: frozenset
    torque: np.ndarray | None = None  # float64 [S, T - H, D], N m about the body's reference point


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


def persistence(group, scene) -> Prediction:
    """Soil, and the height of a driven body, stay as they are in the last given frame; so do force
    and torque."""
    n_frame = group.position.shape[1] - H
    held = {
        name: None if load is None else np.repeat(load[:, H - 1 : H], n_frame, axis=1)
        for name, load in ((FORCE, group.force), (TORQUE, group.torque))
    }
    predicts = frozenset({SOIL, HEIGHT} | {name for name in held if held[name] is not None})
    return Prediction(held_position(group, scene), held[FORCE], predicts, held[TORQUE])


def constant_velocity(group, scene) -> Prediction:
    """Soil, and the height of a driven body, go on as in the last given frame."""
    n_frame = group.position.shape[1] - H
    position = metrics.constant_velocity(group.position[:, :H], n_frame)
    height = position[:, :, : group.n_rigid, scene.up_axis].mean(axis=2) if group.n_rigid else None
    body = held_position(group, scene, height)
    if scene.rigid_motion.is_known:
        position[:, :, : group.n_rigid] = body[:, :, : group.n_rigid]
    return Prediction(position, None, frozenset({SOIL, HEIGHT}))


def mean_force(group, scene, mean, torque=None) -> Prediction:
    """The mean force [D] (N; of several bodies one behind the other) of the training runs in every
    frame, and their mean torque [D] (N m) where there is one; nothing else."""
    shape = (len(group.position), group.position.shape[1] - H, 1)
    force, turn = (
        None if value is None else np.tile(np.asarray(value, np.float64), shape)
        for value in (mean, torque)
    )
    predicts = frozenset({FORCE} if turn is None else {FORCE, TORQUE})
    return Prediction(held_position(group, scene), force, predicts, turn)
