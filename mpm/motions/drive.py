"""The motion of a body: what a simulation asks of it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mpm.bodies import Body


@dataclass(frozen=True)
class Machine:
    """What carries a body whose x, y or angle are free (`solver.Free`, eq. 7).

    The centre of mass is taken at the reference point.
    """

    is_free: tuple  # of x, y and angle
    mass: float  # kg
    # Times [T] (s) -> float64 [T, 3], N, N and N m, on x, y and angle beside the soil: weight, load
    force: Callable[[np.ndarray], np.ndarray]
    inertia: float = 0.0  # about the reference point, kg m2
    # stiffness, damping: [3], of the actuator that pulls towards the pose of the `Drive`: N/m and N
    # s/m for x and y, N m/rad and N m s/rad for the angle
    stiffness: tuple = (0.0, 0.0, 0.0)
    damping: tuple = (0.0, 0.0, 0.0)

    def masses(self) -> np.ndarray:
        """Returns float64 [3]: mass or inertia of each coordinate, 0 where it is not free."""
        return np.array([self.mass, self.mass, self.inertia]) * self.is_free


@dataclass(frozen=True)
class Drive:
    """How a body moves in one run."""

    body: Body  # the rigid body
    # Times [T] (s) -> float64 [T, 4]: x and y (m) of the reference point, the angle theta (rad,
    # counter-clockwise about +z; a blade whose top leans back, to +x, by a has theta = -a) and z
    # (m) of the body's middle. Of free coordinates it is the target of the actuator. Before time 0
    # the pose rests at its first value
    pose: Callable[[np.ndarray], np.ndarray]
    machine: Machine | None = None  # what carries the body; None: it follows its pose
    # Frames that are simulated before the first recorded one: an earlier pass of the tool over the
    # bed. Times of `pose` and of the machine count from the first of them
    lead_in: int = 0
    rest: int = 0  # frames before these in which a free body is set on the soil and its load grows


def poses(times: np.ndarray, x, y, angle, z) -> np.ndarray:
    """Returns poses, float64 [T, 4], at `times` [T] (s) from arrays [T] and constants."""
    columns = np.broadcast_arrays(np.asarray(times, np.float64), x, y, angle, z)
    return np.stack(columns[1:], axis=1).astype(np.float64)
