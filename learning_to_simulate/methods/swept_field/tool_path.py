"""What a blade has swept so far, updated frame by frame: the state that a swept field knows.

Everything is relative to the first position of the tool along its way and to the level of the bed,
so shifting the whole scene changes nothing. One frame costs the same however long the path is.
`xp` is numpy, or `tensors` in a TensorFlow graph, where nothing is refused.
"""

from typing import NamedTuple

import numpy as np

from learning_to_simulate.methods import swept_features
from learning_to_simulate.methods.swept_features import SweptBed, SweptGrid

# Memories of the velocity, s: soil and force answer to what the tool did just before.
TIME_SCALES = (0.05, 0.2)
# A place counts as fully cut below this depth, m; between, its influence grows with the depth, so
# that nothing jumps when the tool first touches the soil.
TOUCH = 0.002
# Soil farther than this from all that was cut has not moved, m.
REACH = 0.35
# How steeply the zone that has moved rises away from the cut: rise per length.
RISE = 0.5
# Channels of `Frame.bins`.
CUT, SURFACE, SINCE, AREA_BEFORE, INFLUENCE, DISTURBED = range(6)
CHANNELS = 6
SCALARS = (
    'tip', 'height', 'lean', 'speed', 'rise', 'turn',
    *(f'{name}_{i}' for i in range(len(TIME_SCALES)) for name in ('speed', 'rise', 'turn')),
    'area', 'foremost', 'half_width', 'end', 'room',
)  # fmt: skip


class Bed(NamedTuple):
    """The beds that B tools begin on.

    Attributes:
      surface: float64 [B, n] height at `grid.offsets` from the tool's first position, m.
      level: float64 [B], the height that all heights are counted from, m.
      end: float64 [B], u of the wall that the tool drives towards, m; far away where there is none.
    """

    surface: np.ndarray
    level: np.ndarray
    end: np.ndarray


class ToolState(NamedTuple):
    """State of B tools; a function of bed and poses so far.

    Attributes:
      swept: see `swept_features.SweptBed`.
      lean: float64 [B], rad, positive where the top lies behind.
      velocity: float64 [B, 3], of u and height (m/s) and lean (rad/s), in the last frame.
      memory: float64 [B, K, 3], the same, faded with each of the `TIME_SCALES`.
      area_before: float64 [B, n], swept area (m2) when a bin was first cut; 0 where it was not.
    """

    swept: SweptBed
    lean: np.ndarray
    velocity: np.ndarray
    memory: np.ndarray
    area_before: np.ndarray


class Frame(NamedTuple):
    """What the networks see of one or more frames of B tools.

    Attributes:
      bins: float32 [B, n, CHANNELS]: depth of the cut, height of the untouched surface, distance
        travelled since the last passage, swept area before the first one, influence of all cuts
        in [0, 1], depth to which soil may have moved; m.
      scalars: float32 [B, len(SCALARS)]; lengths in m from the tool's first place and the level;
        `room` is what is left between the foremost place of the tool and the wall.
    """

    bins: np.ndarray
    scalars: np.ndarray


def start(grid: SweptGrid, bed: Bed, pose, velocity=None, xp=np) -> ToolState:
    """The state before any motion.

    Args:
      grid: bins along the way.
      bed: of the tools.
      pose: [B, 3] u and height (m) of the middle of the lower edge, lean (rad).
      velocity: [B, 3] of these, which the tools have had for long; None: at rest.
      xp: numpy or `tensors`.

    Raises:
      ValueError: shapes that do not fit, or values that are not finite.
    """
    velocity = xp.zeros_like(pose) if velocity is None else velocity
    if xp is np:
        pose = _checked(pose, None)
        velocity = _checked(velocity, len(pose))
    swept = swept_features.start(grid, pose[:, :2], bed.surface, xp)
    memory = xp.stack([velocity] * len(TIME_SCALES), axis=1)
    return ToolState(swept, pose[:, 2], velocity, memory, xp.zeros_like(swept.surface))


