"""`LoadedTool`: a tool that is free along, up or in its lean, under weight, forces and actuators.

The force of the soil in the coming frame is a function of the coming pose, so the motion of a mass
follows from backward Euler, (18) of docs/soil_field.md, solved for one free coordinate after the
other until all hold. Each residual grows with its own coordinate, so a bracket holds the root: a
tool rests, stalls and comes back at any step, however light it is.

The force of a field knows hardly any time, so a tool that rests on it would swing; soil damps its
way up, (21). What sinks or climbs evenly feels nothing of that, nor does a tool that something else
holds. At the floor of the terrain a tool rests.
"""

import functools
import math
from collections.abc import Callable

import numpy as np

from learning_to_simulate.live.poses import turned
from learning_to_simulate.soil_field.place import UP, checked_pose
from learning_to_simulate.soil_field.stepper import DT, SoilFrame, SoilStepper

COORDINATES = ('along', 'up', 'lean')
# Tolerance of a coordinate: m, m, rad; sweeps over all of them.
TOLERANCE = np.array([1e-7, 1e-7, 1e-6])
SWEEPS, HALVINGS = 12, 60
# First widths of a bracket: m, m, rad.
WIDTH = np.array([1e-5, 1e-5, 1e-4])
UNLOADS, SLOW, HELD = 0.002, 0.2, 0.25  # m, s, 1; of (21)
# Of a tool that rests on the floor: m above it, and what bears it, N/m.
ABOVE_FLOOR, FLOOR = 1e-6, 1e9


class Damping:
    """D of (21), of one tool; at first of one that nothing presses."""

    def __init__(self):
        self.coefficient = self._slow = 0.0  # N s/m; u, m/s

    def press(self, mass, weight, stiffness=0.0, damping=0.0, held=0.0) -> None:
        """Takes what presses a mass (kg) down in the coming step, N, and by what else it is held
        up: stiffness (N/m), damping (N s/m), and a force (N) whose stiffness nobody knows."""
        weight = max(float(weight), 0.0)
        critical = 2.0 * math.sqrt(mass * weight / UNLOADS)
        own = 0.0
        if critical > 0:
            own = (stiffness * UNLOADS + held) / weight + damping / critical
        self.coefficient = critical * max(1.0 - own / HELD, 0.0)

    def force(self, bears, rate) -> float:
        """D, N, where the networks give a force up and the tool rises at a rate, m/s."""
        swing = max(float(rate) - max(self._slow, 0.0), 0.0)
        return -min(self.coefficient * swing, max(float(bears), 0.0))

    def go_on(self, bears, rate, dt) -> None:
        """After a step of dt s that ended so."""
        self._slow += (float(rate) - self._slow) * dt / (SLOW + dt)
        if not bears > 0:
            self._slow = 0.0


