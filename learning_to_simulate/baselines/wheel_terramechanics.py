"""Sinkage, drawbar and torque of a wheel by Bekker, Wong and Janosi, as in the Soil Contact Model.

Normal stress under a point that is pressed in by z: p = (k_c / b + k_phi) z^n (Bekker 1969; Wong
2008, Theory of Ground Vehicles, ch. 2). Shear stress of a soil without cohesion after a shear
displacement j: tau = p tan phi (1 - exp(-j / K)) (Janosi & Hanamoto 1961). The Soil Contact Model
(Krenn & Hirzinger 2009; Chrono's SCM) applies both to a height map: soil that was pressed in stays
so, and comes back elastically only. Here the map is a row of bins along the travel, the wheel a
rigid cylinder, and its height in every frame the one at which the soil bears the load.

In the steady state this is Wong & Reece's (1967) integral over the contact arc, with no contact
behind the lowest point, but for j: they follow a point of the rim, the Soil Contact Model a point
of the soil, which the rim passes 1 / (1 - slip) times as long.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

RIM_FRICTION = 0.5
EARTH_GRAVITY = 9.81  # m/s2, that the default parameters were measured at
_BISECTIONS = 30
# Sine of the angle at which the rim ends: beyond, it stands upright.
_RIM_END = 0.9999


@dataclasses.dataclass(frozen=True)
class TerrainParameters:
    """Parameters of Bekker, Wong and Janosi.

    The defaults are Wong's dry sand (2008, table 2.3; Land Locomotion Laboratory) without its
    cohesion, and the shear modulus of Chrono's SCM examples. A frictional soil bears in proportion
    to its weight (Reece 1965), so k_c and k_phi scale with gravity.
    """

    k_c: float = 990.0  # cohesive modulus, N/m^(n+1)
    k_phi: float = 1528.43e3  # frictional modulus, N/m^(n+2)
    n: float = 1.1  # exponent of sinkage
    shear_modulus: float = 0.01  # K, m
    elastic: float = 20.0  # stiffness of unloading over p(z) / z of the point at its deepest


class Wheel(NamedTuple):
    """A wheel and its soil."""

    radius: float  # m
    width: float  # m
    load: float | np.ndarray  # N, of all frames or [T]
    gravity: float  # m/s2
    soil_friction: float  # tan(phi) of the soil
    rim_friction: float  # Coulomb coefficient between soil and rim


class WheelMotion(NamedTuple):
    """What the model says of each frame, all [T]."""

    sinkage: np.ndarray  # of the lowest point below the flat surface, m
    drawbar: np.ndarray  # forward force of the soil on the wheel, N
    vertical: np.ndarray  # upward force, N: the load, or less where buried to the axle
    torque: np.ndarray  # of the soil about the axle, against the turn, N m


class Bed:
    """Bins along the travel of a wheel, between the least and largest of its axle (m), and what it
    has done to them; `n_bin` for each radius of travel."""

    def __init__(
        self, wheel: Wheel, parameters: TerrainParameters, first: float, last: float, n_bin: int
    ):
        self._parameters, self._n_bin, self._radius = parameters, n_bin, wheel.radius
        # p / z^n, Pa/m^n
        self._modulus = (parameters.k_c / wheel.width + parameters.k_phi) * (
            wheel.gravity / EARTH_GRAVITY
        )
        # The rim slides before the soil shears where it is the smoother of both.
        self._friction = min(wheel.soil_friction, wheel.rim_friction)
        self._spacing = wheel.radius / n_bin
        self._area = wheel.width * self._spacing
        self._start = first - wheel.radius
        count = int(np.ceil((last - first + 2 * wheel.radius) / self._spacing)) + 1
        self._places = self._start + self._spacing * np.arange(count)
        self._all_deepest, self._all_slip = np.zeros((2, count))  # of all bins, see `move`
        self._last: tuple | None = None

    def move(self, travel: float, rolled: float) -> None:
        """Looks at the bins [n] under the wheel after a travel and radius times angle turned, m;
        nothing has been sheared before the first one."""
        # Only bins under the wheel are looked at: a frame costs the same on every path.
        first = int(np.floor((travel - self._radius - self._start) / self._spacing))
        window = np.clip(first + np.arange(2 * self._n_bin + 2), 0, len(self._places) - 1)
        ahead = self._places[window] - travel
        sine = np.clip(ahead / self._radius, -_RIM_END, _RIM_END)
        cosine = np.sqrt(1.0 - sine**2)
        slip = self._all_slip[window]
        if self._last is not None:
            # The rim passes the soil at omega R - v cos(angle).
            slip = slip + (rolled - self._last[1]) - (travel - self._last[0]) * cosine
        self._last, self._window = (travel, rolled), window
        # Height of the rim above its lowest point, m, infinite beyond the rim; sine and cosine of
        # its angle from there, positive ahead.
        self._arch = np.where(np.abs(sine) < _RIM_END, self._radius * (1.0 - cosine), np.inf)
        self._sine, self._cosine = sine, cosine
        self._deepest = self._all_deepest[window]  # sinkage so far, m
        self._slip = slip  # shear displacement j, m
        # Share of the shear strength that is mobilised, signed.
        modulus = self._parameters.shear_modulus
        self._shear = np.sign(slip) * (1.0 - np.exp(-np.abs(slip) / modulus))

    def _pressure(self, sinkage):
        """Normal stress [n] (Pa) at a sinkage (m) of the lowest point."""
        z = sinkage - self._arch
        most = np.maximum(z, self._deepest)
        virgin = self._modulus * np.maximum(most, 0.0) ** self._parameters.n
        # Unloading: a share of p is gone for each share of its depth that the rim has risen.
        risen = (most - z) / np.maximum(most, 1e-12)
        left = np.maximum(1.0 - self._parameters.elastic * risen, 0.0)
        return np.where(z > 0, virgin * left, 0.0)

    def forces(self, sinkage: float):
        """Forward and upward force, N, and torque per radius, N, at a sinkage (m)."""
        pressure = self._pressure(sinkage)
        tau = pressure * self._friction * self._shear
        # A bin's share of the rim is area / cosine; stresses turn with the rim.
        tangent = self._sine / self._cosine
        return (
            ((tau - pressure * tangent) * self._area).sum(),
            ((pressure + tau * tangent) * self._area).sum(),
            (tau / self._cosine * self._area).sum(),
        )

    def press(self, sinkage: float) -> None:
        """Keeps what the wheel at a sinkage (m) has pressed in and sheared."""
        pressed = self._pressure(sinkage) > 0
        reached = np.where(pressed, sinkage - self._arch, 0.0)
        self._all_deepest[self._window] = np.maximum(self._deepest, reached)
        self._all_slip[self._window] = np.where(pressed, self._slip, 0.0)


def drive(
    wheel: Wheel, travel, rolled, parameters: TerrainParameters, n_bin: int = 160
) -> WheelMotion:
    """Drives a wheel over flat soil, each frame in equilibrium with its load.

    Frame 0 rests under the load; the soil then has no shear. A wheel whose load the soil does not
    bear is buried to its axle; its vertical force stays below the load.

    Args:
      travel: [T] of the axle, m, forward.
      rolled: [T] radius times the angle turned, m, forward.
      n_bin: bins per radius of travel.
    """
    bed = Bed(wheel, parameters, travel.min(), travel.max(), n_bin)
    rows = []
    for way, turn, load in zip(travel, rolled, np.broadcast_to(wheel.load, travel.shape)):
        bed.move(way, turn)
        low, high = 0.0, wheel.radius
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            if bed.forces(middle)[1] >= load:
                high = middle
            else:
                low = middle
        forward, upward, moment = bed.forces(high)
        rows.append((high, forward, upward, wheel.radius * moment))
        bed.press(high)
    return WheelMotion(*np.transpose(rows))
