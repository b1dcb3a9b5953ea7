"""The motions of the two published grids of cases.

Source: Usmani (2023), thesis, section 2.3; Haeri and Skonieczny (2021), Subspace Graph Physics.
"""

import math

import numpy as np

from mpm import bodies
from mpm.motions.drive import Drive, poses, under_load
from mpm.scenes import CORNER, Scene, wheel_load

RAMP_SPEED = 0.025  # m/s down, and as much forward: 45 degrees
CUT_LENGTH = 0.4
TIP_START = 0.9  # of the bin's length
TIP_CLEARANCE = 0.5 / 75  # m above the surface
REST_FRAMES = 48  # the wheel rests before it drives; the load grows over the first half
WHEEL_START_X = CORNER + 0.28
WHEEL_SPIN = {0.05: 0.78, 0.15: 0.26, 0.30: 0.13}  # rad/s
WHEEL_TRAVEL = {20: 0.0156, 40: 0.0120, 70: 0.00585}  # m/s; "40" is a slip of 38.5 %


def blade_displacement(motion: int, depth: float, speed: float, times: np.ndarray) -> np.ndarray:
    """Returns the blade's displacement [T, 2] (x, y) in m at `times` (s) after the start.

    Motion 1: down and forward at 45 degrees to `depth`, 0.4 m at `speed`, up and forward at 45
    degrees to the starting height, rest. Motion 2: half an ellipse 0.4 m long, `depth` deep,
    travelled at `speed` in x, and stopped at 95 % of its length.
    """
    times = np.maximum(np.asarray(times, dtype=np.float64), 0.0)
    if motion == 1:
        ramp, cut = depth / RAMP_SPEED, CUT_LENGTH / speed
        ends = np.array([0.0, ramp, ramp + cut, 2 * ramp + cut])
        x = np.interp(times, ends, np.cumsum([0.0, depth, CUT_LENGTH, depth]))
        return np.stack([-x, np.interp(times, ends, [0.0, -depth, -depth, 0.0])], axis=1)
    total = CUT_LENGTH / speed
    s = np.minimum(times, 0.95 * total)
    return np.stack([-speed * s, -2 * depth / total * np.sqrt(s * total - s**2)], axis=1)


def blade_start(scene: Scene) -> np.ndarray:
    """Returns where the grid's blades start: x and y (m) of the reference point."""
    box = scene.bin
    height = box.surface + TIP_CLEARANCE + bodies.BLADE_THICKNESS / 2
    return np.array([CORNER + TIP_START * box.size[0], height])


def make_drive(scene: Scene, parameters: dict) -> Drive:
    """Returns the body of a case of the grid and its motion."""
    if scene.name == 'wheel':
        return _wheel_drive(scene, parameters)
    lean, start = math.radians(parameters['angle_deg']), blade_start(scene)
    motion, depth, speed = (parameters[name] for name in ('motion', 'depth_m', 'speed_m_s'))

    def pose(times):
        x, y = (start + blade_displacement(motion, depth, speed, times)).T
        return poses(times, x, y, -lean, scene.bin.z_middle)

    return Drive(bodies.make_blade(), pose)


def _wheel_drive(scene: Scene, parameters: dict) -> Drive:
    diameter = parameters['diameter_m']
    travel = WHEEL_TRAVEL[parameters['slip_percent']]

    def pose(times):
        driven = np.maximum(np.asarray(times, dtype=np.float64), 0.0)
        turn = WHEEL_SPIN[diameter] * driven
        return poses(times, WHEEL_START_X - travel * driven, 0.0, turn, scene.bin.z_middle)

    machine = under_load(wheel_load(parameters))
    return Drive(bodies.make_wheel(diameter), pose, machine, rest=REST_FRAMES)