def advance(grid: SweptGrid, state: ToolState, pose, dt, xp=np, finer=None) -> ToolState:
    """Moves the tools in a straight line to their next poses.

    Args:
      grid: of `start`.
      state: before; it is not changed.
      pose: [B, 3] as in `start`.
      dt: duration, s.
      xp: numpy or `tensors`.
      finer: see `swept_features.advance`.

    Raises:
      ValueError: a duration that is not positive; poses that are not finite or leave the bins.
    """
    if xp is np:
        if not 0 < dt < np.inf:
            raise ValueError(f'a frame must last longer than 0 s, got {dt}: time does not go back')
        pose = _checked(pose, len(state.lean))
    before = state.swept
    after = swept_features.advance(grid, before, pose[:, :2], dt, xp, finer)
    was_cut, is_cut = before.profile < before.surface, after.profile < after.surface
    area = swept_features.swept_area(grid, before, xp)[:, None]
    velocity = xp.concatenate([after.velocity, (pose[:, 2:] - state.lean[:, None]) / dt], axis=1)
    # Exact for a velocity that is constant within the frame, so the frame rate hardly matters.
    fade = xp.exp(-dt / np.array(TIME_SCALES))[:, None]
    return ToolState(
        after,
        pose[:, 2],
        velocity,
        fade * state.memory + (1 - fade) * velocity[:, None],
        xp.where(is_cut & ~was_cut, area, state.area_before),
    )


def frame(grid: SweptGrid, bed: Bed, blade_width, state: ToolState, xp=np) -> Frame:
    """What the networks see of a state.

    Args:
      grid, bed: of the state.
      blade_width: [B] m.
      state: of B tools.
      xp: numpy or `tensors`; tensors keep the type of the state.
    """
    swept = state.swept
    cut = swept.surface - swept.profile
    spread = cone(xp.minimum(cut / TOUCH, 1.0), grid.spacing / REACH, xp)
    bins = xp.stack(
        [
            cut,
            swept.surface - bed.level[:, None],
            xp.minimum(swept.travelled[:, None] - swept.last, grid.forget),
            state.area_before,
            xp.clip(3.0 * spread, 0.0, 1.0),
            cone(cut, RISE * grid.spacing, xp),
        ],
        axis=-1,
    )
    of_path = xp.stack(
        [
            swept_features.swept_area(grid, swept, xp),
            swept.foremost - swept.origin,
            xp.broadcast_to(blade_width, swept.origin.shape) / 2,
            bed.end - swept.origin,
            bed.end - swept.foremost,
        ],
        axis=1,
    )
    scalars = xp.concatenate(
        [
            swept.position - xp.stack([swept.origin, bed.level], axis=1),
            state.lean[:, None],
            state.velocity,
            *(state.memory[:, i] for i in range(len(TIME_SCALES))),
            of_path,
        ],
        axis=1,
    )
    return Frame(xp.asarray(bins, np.float32), xp.asarray(scalars, np.float32))


def frames(grid: SweptGrid, bed: Bed, blade_width, pose, dt: float, velocity=None) -> Frame:
    """All frames of whole paths, `Frame` of [T, B, ...] for poses [T, B, 3]; the velocity [B, 3] of
    `start` is by default that to the second pose."""
    pose = np.asarray(pose, np.float64)
    if velocity is None and len(pose) > 1:
        velocity = (pose[1] - pose[0]) / dt
    state = start(grid, bed, pose[0], velocity)
    found = [frame(grid, bed, blade_width, state)]
    for coming in pose[1:]:
        state = advance(grid, state, coming, dt)
        found.append(frame(grid, bed, blade_width, state))
    return Frame(*map(np.stack, zip(*found, strict=True)))


def cone(values, fall, xp=np):
    """The largest of all values [B, n], each lowered by `fall` per bin of distance."""
    index = fall * np.arange(values.shape[1])
    forward = xp.maximum.accumulate(values + index, axis=1) - index
    backward = xp.maximum.accumulate((values - index)[:, ::-1], axis=1)[:, ::-1] + index
    return xp.maximum(forward, backward)


def _checked(pose, count):
    pose = np.asarray(pose, np.float64)
    if pose.ndim != 2 or pose.shape[1] != 3 or count not in (None, len(pose)):
        raise ValueError(f'poses have shape {pose.shape}, [{count or "B"}, 3] was expected')
    if not np.isfinite(pose).all():
        raise ValueError(f'a pose is not finite: {pose[~np.isfinite(pose).all(axis=1)][0]}')
    return pose