class LoadedTool:
    """A tool under a load.

    Args:
      stepper: started.
      mass: kg.
      inertia: kg m2 about the position of the pose, in the plane of travel; needed where the lean
        is free.
      free: some of `COORDINATES`; the others follow the given pose.
      stiffness, damping: [3] of actuators (N/m, N/m, N m/rad and N s/m, ...) that pull free
        coordinates towards the given pose.

    Attributes:
      velocity: float64 [3] of `COORDINATES`, m/s and rad/s.

    Raises:
      ValueError: no free coordinate or an unknown one; a mass, inertia, stiffness or damping that
        cannot be.
    """

    def __init__(
        self, stepper: SoilStepper, mass: float, inertia: float | None = None, free=('up',),
        stiffness=(0.0, 0.0, 0.0), damping=(0.0, 0.0, 0.0),
    ):  # fmt: skip
        if not free or set(free) - set(COORDINATES):
            raise ValueError(f'free is {free}: some of {COORDINATES} were expected')
        if not 0 < mass < np.inf:
            raise ValueError(f'the mass is {mass} kg, must be positive')
        if 'lean' in free and not (inertia is not None and 0 < inertia < np.inf):
            raise ValueError(f'the lean is free, so the inertia ({inertia} kg m2) must be positive')
        self._stepper = stepper
        self._free = [COORDINATES.index(name) for name in COORDINATES if name in free]
        self._mass = np.array([mass, mass, inertia or 0.0])
        for name, values in (('stiffness', stiffness), ('damping', damping)):
            if np.shape(values) != (3,) or not all(0 <= value < np.inf for value in values):
                raise ValueError(f'{name} is {values}: three numbers of at least 0 were expected')
        self._springs = np.array([stiffness, damping], np.float64)
        self.velocity = np.zeros(3)
        self._damping = Damping()

    def step(self, pose, force=(0.0, 0.0, 0.0), torque: float = 0.0, dt: float = DT) -> SoilFrame:
        """Moves the tool by dt s; returns the frame of `SoilStepper.step`, whose force holds D of
        (21).

        Args:
          pose: [7]; where coordinates are free, what actuators pull towards.
          force: [3] N, world, on the tool beside soil, weight and actuators.
          torque: N m about the axis across, likewise.

        Raises:
          ValueError: see `SoilStepper.step`; the tool and its velocity stay as they were.
        """
        force = np.asarray(force, np.float64)
        if force.shape != (3,) or not np.isfinite([*force, torque]).all():
            raise ValueError(
                f'force is {force} N, torque {torque} N m: three finite numbers and one were '
                f'expected'
            )
        if not 0 < dt < np.inf:
            raise ValueError(f'dt is {dt} s, must be positive and finite')
        stepper, place = self._stepper, self._stepper.place
        last = self._coordinates(stepper.frame.pose)
        pose = checked_pose(pose)
        target = self._coordinates(pose)
        # The lean of a target is the one nearest to the tool: springs see no whole turn.
        target[2] = last[2] + (target[2] - last[2] + np.pi) % (2.0 * np.pi) - np.pi
        gravity = stepper.terrain.soil.gravity
        given = np.append(place.axes[:2] @ force, torque)
        given[1] -= self._mass[0] * gravity
        stiffness, damping = self._springs
        coming = target.copy()
        coming[self._free] = (last + dt * self.velocity)[self._free]
        lowest = np.full(3, -np.inf)
        lowest[1] = stepper.terrain.floor + stepper.tool.radius + ABOVE_FLOOR
        if 1 in self._free:
            self._damping.press(self._mass[0], -given[1], stiffness[1], damping[1])

        def damped(frame, height):
            return self._damping.force(frame.force[1], (height - last[1]) / dt)

        def residual(axis, value):
            """What does not balance at a value, over a floor that gives hardly way."""
            there, below = coming.copy(), min(value - lowest[axis], 0.0)
            there[axis] = value = max(value, lowest[axis])
            try:
                frame = stepper.propose(self._pose(pose, there, target), dt)
            except ValueError as error:
                raise ValueError(f'under its load, {error}') from error
            soil = [*(place.axes[:2] @ frame.force), place.across @ frame.torque]
            soil[1] += damped(frame, there[1])
            rate = (value - last[axis]) / dt
            pull = stiffness[axis] * (target[axis] - value) - damping[axis] * rate
            inertia = self._mass[axis] * (rate - self.velocity[axis]) / dt
            return inertia - soil[axis] - given[axis] - pull + FLOOR * below

        for _ in range(SWEEPS if len(self._free) > 1 else 1):
            before = coming.copy()
            for axis in self._free:
                found = root(
                    functools.partial(residual, axis), max(coming[axis], lowest[axis]),
                    WIDTH[axis], TOLERANCE[axis],
                )  # fmt: skip
                coming[axis] = max(found, lowest[axis])
            if (np.abs(coming - before) <= TOLERANCE).all():
                break
        frame = stepper.step(self._pose(pose, coming, target), dt)
        force = frame.force + damped(frame, coming[1]) * UP
        self.velocity = (coming - last) / dt
        self._damping.go_on(frame.force[1], self.velocity[1], dt)
        return frame._replace(force=force)

    def _coordinates(self, pose):
        """u, y (m) and lean (rad) of a pose, from the place of the passage."""
        place = self._stepper.place
        u, y, _ = place.local(pose[:3])
        return np.array([u, y, place.turns(pose)[0]])

    def _pose(self, pose, there, target):
        place, change = self._stepper.place, there - target
        found = np.array(pose, np.float64)
        found[:3] += change[0] * place.along + change[1] * UP
        found[3:] = turned(found[3:], change[2] * place.across)
        return found


def root(function: Callable, start: float, width: float, tolerance: float) -> float:
    """The root of a growing function near a start: a bracket that doubles from a first width, then
    regula falsi with bisection (Illinois), to a tolerance."""
    value = function(start)
    step = -width if value > 0 else width
    end, other = start, start
    while value * (value_end := function(end := end + step)) > 0:
        other, value, step = end, value_end, 2 * step
        if abs(step) > 1.0:
            raise ValueError('no pose holds the load: the soil does not carry it, or it flies away')
    low, high, at_low, at_high = other, end, value, value_end
    for _ in range(HALVINGS):
        if abs(high - low) <= tolerance or at_high == 0:
            break
        middle = high - at_high * (high - low) / (at_high - at_low)
        at_middle = function(middle)
        if at_middle * at_high < 0:
            low, at_low = high, at_high
        else:
            at_low /= 2  # Illinois: the end that stays counts half
        high, at_high = middle, at_middle
    return high
