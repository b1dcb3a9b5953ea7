"""What a motion must keep to, looked at before anything is simulated."""

import math

import numpy as np

from mpm import stability
from mpm.bodies import MAX_LEAN_DEG
from mpm.motions.drive import Drive
from mpm.scenes import CORNER, FRAME_RATE, Bin

# A free wheel is taken to sink this share of the soil's depth where its walls are checked.
SINKAGE = 1.0 / 3.0
WALL_GAP = 0.01  # m between the body and each wall, below the rim
RIM = 0.01  # m above the flat surface


def check_drive(drive: Drive, box: Bin, frames: int, steps_per_frame: int) -> None:
    """Refuses a motion that the bin or the time step does not allow.

    The body's lowest point stays a cell above the floor. What of it is below the rim stays clear
    of the four walls by `WALL_GAP` (a leaning blade's top may stand over the wall behind it). It
    crosses at most half a cell a step, tip and rim included.

    Args:
        drive: the body and its motion.
        box: the bin.
        frames: driven frames of the run, the lead-in left out.
        steps_per_frame: time steps a frame.

    Raises:
        ValueError: with time, value and limit.
    """
    count = (frames + drive.lead_in) * steps_per_frame
    dt = 1.0 / FRAME_RATE / steps_per_frame
    times = np.arange(count + 1) * dt
    poses = np.asarray(drive.pose(times), np.float64)
    if poses.shape != (len(times), 3):
        raise ValueError(f'poses are {poses.shape}, expected (times, 3) = {(len(times), 3)}')
    _refuse(times, ~np.isfinite(poses).all(axis=1), lambda k: f'the pose is {poses[k]}')
    if drive.load is not None:
        load = drive.load(times)
        _refuse(
            times,
            ~(np.isfinite(load) & (load > 0.0)),
            lambda k: f'the load is {load[k]:.4g} N, must be positive',
        )
        poses[:, 1] = box.surface + drive.body.radius - SINKAGE * box.size[1]
    elif drive.body.length:
        lean = np.degrees(-poses[:, 2])
        _refuse(
            times,
            np.abs(lean) > MAX_LEAN_DEG * (1 + 1e-9),
            lambda k: f'the blade leans by {lean[k]:.4g} deg, at most {MAX_LEAN_DEG} are allowed',
        )
    _check_room(drive.body, poses, times, box)
    stability.check_body_motion(poses, drive.body.reach, dt, box.dx, 0.0)


def _check_room(body, poses, times, box) -> None:
    """Refuses a body in the floor or the walls; `poses` [T, 3] at `times` [T]."""
    half = body.half_width + WALL_GAP
    if half > box.size[2] / 2 * (1 + 1e-9):
        raise ValueError(
            f'the body is {2 * body.half_width:.4g} m wide; with {WALL_GAP} m on each side it does '
            f'not fit into the {box.size[2]:.4g} m of the bin'
        )
    x_low, x_high, lowest = extent_below(body, poses, box.surface + RIM)
    floor = CORNER + box.dx
    _refuse(
        times,
        lowest < floor,
        lambda k: (
            f'the body reaches down to y = {lowest[k]:.4f} m, the limit is {floor:.4f} m, a '
            f'cell above the floor (the soil is {box.size[1]:.4g} m deep)'
        ),
    )
    near, far = CORNER + WALL_GAP, CORNER + box.size[0] - WALL_GAP
    _refuse(
        times,
        x_low < near,
        lambda k: (
            f'the body reaches x = {x_low[k]:.4f} m, the limit is {near:.4f} m, '
            f'{WALL_GAP} m away from the wall in front'
        ),
    )
    _refuse(
        times,
        x_high > far,
        lambda k: (
            f'the body reaches x = {x_high[k]:.4f} m below the rim, the limit is '
            f'{far:.4f} m, {WALL_GAP} m away from the wall behind'
        ),
    )


def extent_below(body, poses, height: float):
    """Returns the extent of a body below a height, as seen from the side.

    Args:
        body: `Body`.
        poses: float64 [T, 3].
        height: m.

    Returns:
        Lowest and highest x [T] of what is below `height` (the whole reach of a round end
        that dips below it; +-inf if nothing does) and the lowest y [T], m.
    """
    x, y, theta = np.asarray(poses, np.float64).T
    lowest = y + np.minimum(body.length * np.cos(theta), 0.0) - body.radius
    if body.length == 0.0:
        # The chord of the circle at that height.
        rise = np.clip(height - y, -body.radius, body.radius)
        half = np.where(rise < 0.0, np.sqrt(body.radius**2 - rise**2), body.radius)
        low, high = x - half, x + half
    else:
        # The part of the segment whose round surround reaches below the height.
        upward = np.maximum(np.cos(theta), math.cos(math.radians(MAX_LEAN_DEG)) / 2)
        along = np.clip((height + body.radius - y) / upward, 0.0, body.length)
        top = x - along * np.sin(theta)
        low, high = np.minimum(x, top) - body.radius, np.maximum(x, top) + body.radius
    is_below = lowest < height
    return np.where(is_below, low, np.inf), np.where(is_below, high, -np.inf), lowest


def _refuse(times, is_wrong, describe) -> None:
    """Raises at the first time at which `is_wrong` [T], in the words of `describe`."""
    if is_wrong.any():
        k = int(np.argmax(is_wrong))
        raise ValueError(f'at {times[k]:.3f} s {describe(k)}')
