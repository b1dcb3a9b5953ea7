"""The motion of a body, what carries it, and quantities that go from level to level in time."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mpm.bodies import Body
from mpm.scenes import EARTH_GRAVITY


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


def under_load(load: float | Callable[[np.ndarray], np.ndarray]) -> Machine:
    """Returns what carries a wheel whose height is free under a load (N), or times [T] (s) -> N;
    the load at time 0 is its weight on the Earth."""

    def force(times):
        newtons = load(times) if callable(load) else np.full(len(times), load)
        return newtons[:, None] * [0.0, -1.0, 0.0]

    weight = -float(force(np.zeros(1))[0, 1])
    return Machine((False, True, False), weight / EARTH_GRAVITY, force)


class Levels:
    """Values reached at given times, joined by s(u) = 6 u^5 - 15 u^4 + 10 u^3.

    s is the path of least jerk between two rests (Flash and Hogan 1985, J. Neurosci. 5, 1688): each
    piece is monotonic, so the curve never leaves the range of its levels, and its first two
    derivatives vanish at the ends, so it is twice continuously differentiable. Its steepest
    slope is `PEAK` times the mean one. Before the first and after the last time the value stays.
    """

    PEAK = 1.875

    def __init__(self, times, values):
        """Of times [K] (s), ascending, and values [K]."""
        self.times, self.values = np.asarray(times, np.float64), np.asarray(values, np.float64)

    def _pieces(self, times):
        """The pieces [T] in which `times` [T] lie, their lengths (s) and the share gone by."""
        k = np.clip(np.searchsorted(self.times, times, 'right') - 1, 0, len(self.times) - 2)
        length = self.times[k + 1] - self.times[k]
        return k, length, np.clip((times - self.times[k]) / length, 0.0, 1.0)

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Returns the values [T] at `times` [T] (s)."""
        k, _, u = self._pieces(np.asarray(times, np.float64))
        rise = self.values[k + 1] - self.values[k]
        return self.values[k] + rise * (u * u * u * (10.0 + u * (6.0 * u - 15.0)))

    def integral(self, times: np.ndarray) -> np.ndarray:
        """Returns the integrals [T] from the first level's time to `times` [T] (s), 0 before it:
        what has not begun does not move."""
        times = np.asarray(times, np.float64)
        mean = (self.values[1:] + self.values[:-1]) / 2.0  # s(u) has the mean 1/2
        before = np.concatenate([[0.0], np.cumsum(mean * np.diff(self.times))])
        k, length, u = self._pieces(times)
        rise = self.values[k + 1] - self.values[k]
        area = length * (self.values[k] * u + rise * (u * u) ** 2 * (2.5 + u * (u - 3.0)))
        beyond = np.maximum(times - self.times[-1], 0.0) * self.values[-1]
        return before[k] + area + beyond


class Track:
    """Levels of several quantities at common times (s, the first is 0), while a motion is drawn."""

    def __init__(self, **start: float):
        self.times = [0.0]
        self.values = {name: [value] for name, value in start.items()}

    @property
    def time(self) -> float:
        """Of the last level, s."""
        return self.times[-1]

    def last(self, name: str) -> float:
        return self.values[name][-1]

    def add(self, seconds: float, **levels: float) -> None:
        """Goes to new levels in some seconds; quantities that are not named stay as they are."""
        self.times.append(self.time + seconds)
        for name, values in self.values.items():
            values.append(levels.get(name, values[-1]))

    def levels(self, name: str) -> Levels:
        return Levels(self.times, self.values[name])
