"""Between the world's axes and those of a swept field: along the way, up, across."""

import dataclasses

import numpy as np

from learning_to_simulate.methods.tool_motion import TravelFrame


@dataclasses.dataclass(frozen=True)
class Axes:
    """Axes of a scene.

    Attributes:
      axis: horizontal axis of the world that the tool drives along.
      sign: +1 or -1, the way along it.
      up: axis against gravity.
      middle: coordinate of the bed's middle plane across the way, m.
    """

    axis: int
    sign: int
    up: int
    middle: float

    @property
    def across(self) -> int:
        """The third axis."""
        return 3 - self.axis - self.up

    @property
    def frame(self) -> TravelFrame:
        """As `tool_motion` and `resting_bed` take it."""
        return TravelFrame(self.axis, self.sign, self.up)

    @property
    def _turn(self) -> int:
        """Sign of a torque across the way: +1 where along, up, across are right-handed."""
        is_cyclic = (self.axis, self.up, self.across) in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
        return self.sign if is_cyclic else -self.sign

    def points(self, points) -> np.ndarray:
        """Points [..., 3] of the world (m) as u, height, distance from the middle plane."""
        points = np.asarray(points, np.float64)
        return np.stack(
            [
                self.sign * points[..., self.axis],
                points[..., self.up],
                points[..., self.across] - self.middle,
            ],
            axis=-1,
        )

    def world(self, vectors) -> np.ndarray:
        """Vectors [..., 3] along, up, across in the world's axes."""
        vectors = np.asarray(vectors)
        found = np.empty_like(vectors)
        found[..., self.axis] = self.sign * vectors[..., 0]
        found[..., self.up] = vectors[..., 1]
        found[..., self.across] = vectors[..., 2]
        return found

    def poses(self, pose) -> np.ndarray:
        """u, height (m) and lean (rad) [..., 3] of poses [..., 7]: position (m) and unit quaternion
        (w, x, y, z) of an upright tool."""
        pose = np.asarray(pose, np.float64)
        w, v = pose[..., 3:4], pose[..., 4:]
        top = np.zeros_like(v)
        top[..., self.up] = 1.0
        # Rotation by a unit quaternion: t + 2 w (v x t) + 2 v x (v x t).
        twist = np.cross(v, top)
        top = top + 2.0 * (w * twist + np.cross(v, twist))
        along, height = self.sign * top[..., self.axis], top[..., self.up]
        return np.stack(
            [
                self.sign * pose[..., self.axis],
                pose[..., self.up],
                np.arctan2(-along, height),
            ],
            axis=-1,
        )

    def velocities(self, velocity) -> np.ndarray:
        """Velocities along the way and up (m/s) and of the lean (rad/s), [..., 3], of the world's
        linear and angular ones [..., 6]."""
        velocity = np.asarray(velocity, np.float64)
        return np.stack(
            [
                self.sign * velocity[..., self.axis],
                velocity[..., self.up],
                self._turn * velocity[..., 3 + self.across],
            ],
            axis=-1,
        )

    def loads(self, force, torque) -> np.ndarray:
        """Force along the way and up (N) and torque in their plane (N m), [..., 3], of the world's
        force and torque [..., 3]; without a torque it counts as 0."""
        force = np.asarray(force, np.float64)
        turn = 0.0 if torque is None else self._turn * np.asarray(torque)[..., self.across]
        return np.stack(
            np.broadcast_arrays(self.sign * force[..., self.axis], force[..., self.up], turn), -1
        )

    def world_loads(self, loads) -> tuple[np.ndarray, np.ndarray]:
        """Force (N) and torque (N m) [..., 3] of the world; the inverse of `loads`. A tool that is
        symmetric across the way feels nothing else."""
        loads = np.asarray(loads)
        force, torque = np.zeros_like(loads), np.zeros_like(loads)
        force[..., self.axis] = self.sign * loads[..., 0]
        force[..., self.up] = loads[..., 1]
        torque[..., self.across] = self._turn * loads[..., 2]
        return force, torque
