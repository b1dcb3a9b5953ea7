"""What a motion must keep to, looked at before anything is simulated."""

import numpy as np

from mpm import bodies, stability
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
    if poses.shape != (len(times), 4):
        raise ValueError(f'poses are {poses.shape}, expected (times, 4) = {(len(times), 4)}')
    _refuse(times, ~np.isfinite(poses).all(axis=1), lambda k: f'the pose is {poses[k]}')
    if drive.body.is_wheel:
        if drive.machine is not None:
            load = -drive.machine.force(times)[:, 1]
            _refuse(
                times,
                ~(np.isfinite(load) & (load > 0.0)),
                lambda k: f'the load is {load[k]:.4g} N, must be positive',
            )
            poses[:, 1] = box.surface + drive.body.reach - SINKAGE * box.size[1]
    else:
        lean = np.degrees(-poses[:, 2])
        _refuse(
            times,
            np.abs(lean) > MAX_LEAN_DEG * (1 + 1e-9),
            lambda k: f'the tool leans by {lean[k]:.4g} deg, at most {MAX_LEAN_DEG} are allowed',
        )
        if drive.machine is not None and drive.machine.is_free[1]:
            # Where a free tool goes is seen when it is simulated; the target may lie in the soil.
            touching = box.surface - bodies.lowest(drive.body, poses[:, 2])
            poses[:, 1] = np.maximum(poses[:, 1], touching)
    _check_room(drive.body, poses, times, box)
    stability.check_body_motion(poses, drive.body.reach, dt, box.dx, 0.0)


def _check_room(body, poses, times, box) -> None:
    """Refuses a body in the floor or the walls; `poses` [T, 4] at `times` [T]."""
    half = body.half_width + WALL_GAP
    aside = np.abs(poses[:, 3] - box.z_middle)
    _refuse(
        times,
        aside + half > box.size[2] / 2 * (1 + 1e-9),
        lambda k: (
            f'the body is {2 * body.half_width:.4g} m wide and stands {aside[k]:.4g} m beside the '
            f'middle; with {WALL_GAP} m on each side it does not fit into the {box.size[2]:.4g} m '
            'of the bin'
        ),
    )
    x_low, x_high, lowest = bodies.extent_below(body, poses, box.surface + RIM)
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


def _refuse(times, is_wrong, describe) -> None:
    """Raises at the first time at which `is_wrong` [T], in the words of `describe`."""
    if is_wrong.any():
        k = int(np.argmax(is_wrong))
        raise ValueError(f'at {times[k]:.3f} s {describe(k)}')
