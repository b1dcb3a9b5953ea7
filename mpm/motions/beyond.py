"""Runs that leave in one way what the data of record hold; see `reports.beyond`.

A seed is the number of a run: its soil, tool, speed, depth, lean or load lies outside of what any
other kind draws, or the tool goes sideways, towards a wall, along a slope, or turns on the spot.
The usual run leaves nothing, to compare with. No model learns from them.
"""

import numpy as np

from mpm import bodies, scenes
from mpm.motions import grid
from mpm.motions.drive import Drive, poses, under_load

KIND = 'beyond'
USUAL_DEG = scenes.Ground().friction_angle_deg
# Changes of `_blade` and `_wheel`.
BLADES = {
    'loose': {'friction_deg': 20.0},
    'firm': {'friction_deg': 48.0},
    'narrow': {'width': 0.08},
    'fast': {'speed': 0.7},
    'deep': {'depth': 0.13},
    'forward': {'lean': -50.0},
    'aside': {'aside': 0.06},
    'wall': {'end': 0.14, 'speed': 0.16},
    'uphill': {'slope': 15.0},
    'downhill': {'slope': -15.0},
    'usual': {},
    'turns': {'end': 0.5, 'turn': 40.0},
}
WHEELS = {
    'loose': {'friction_deg': 20.0},
    'firm': {'friction_deg': 48.0},
    'fast': {'speed': 0.6, 'slip': 0.9},
    'heavy': {'load': 900.0},
    'grousers': {'grousers': {'count': 12, 'height': 0.03, 'thickness': 0.01}, 'radius': 0.11},
    'wide': {'radius': 0.04, 'width': 0.17, 'load': 60.0},
    'aside': {'aside': 0.034},
    'uphill': {'slope': 15.0},
    'downhill': {'slope': -15.0},
    'usual': {},
    'spins': {'slip': 1.0},
}
NAMES = {'excavation': tuple(BLADES), 'wheel': tuple(WHEELS)}  # in the order of their numbers


def beyond_drive(
    scene: scenes.Scene, kind: str, seed: int, tool: dict | None = None
) -> tuple[Drive, dict]:
    """Returns the drive of a number and its parameters, JSON-compatible; `plot` names it.

    ValueError: there is no such number, or a tool of its own is asked for.
    """
    names = NAMES[scene.name]
    if seed >= len(names) or tool is not None:
        raise ValueError(f'{kind} has the runs 0 to {len(names) - 1}, each with its own tool')
    plot = names[seed]
    if scene.rigid_motion == 'prescribed':
        drive, parameters = _blade(scene.bin, **BLADES[plot])
    else:
        drive, parameters = _wheel(scene, **WHEELS[plot])
    return drive, {'plot': plot, **parameters}


def _blade(
    box, speed=0.1, depth=0.04, lean=15.0, aside=0.0, end=0.35, width=bodies.BLADE_WIDTH,
    friction_deg=USUAL_DEG, slope=0.0, turn=0.0,
):  # fmt: skip
    """Down to a depth (m) in 0.6 s, then on at a mean speed (m/s) to x = end, by then `aside` m;
    the top leans back by `lean` degrees, then within 1 s by `turn` more."""
    body = bodies.make_blade(width)
    upright = -np.radians(lean)
    start_x, clearance = box.size[0], 0.006

    def pose(times):
        gone = np.clip(speed * (times - 0.6) / (start_x - end), 0.0, 1.0)
        way = (start_x - end) * gone**2 * (3.0 - 2.0 * gone)
        down = np.clip(times / 0.6, 0.0, 1.0)
        y = box.surface - bodies.lowest(body, upright) + clearance - down * (depth + clearance)
        z = box.z_middle + aside * way / (start_x - end)
        turned = np.clip(times - 0.6 - (start_x - end) / speed, 0.0, 1.0)
        return poses(times, start_x - way, y, upright - np.radians(turn) * turned, z)

    ground = {'friction_angle_deg': friction_deg, 'slope_deg': slope}
    return Drive(body, pose), {'blade_width_m': width, 'ground': ground}


def _wheel(
    scene, speed=0.03, slip=0.3, load=164.0, radius=0.075, width=bodies.WHEEL_WIDTH, grousers=None,
    aside=0.0, friction_deg=37.0, slope=0.0,
):  # fmt: skip
    """On at a rim speed (m/s) and a slip for 0.18 m, by then `aside` m, under a load (N)."""
    tool = {'name': 'wheel', 'radius': radius, 'width': width}
    tool = bodies.check_tool(tool | ({} if grousers is None else {'grousers': grousers}))
    far, box = 0.18, scene.bin

    def pose(times):
        turned = speed * np.clip(times - 0.3, 0.0, None)
        way = np.minimum((1.0 - slip) * turned, far)
        z = box.z_middle + aside * way / far
        return poses(times, grid.WHEEL_START_X - way, 0.0, turned / radius, z)

    drive = Drive(bodies.tool_body(tool), pose, under_load(load), rest=grid.REST_FRAMES)
    context = scene.parameters(scene.demo_case) | {
        'diameter_m': 2.0 * radius, 'load_N': load, 'tool': tool,
        'friction_angle_deg': friction_deg, 'ground': {'slope_deg': slope},
    }  # fmt: skip
    del context['slip_percent']
    return drive, context
