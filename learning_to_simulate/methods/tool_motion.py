"""The body's motion in the plane of travel, read from its rigid particles.

What a method may know of a body follows from the scene: all of a prescribed one's motion, the turn
and travel of a driven one. Nothing here looks at the height of a driven body after the H given
frames.
"""

import dataclasses

import numpy as np

from learning_to_simulate.scene import RigidMotion

# Particles lower than this share of the body's height make up its lowest row (and likewise above).
_ROW_SHARE = 0.25


@dataclasses.dataclass(frozen=True)
class TravelFrame:
    """Which way a scene drives.

    Attributes:
      axis: horizontal axis of travel.
      sign: +1 or -1, the way along it.
      up: axis against gravity.
    """

    axis: int
    sign: int
    up: int

    @classmethod
    def of(cls, body: np.ndarray, up: int) -> 'TravelFrame':
        """The axis and way of the longest net travel of bodies [S, T, R, D], m."""
        centre = body.mean(axis=2)
        travel = (centre[:, -1] - centre[:, 0]).mean(axis=0)
        axis = int(np.argmax(np.abs(np.where(np.arange(len(travel)) == up, 0.0, travel))))
        return cls(axis, 1 if travel[axis] >= 0 else -1, up)

    def plane(self, points: np.ndarray) -> np.ndarray:
        """[..., 2] coordinates u (along the travel) and y (up) of points [..., D], m."""
        return np.stack([self.sign * points[..., self.axis], points[..., self.up]], axis=-1)


def blade_pose(body: np.ndarray, frame: TravelFrame) -> tuple[np.ndarray, np.ndarray]:
    """Pose of a flat blade.

    Args:
      body: [S, T, R, D] particles of its face, m.
      frame: the way of travel.

    Returns:
      [S, T, 2] u and y of the middle of its lowest row of particles, m, and [S, T] lean in rad:
      positive where the top lies behind. A body of one row has lean 0.
    """
    points = frame.plane(body)
    height = points[:, 0, :, 1]
    low, high = height.min(axis=1, keepdims=True), height.max(axis=1, keepdims=True)
    share = (height - low) / np.maximum(high - low, 1e-12)
    row, top = (
        np.einsum('strd,sr->std', points, mask / np.maximum(mask.sum(axis=1, keepdims=True), 1.0))
        for mask in ((share <= _ROW_SHARE) * 1.0, (share >= 1 - _ROW_SHARE) * 1.0)
    )
    across = top - row
    flat = (high - low <= 1e-12).reshape(-1, 1)
    return row, np.where(flat, 0.0, np.arctan2(-across[..., 0], np.where(flat, 1, across[..., 1])))


def wheel_pose(body: np.ndarray, frame: TravelFrame):
    """Motion and size of a wheel.

    Args:
      body: [S, T, R, D] particles of its rim, m.
      frame: the way of travel.

    Returns:
      [S, T, 2] u and y of its centre, m; [S, T] angle in rad that it has turned since frame 0,
      positive where it rolls forward; [S] radius and [S] width, m.
    """
    points = frame.plane(body)
    centre = points.mean(axis=2)
    spokes = points - centre[:, :, None]
    # Phase of the first spoke against itself in frame 0, summed over all spokes: an average turn.
    start = spokes[:, :1]
    dot = (spokes * start).sum(axis=(2, 3))
    cross = (spokes[..., 1] * start[..., 0] - spokes[..., 0] * start[..., 1]).sum(axis=2)
    # Rolling towards +u turns the top forwards: clockwise with u to the right and y up.
    turned = -np.unwrap(np.arctan2(cross, dot), axis=1)
    across = [a for a in range(body.shape[-1]) if a not in (frame.axis, frame.up)]
    width = np.ptp(body[:, 0][..., across[0]], axis=1) if across else np.zeros(len(body))
    radius = np.sqrt((spokes[:, 0] ** 2).sum(axis=-1)).mean(axis=1)
    return centre, turned, radius, width


def hidden_height(body: np.ndarray, scene, history: int) -> np.ndarray:
    """Bodies [S, T, R, D] as a method may see them: the height of a driven one is held from the
    last given frame on, its shape and turn are kept."""
    if scene.rigid_motion != RigidMotion.DRIVEN:
        return body
    centre = body[..., scene.up_axis].mean(axis=2)
    known = np.where(np.arange(body.shape[1]) < history, centre, centre[:, history - 1 : history])
    seen = body.copy()
    seen[..., scene.up_axis] += (known - centre)[:, :, None]
    return seen
