"""Quantities that go from level to level by quintic pieces, and their integrals in closed form."""

import numpy as np


class Levels:
    """Values reached at given times, joined by s(u) = 6 u^5 - 15 u^4 + 10 u^3.

    s is the path of least jerk between two rests (Flash and Hogan 1985, J. Neurosci. 5, 1688): each
    piece is monotonic, so the curve never leaves the range of its levels, and its first two
    derivatives vanish at the ends, so it is twice continuously differentiable. Its steepest
    slope is `PEAK` times the mean one.

    Attributes:
        times: float64 [K], ascending, s; before the first and after the last the value stays.
        values: float64 [K].
    """

    PEAK = 1.875

    def __init__(self, times, values):
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
