"""What a motion must keep to, looked at before anything is simulated."""

from collections.abc import Callable

import numpy as np

from mpm import bodies, stability
from mpm.bodies import MAX_LEAN_DEG
from mpm.motions.drive import Drive
from mpm.scenes import CORNER, FRAME_RATE, FRAMES, Bin

# A free wheel is taken to sink this share of the soil's depth where its walls are checked.
SINKAGE = 1.0 / 3.0
WALL_GAP = 0.01  # m between the body and each wall, below the rim
RIM = 0.01  # m above the flat surface
STEPS_CHECKED = 8  # a frame, of a motion that has just been drawn
TRIES = 200

_FRAMES = FRAMES - 1


def check_drive(drive: Drive, box: Bin, frames: int, steps_per_frame: int) -> None:
    """Refuses a motion of `frames` driven frames that the bin or the time step does not allow.

    The body's lowest point stays a cell above the floor. What of it is below the rim stays clear of
    the four walls by `WALL_GAP` (a leaning blade's top may stand over the wall behind it). It
    crosses at most half a cell a step, tip and rim included. ValueError: with time, value and
    limit.
    """
    count = (frames + drive.lead_in) * steps_per_frame
    dt = 1.0 / FRAME_RATE / steps_per_frame
    times = np.arange(count + 1) * dt
    body, machine, poses = drive.body, drive.machine, np.asarray(drive.pose(times), np.float64)
    _refuse(times, ~np.isfinite(poses).all(axis=1), 'the pose is {}', poses)
    if body.is_wheel:
        if machine is not None:
            load = -machine.force(times)[:, 1]
            is_wrong = ~(np.isfinite(load) & (load > 0.0))
            _refuse(times, is_wrong, 'the load is {:.4g} N, must be positive', load)
            poses[:, 1] = box.surface + body.reach - SINKAGE * box.size[1]
    else:
        lean = np.degrees(-poses[:, 2])
        text = f'the tool leans by {{:.4g}} deg, at most {MAX_LEAN_DEG} are allowed'
        _refuse(times, np.abs(lean) > MAX_LEAN_DEG * (1 + 1e-9), text, lean)
        if machine is not None and machine.is_free[1]:
            # Where a free tool goes is seen when it is simulated; the target may lie in the soil.
            touching = box.surface - bodies.lowest(body, poses[:, 2])
            poses[:, 1] = np.maximum(poses[:, 1], touching)
    half, aside = body.half_width + WALL_GAP, np.abs(poses[:, 3] - box.z_middle)
    _refuse(
        times, aside + half > box.size[2] / 2 * (1 + 1e-9),
        f'the body is {2 * body.half_width:.4g} m wide and stands {{:.4g}} m beside the middle; '
        f'with {WALL_GAP} m on each side it does not fit into the {box.size[2]:.4g} m of the bin',
        aside,
    )  # fmt: skip
    x_low, x_high, lowest = bodies.extent_below(body, poses, box.surface + RIM)
    floor = CORNER + box.dx
    _refuse(
        times, lowest < floor,
        f'the body reaches down to y = {{:.4f}} m, the limit is {floor:.4f} m, a cell above the '
        f'floor (the soil is {box.size[1]:.4g} m deep)', lowest,
    )  # fmt: skip
    near, far = CORNER + WALL_GAP, CORNER + box.size[0] - WALL_GAP
    for is_wrong, x, limit, where in (
        (x_low < near, x_low, near, 'in front'), (x_high > far, x_high, far, 'behind'),
    ):  # fmt: skip
        _refuse(
            times, is_wrong,
            f'the body reaches x = {{:.4f}} m below the rim, the limit is {limit:.4f} m, '
            f'{WALL_GAP} m away from the wall {where}', x,
        )  # fmt: skip
    stability.check_body_motion(poses, body.reach, dt, box.dx, 0.0)


def _refuse(times, is_wrong, text, values) -> None:
    """Raises at the first time at which `is_wrong` [T]; the text names the value there."""
    if is_wrong.any():
        k = int(np.argmax(is_wrong))
        raise ValueError(f'at {times[k]:.3f} s {text.format(values[k])}')


def first_that_fits(
    draw: Callable[[], tuple[Drive, dict]],
    box: Bin,
    what: str,
    is_fine: Callable[[Drive, dict], bool] = lambda drive, drawn: True,
) -> tuple[Drive, dict]:
    """Returns the first of `TRIES` drawn motions (and their parameters, `frames` among them if they
    are not as usual) that the bin has room for, and that `is_fine`. ValueError, with `what` is
    drawn: there is none."""
    for _ in range(TRIES):
        drive, drawn = draw()
        try:
            check_drive(drive, box, drawn.get('frames', _FRAMES), STEPS_CHECKED)
        except ValueError:
            continue
        if is_fine(drive, drawn):
            return drive, drawn
    raise ValueError(f'none of {TRIES} motions of {what} fits into the bin')
