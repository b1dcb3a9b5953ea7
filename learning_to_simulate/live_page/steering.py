"""How a tool is asked to move: sliders and a handle in the plane of travel.

A steering is written to by any thread (single numbers, each whole) and read by the frames. It says
where the body should be in the coming frame; `Session` says how far it may go.
"""

import dataclasses

import numpy as np

from learning_to_simulate.tool.blade import EDGE_RADIUS

# Where a model does not state the ranges of its training runs: m, m/s, rad.
DEPTH, SPEED, ANGLE = 0.08, 0.1, np.deg2rad(45.0)
TURN = 1.0  # rad/s of a blade whose angle was set anew
SPARE = 0.98  # of the largest speed of the training runs, so that rounding does not exceed it


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


@dataclasses.dataclass
class Ranges:
    """What the training runs of a model had, as far as it states it.

    Attributes:
      edge: lowest and highest place of the lowest point of the body, m.
      along: least and largest speed along axis 0, m/s.
      rise: largest vertical speed, m/s.
      angle: lowest and highest, rad.
      rim: largest speed of the rim of a wheel, m/s.
    """

    edge: tuple[float, float]
    along: tuple[float, float] = (-SPEED, 0.0)
    rise: float = SPEED
    angle: tuple[float, float] = (-ANGLE, ANGLE)
    rim: float = SPEED

    @classmethod
    def of(cls, model, level: float, body) -> 'Ranges':
        """Of an `api.TrainedModel` with a bed of a level, m, and a body [R, 3] in its own frame."""
        found, up = cls((level - DEPTH, level + DEPTH / 2)), model.scene.up_axis
        field = getattr(model.model, 'field', None)
        statistics = getattr(model.model.simulator, 'statistics', None)
        if field is not None:
            ranges = field.ranges
            found.along = tuple(sorted(field.axes.sign * speed for speed in ranges['speed']))
            if 'lean' in ranges:
                found.edge = tuple(level - EDGE_RADIUS + height for height in ranges['height'])
                found.rise = float(np.abs(ranges['rise']).max())
                found.angle = -ranges['lean'][1], -ranges['lean'][0]
            else:
                found.rim = float(np.abs(ranges['rim']).max())
        elif getattr(statistics, 'given_range', None) is not None:
            low, high = statistics.given_range[:, up]
            found.edge = float(low), float(high - np.ptp(body[:, up]))
            speeds = statistics.given_velocity_range / model.scene.dt
            found.along = tuple(speeds[:, 0])
            found.rise = float(np.abs(speeds[:, up]).max())
            found.rim = float(speeds[1, up])
        return found

    @property
    def forwards(self) -> float:
        """+1 or -1: the way along axis 0 that the body drives."""
        return 1.0 if self.along[1] > -self.along[0] else -1.0


class BladeSteering:
    """A body whose whole motion is given: depth, speed and angle, or a handle.

    Args:
      scene: of the model.
      start: (x, height, angle) of the body, m and rad.
      body: float64 [R, 3] of the body in its own frame, m.
      level: height of the bed at rest, m.
      ranges: of the training runs.

    Attributes:
      sliders: by name.
      target: (x, height, angle) that the body is on its way to.
      forwards: +1 or -1, its way along axis 0.
      fastest: float64 [3], of each in a frame, m and rad.
    """

    handle = (True, True)  # along the drive, and up: then it can be turned as well

    def __init__(self, scene, start, body, level: float, ranges: Ranges):
        self._dt, self._level, self.forwards = scene.dt, level, ranges.forwards
        self._plan = body[:, [0, scene.up_axis]]
        speed = SPARE * np.abs(ranges.along).max()
        # A slider that jumps shall not throw the blade, whatever the fastest run does.
        rise = min(speed, SPARE * ranges.rise)
        self.fastest = np.array([speed, rise, TURN]) * scene.dt
        self.target = np.array(start, np.float64)
        low, high = 1e3 * (level - np.array(ranges.edge))[::-1]
        least, most = np.rad2deg(ranges.angle)
        self.sliders = {
            'depth': Slider('depth, mm', low, high, 1.0, 0.0),
            'speed': Slider('speed, mm/s', 0.0, 1e3 * speed, 1.0, 0.0),
            'angle': Slider('angle, degrees', least, most, 1.0, np.rad2deg(start[2])),
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
        """(x, height, angle) of the coming frame."""
        ahead = 1e-3 * self.sliders['speed'].value * self._dt
        if ahead:
            self.target[0] = now[0] + self.forwards * ahead
        return now + np.clip(self.target - now, -self.fastest, self.fastest)


class WheelSteering:
    """A driven body: rotation and slip are given, its height is predicted.

    Args:
      scene, start, body, level, ranges: as of `BladeSteering`.

    Attributes:
      sliders, forwards: likewise.
      fastest: what the sliders say is taken.
      target: x at which it stops, m; it begins without one.
      radius: m.
    """

    handle = (True, False)

    def __init__(self, scene, start, body, level, ranges: Ranges):
        del level
        self._dt, self.forwards = scene.dt, ranges.forwards
        self.radius = float(np.linalg.norm(body[:, [0, scene.up_axis]], axis=1).max())
        self.target = np.array([np.nan, *start[1:]])
        self.fastest = np.full(3, np.inf)
        fastest = SPARE * ranges.rim / self.radius
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
        """(x, height, angle) of the coming frame; the height is left as it is."""
        rotation = self.sliders['rotation'].value
        if np.isfinite(self.target[0]) and (self.target[0] - now[0]) * self.forwards <= 0:
            rotation = 0.0
        travel = rotation * self.radius * (1 - self.sliders['slip'].value / 100)
        # Axis 0 times up turns from drive to height: a wheel that rolls along +x turns back.
        turn = [self.forwards * travel, 0.0, -self.forwards * rotation]
        return now + np.array(turn) * self._dt
