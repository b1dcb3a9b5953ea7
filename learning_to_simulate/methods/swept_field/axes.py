"""Between the world's axes and those of a swept field: along the way, up, across.

`xp` is numpy, or `tensors` in a TensorFlow graph.
"""

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

    def points(self, points, xp=np):
        """Points [..., 3] of the world (m) as u, height, distance from the middle plane."""
        return self.local(xp.asarray(points, np.float64), xp) - np.array([0.0, 0.0, self.middle])

    def local(self, vectors, xp=np):
        """Vectors [..., 3] of the world along, up, across."""
        parts = [self.sign * vectors[..., self.axis], vectors[..., self.up]]
        return xp.stack([*parts, vectors[..., self.across]], axis=-1)

    def world(self, vectors, xp=np):
        """Vectors [..., 3] along, up, across in the world's axes; the inverse of `local`."""
        vectors = xp.asarray(vectors)
        parts = {
            self.axis: self.sign * vectors[..., 0],
            self.up: vectors[..., 1],
            self.across: vectors[..., 2],
        }
        return xp.stack([parts[i] for i in range(3)], axis=-1)

    def poses(self, pose, xp=np):
        """u, height (m) and lean (rad) [..., 3] of poses [..., 7]: position (m) and unit quaternion
        (w, x, y, z) of an upright tool."""
        pose = xp.asarray(pose, np.float64)
        lean = xp.arctan2(*self._upwards(pose[..., 3:], pose[..., 3:]))
        return xp.stack([self.sign * pose[..., self.axis], pose[..., self.up], lean], axis=-1)

    def turns(self, rotation, change, xp=np):
        """By how much (rad, in (-pi, pi]) the lean grows from unit quaternions [..., 4] to those
        and a change [..., 4]: in as many digits as the change has."""
        forward, upward = self._upwards(rotation, rotation)
        # A difference of squares is the difference times the sum: no digit is lost.
        forward_by, upward_by = self._upwards(change, 2.0 * rotation + change)
        return xp.arctan2(
            upward * forward_by - forward * upward_by,
            forward * (forward + forward_by) + upward * (upward + upward_by),
        )

    def _upwards(self, one, other):
        """Where a rotation takes the upward axis, [...] against the way and up: two elements of its
        matrix, which are quadratic in the quaternion [..., 4], of whatever length."""
        (w, a, u, c), (w2, a2, u2, c2) = (
            (q[..., 0], *(q[..., 1 + i] for i in (self.axis, self.up, self.across)))
            for q in (one, other)
        )
        tilt = (a * u2 + u * a2) - self.sign * self._turn * (w * c2 + c * w2)
        return -self.sign * tilt, (w * w2 + u * u2) - (a * a2 + c * c2)

    def velocities(self, velocity, xp=np):
        """Velocities along the way and up (m/s) and of the lean (rad/s), [..., 3], of the world's
        linear and angular ones [..., 6]."""
        velocity = xp.asarray(velocity, np.float64)
        return xp.stack(
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

    def world_loads(self, loads, xp=np) -> tuple:
        """Force (N) and torque (N m) [..., 3] of the world; the inverse of `loads`. A tool that is
        symmetric across the way feels nothing else."""
        loads = xp.asarray(loads)
        zero = xp.zeros_like(loads[..., 0])
        force = self.world(xp.stack([loads[..., 0], loads[..., 1], zero], axis=-1), xp)
        turn = self._turn * loads[..., 2]
        torque = [turn if i == self.across else zero for i in range(3)]
        return force, xp.stack(torque, axis=-1)
