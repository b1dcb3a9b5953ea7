"""Best rigid motion between two point sets with known correspondence (Kabsch, by SVD, in float64).

Source: O. Sorkine-Hornung, M. Rabinovich, "Least-squares rigid motion using SVD" (2017); Usmani
(thesis, Concordia 2023), Algorithm 3. The blade is coplanar, so without the determinant fix every
second fit would be a reflection.
"""

from typing import NamedTuple

import numpy as np

MIN_POINTS = 3  # that fix a rotation


class RigidMotion(NamedTuple):
    """Rigid motion `x -> rotation @ x + translation`."""

    rotation: np.ndarray  # float64 [3, 3], always proper (determinant +1)
    translation: np.ndarray  # float64 [3], metres
    residual: float  # root mean square distance in metres between moved source and target points

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Moves points [..., 3] (metres); returns float64 of the same shape."""
        return np.asarray(points, np.float64) @ self.rotation.T + self.translation


def fit_rigid_motion(source: np.ndarray, target: np.ndarray) -> RigidMotion:
    """Finds the rigid motion of `source` [R, 3] (m) onto `target` [R, 3] with least squared
    distance, of at least `MIN_POINTS` finite points; where they lie on a line, the turn about it is
    any."""
    source, target = np.asarray(source, np.float64), np.asarray(target, np.float64)
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    centred_source, centred_target = source - source_mean, target - target_mean
    left, _, right = np.linalg.svd(centred_source.T @ centred_target)
    proper = 1.0 if np.linalg.det(left @ right) >= 0 else -1.0
    rotation = right.T @ np.diag([1.0, 1.0, proper]) @ left.T
    misfit = centred_source @ rotation.T - centred_target
    residual = float(np.sqrt(np.mean(np.sum(misfit**2, axis=1))))
    return RigidMotion(rotation, target_mean - rotation @ source_mean, residual)


def placed(shape: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Places points of a body, x = p + R(q) s (Euler-Rodrigues): float64 [T, R, 3], m, of `shape`
    [R, 3] s, places on the upright body from its reference point (m), and `poses` [T, 7], position
    p (m) and quaternion q (w, x, y, z)."""
    poses = np.asarray(poses, np.float64)
    return poses[:, None, :3] + _turned(np.asarray(shape, np.float64)[None], poses[:, 3:])


def on_body(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Returns where points [R, 3] (m) of a body with pose [7] lie on it: `placed` undone."""
    pose = np.asarray(pose, np.float64)
    back = pose[None, 3:] * [1.0, -1.0, -1.0, -1.0]
    return _turned((np.asarray(points, np.float64) - pose[:3])[None], back)[0]


def _turned(points: np.ndarray, quaternions: np.ndarray) -> np.ndarray:
    """R(q) v = v + 2 w (u x v) + 2 u x (u x v) of q = (w, u), [T, R, 3]."""
    norms = np.linalg.norm(quaternions, axis=-1, keepdims=True)
    unit = (quaternions / np.where(norms > 0, norms, 1.0))[:, None]
    w, u = unit[..., :1], unit[..., 1:]
    across = np.cross(u, points)
    return points + 2.0 * w * across + 2.0 * np.cross(u, across)
