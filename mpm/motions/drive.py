"""The motion of a body: what a simulation asks of it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mpm.bodies import Body


@dataclass(frozen=True)
class Machine:
    """What carries a body whose x, y or angle are free (`solver.Free`, eq. 7).

    The centre of mass is taken at the reference point.

    Attributes:
        is_free: of x, y and angle.
        mass: kg.
        inertia: about the reference point, kg m2.
        force: times [T] (s) -> float64 [T, 3], N, N and N m, on x, y and angle beside the soil:
            weight, load.
        stiffness, damping: [3], of the actuator that pulls towards the pose of the `Drive`: N/m and
            N s/m for x and y, N m/rad and N m s/rad for the angle.
    """

    is_free: tuple
    mass: float
    force: Callable[[np.ndarray], np.ndarray]
    inertia: float = 0.0
    stiffness: tuple = (0.0, 0.0, 0.0)
    damping: tuple = (0.0, 0.0, 0.0)

    def masses(self) -> np.ndarray:
        """Returns float64 [3]: mass or inertia of each coordinate, 0 where it is not free."""
        return np.array([self.mass, self.mass, self.inertia]) * self.is_free


@dataclass(frozen=True)
class Drive:
    """How a body moves in one run.

    Attributes:
        body: the rigid body.
        pose: times [T] (s) -> float64 [T, 4]: x and y (m) of the reference point, the angle theta
            (rad, counter-clockwise about +z; a blade whose top leans back, to +x, by a has
            theta = -a) and z (m) of the body's middle. Of free coordinates it is the target of the
            actuator. Before time 0 the pose rests at its first value.
        machine: what carries the body; None: it follows its pose.
        lead_in: frames that are simulated before the first recorded one: an earlier pass of the
            tool over the bed. Times of `pose` and of the machine count from the first of them.
        rest: frames before these in which a free body is set on the soil and its load grows.
    """

    body: Body
    pose: Callable[[np.ndarray], np.ndarray]
    machine: Machine | None = None
    lead_in: int = 0
    rest: int = 0


def poses(times: np.ndarray, x, y, angle, z) -> np.ndarray:
    """Returns poses, float64 [T, 4], at `times` [T] (s) from arrays [T] and constants."""
    columns = np.broadcast_arrays(np.asarray(times, np.float64), x, y, angle, z)
    return np.stack(columns[1:], axis=1).astype(np.float64)
