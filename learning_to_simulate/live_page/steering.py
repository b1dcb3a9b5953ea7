"""How a tool is asked to move: sliders and a handle in the plane of drive and height.

A steering is written to by any thread (single numbers, each whole) and read by the loop. It says
where the body should be in the coming frame; `Limits` says how far it may go.
"""

import dataclasses

import numpy as np

# Where a model has no ranges of its training runs: m, m/s, rad.
DEPTH, SPEED, ANGLE = 0.08, 0.1, np.deg2rad(45.0)
TURN = 1.0  # rad/s of a blade whose angle was set anew
SPARE = 0.98  # of the largest speed within limits, which are a little wider than the runs


@dataclasses.dataclass
class Slider:
    """A number that is set by hand.

    Attributes:
      label: with its unit.
      low, high, step, value: in that unit.
    """

    label: str
    low: float
    high: float
    step: float
    value: float

    def __post_init__(self):
        self.low = float(np.floor(self.low / self.step + 1e-6) * self.step)
        self.high = float(np.ceil(self.high / self.step - 1e-6) * self.step)
        self.set(self.value)

    def set(self, value: float) -> None:
        """Takes the nearest step within the range."""
        value = round(float(value) / self.step) * self.step
        self.value = float(round(min(max(value, self.low), self.high), 9))


class BladeSteering:
    """A body whose whole motion is given: depth, speed and angle, or a handle.

    Args:
      scene: of the model.
      start: (x, height, angle) of the body, m and rad.
      body: float64 [R, 3] of the body in its own frame, m.
      level: height of the bed at rest, m.
      limits: `Limits`, or None.
      angles: lowest and highest of recorded runs, rad; None for what the limits allow.

    Attributes:
      sliders: by name.
      target: (x, height, angle) that the body is on its way to.
      fastest: float64 [3], of each in a frame, m and rad.
    """

    handle = (True, True)  # along the drive, and up: then it can be turned as well

    def __init__(self, scene, start, body, level: float, limits, angles=None):
        self._dt, self._up, self._level = scene.dt, scene.up_axis, level
        self._plan = body[:, [0, scene.up_axis]]
        lowest, lift = level - DEPTH, DEPTH / 2
        self.forwards, fastest = -1.0, np.array([SPEED, SPEED]) * scene.dt
        if limits is not None:
            lowest = limits.low[self._up]
            lift = limits.high[self._up] - np.ptp(body[:, self._up]) - level
            along = limits.speed[0][0], limits.speed[1][0]
            self.forwards = 1.0 if along[1] > -along[0] else -1.0
            speeds = np.abs([s[[0, self._up]] for s in limits.speed])
            fastest = SPARE * speeds.max(axis=0)
            # A slider that jumps shall not throw the blade, whatever the fastest run does.
            fastest[1] = fastest.min()
            angles = limits.angles() if angles is None else angles
        self.fastest = np.array([*fastest, TURN * scene.dt])
        self.target = np.array(start, np.float64)
        low, high = np.rad2deg((-ANGLE, ANGLE) if angles is None else angles)
        self.sliders = {
            'depth': Slider('depth, mm', -1e3 * lift, 1e3 * (level - lowest), 1.0, 0.0),
            'speed': Slider('speed, mm/s', 0.0, 1e3 * fastest[0] / self._dt, 1.0, 0.0),
            'angle': Slider('angle, degrees', low, high, 1.0, np.rad2deg(start[2])),
        }
        self._show()

    def set(self, name: str, value: float) -> None:
        """Sets a slider."""
        self.sliders[name].set(value)
        if name == 'angle':
            self.target[2] = np.deg2rad(self.sliders['angle'].value)
        if name in ('depth', 'angle'):
            edge = self._level - 1e-3 * self.sliders['depth'].value
            self.target[1] = edge + self._above_edge()

    def aim(self, plane) -> None:
        """Sends the body to a place; the sliders follow."""
        self.target[:] = plane
        self.sliders['speed'].set(0.0)
        self._show()

    def _above_edge(self):
        """Height of the body's point above its lowest particle, at the angle of the target."""
        return -(self._plan @ [np.sin(self.target[2]), np.cos(self.target[2])]).min()

    def _show(self):
        self.sliders['depth'].set(1e3 * (self._level + self._above_edge() - self.target[1]))
        self.sliders['angle'].set(np.rad2deg(self.target[2]))

    def wanted(self, now) -> np.ndarray:
        """(x, height, angle) of the coming frame, without regard to limits."""
        ahead = 1e-3 * self.sliders['speed'].value * self._dt
        if ahead:
            self.target[0] = now[0] + self.forwards * ahead
        return now + np.clip(self.target - now, -self.fastest, self.fastest)


class WheelSteering:
    """A driven body: rotation and slip are given, its height is predicted.

    Args:
      scene, start, body, level, limits, angles: as of `BladeSteering`.

    Attributes:
      sliders: by name.
      target: x at which it stops, m; it begins without one.
    """

    handle = (True, False)

    def __init__(self, scene, start, body, level, limits, angles=None):
        del level, angles
        self._dt = scene.dt
        plan = body[:, [0, scene.up_axis]]
        self.radius = float(np.linalg.norm(plan, axis=1).max())
        rim, self.forwards = SPEED, -1.0
        if limits is not None:
            rim = SPARE * limits.speed[1][scene.up_axis] / self._dt
            self.forwards = 1.0 if limits.speed[1][0] > -limits.speed[0][0] else -1.0
        self.target = np.array([np.nan, *start[1:]])
        self.fastest = np.full(3, np.inf)  # what the sliders say is taken
        fastest = rim / self.radius
        self.sliders = {
            'rotation': Slider('rotation, rad/s', 0.0, 1.5 * fastest, 1e-3, fastest),
            'slip': Slider('slip, %', 0.0, 90.0, 1.0, 40.0),
        }

    def set(self, name: str, value: float) -> None:
        """Sets a slider."""
        self.sliders[name].set(value)
        self.target[0] = np.nan

    def aim(self, plane) -> None:
        """Sends the wheel to a place ahead."""
        self.target[0] = plane[0]

    def wanted(self, now) -> np.ndarray:
        """As of `BladeSteering`; the height is left as it is."""
        rotation = self.sliders['rotation'].value
        if np.isfinite(self.target[0]) and (self.target[0] - now[0]) * self.forwards <= 0:
            rotation = 0.0
        travel = rotation * self.radius * (1 - self.sliders['slip'].value / 100)
        # Axis 0 times up turns from drive to height: a wheel that rolls along +x turns back.
        turn = [self.forwards * travel, 0.0, -self.forwards * rotation]
        return now + np.array(turn) * self._dt
