"""The runs of each scene, as `pca_tools.write_raw` takes them; coarse cells, seconds a run."""

import numpy as np

from mpm import bodies
from mpm.constitutive import friction_coefficient, make_soil
from mpm.scenes import CORNER, Bin
from reports.scenes.box import Box, Moving

DX = 0.04  # m
SOIL = make_soil(1.5e6, friction_coefficient(35.0))
SPLITS = ('train',) * 6 + ('valid', 'test', 'test')  # of nine runs, and of every nine more
# Shares of a parameter's range, in the order of SPLITS: the test runs lie within.
SHARES = (0.0, 1.0, 0.5, 0.25, 0.75, 0.1, 0.4, 0.35, 0.65)


def _between(low, high, run, turn=0):
    """A parameter of a run; another `turn` gives another order of the runs."""
    if run >= len(SPLITS):
        share = np.random.default_rng([run, turn]).random()
    else:
        share = SHARES[(run + turn) % 6] if run < 6 else SHARES[6 + (run + turn) % 3]
    return low + (high - low) * share


def split_of(run):
    """The split of a run."""
    return SPLITS[run % len(SPLITS)]


def _column(run, rate, frames, width, lattice, flat=False):
    """A column at a wall falls, thrown off it at a speed that differs from run to run."""
    speed = _between(0.0, 0.8, run)
    room = Bin((0.96, 0.4, width), DX, (0, 0, 0), 1, 0.48, ())
    block = Bin((0.2, 0.24, width), DX, lattice, 1, 0.48, ())
    box = Box(room, block, SOIL, smooth_sides=flat)
    box.particles[:, 3] = speed
    frames_of = []
    for _ in range(frames):
        frames_of.append(box.particles[:, :3].copy())
        box.frame(1 / rate)
    positions = np.stack(frames_of)
    if flat:  # one plane of the particles across
        positions = positions[:, :: lattice[2], :2]
    return {'positions': positions.astype(np.float32), 'split': split_of(run),
            'parameters': {'speed_m_s': speed}}  # fmt: skip


def column(run):
    """No body, no force, no context; three dimensions, 120 frames a second."""
    return _column(run, 120, 60, 0.2, (8, 10, 8))


def column_2d(run):
    """The same in a plane, 90 frames a second."""
    return _column(run, 90, 60, 2 * DX, (14, 16, 2), flat=True)


def lengths(run):
    """Columns whose runs are of different lengths."""
    return _column(run, 120, (60, 45, 75)[run % 3], 0.2, (8, 10, 8))


def _bin(length, keep=3):
    room = Bin((length, 0.12, 0.48), DX, (0, 0, 0), keep, 0.4, ())
    return Box(
        room, Bin((length, 0.12, 0.48), DX, (round(40 * length), 5, 20), keep, 0.4, ()), SOIL
    )


def _sampled(body, columns):
    """A blade with so many columns of points: wide blades have more of them."""
    rows = body.points.reshape(4, 5, 3)[:, :1] * [1, 1, 0]
    across = np.linspace(-0.8, 0.8, columns)[None, :, None] * body.half_width * [0, 0, 1]
    return body._replace(points=(rows + across).reshape(-1, 3))


def _pushed(run, start, width=0.36, columns=5):
    """A blade that is let down and pushed towards -x."""
    depth, speed = _between(0.015, 0.05, run), _between(0.15, 0.4, run, turn=2)
    body = _sampled(bodies.make_blade(CORNER + 0.24, width), columns)

    def pose(t):
        down = CORNER + 0.12 + body.radius - depth * np.clip(t / 0.3, 0.0, 1.0)
        return np.stack([start - speed * t, down, 0.1 + 0 * t], axis=1)

    return Moving(body, pose), {'depth_m': depth, 'speed_m_s': speed}


def _recorded(box, moving, frames, rate, keep=3):
    """Frames of a box and its bodies: positions, points [T, R, 3], forces [T, B, 3]."""
    positions, points, forces = [], [], []
    for _ in range(frames):
        forces.append(box.frame(1 / rate, moving))
        positions.append(box.particles[::keep, :3].copy())
        points.append(np.concatenate([box.points(m) for m in moving]))
    return (np.stack(x).astype(np.float32) for x in (positions, points, forces))


def widths(run):
    """Two blades of different width, of 12 and of 20 points; a force, no context."""
    wide = run % 2
    box = _bin(0.8)
    moving, parameters = _pushed(run, CORNER + 0.7, (0.2, 0.36)[wide], (3, 5)[wide])
    box.settle()
    positions, points, forces = _recorded(box, [moving], 60, 60)
    return {'positions': positions, 'rigid_positions': points, 'force': forces[:, 0],
            'split': split_of(run),
            'parameters': parameters | {'width_m': (0.2, 0.36)[wide]}}  # fmt: skip


def load(run):
    """A wheel under a load that changes while it drives: a context in time."""
    box = _bin(0.8)
    wheel = bodies.make_wheel(0.3, CORNER + 0.24)
    first, last = _between(100.0, 400.0, run), _between(400.0, 100.0, run, turn=2)
    speed = _between(0.1, 0.25, run, turn=1)

    def at(t):
        return first + (last - first) * 0.5 * (1 - np.cos(2 * np.pi * np.clip(t, 0, 1)))

    def pose(t):
        return np.stack([CORNER + 0.6 - speed * t, 0 * t, 1.25 * speed * t / 0.15], axis=1)

    box.settle(wheel, CORNER + 0.12 + 0.15 + 0.03, pose(np.zeros(1))[0], at(0.0))
    positions, points, forces = _recorded(box, [Moving(wheel, pose, at)], 60, 60)
    loads = at(np.arange(1, 61) / 60)[:, None].astype(np.float32)
    return {'positions': positions, 'rigid_positions': points, 'force': forces[:, 0],
            'context': {'load': float(loads[0, 0])}, 'step_context': loads,
            'split': split_of(run), 'parameters': {'speed_m_s': speed}}  # fmt: skip


def pair(run):
    """A blade, and a wheel that rolls behind it at a given height: two bodies in one bin."""
    box = _bin(1.2)
    blade, parameters = _pushed(run, CORNER + 0.6)
    wheel = bodies.make_wheel(0.3, CORNER + 0.24)
    speed, sunk = _between(0.1, 0.3, run, turn=1), _between(0.005, 0.02, run, turn=3)

    def pose(t):
        down = CORNER + 0.12 + 0.15 - sunk * np.clip(t / 0.3, 0.0, 1.0)
        return np.stack([CORNER + 1.0 - speed * t, down, speed * t / 0.15], axis=1)

    box.settle()
    positions, points, forces = _recorded(box, [blade, Moving(wheel, pose)], 60, 60)
    return {'positions': positions, 'rigid_positions': points, 'force': forces.sum(axis=1),
            'body_force': forces, 'split': split_of(run),
            'parameters': parameters | {'wheel_speed_m_s': speed,
                                        'wheel_sinkage_m': sunk}}  # fmt: skip
