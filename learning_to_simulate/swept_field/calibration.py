"""How far a prediction can be trusted: what training knew.

A frame is judged by numbers, each within limits: the scalars of the path, which training had within
some range, and `CONDITIONS`, which all of training had as they should be and which no network sees:
whether the tool stands upright in the plane of travel, over the middle of the bed, on a bed of
usual heights, in frames of a usual length. In the air all conditions are free.
"""

import numpy as np

from learning_to_simulate.rollout_status import Ranges

# Share of its training range by which a scalar may leave it.
MARGIN = 0.05
# What no network sees: name -> (least, most). The tool's rotation out of the plane of travel, rad
# (2 degrees); its distance from the middle plane of the bed, m (particles are about so far apart);
# speed across over speed; lowest and highest place of the bed from its level, m (cuts and heaps of
# training, rounded up); duration of a frame, s (twice the shortest memory of the velocity).
CONDITIONS = {
    'yaw': (-0.035, 0.035),
    'roll': (-0.035, 0.035),
    'aside': (-0.02, 0.02),
    'drift': (0.0, 0.05),
    'bed_low': (-0.15, 0.15),
    'bed_high': (-0.15, 0.15),
    'frame_time': (0.0, 0.1),
}
# What ranges hold at least, and models may leave out; `pressed` is (20) of `tool.blade`, m.
USUAL = CONDITIONS | {'pressed': (0.0, 0.02)}
# Below this speed (m/s) a drift is a share of it: a tool that stands may tremble.
LEAST_SPEED = 0.04


def limits_of(ranges: dict, scalars) -> Ranges:
    """What frames of a field are judged by: scalars, then `CONDITIONS`.

    Args:
      ranges: name -> (low, high) of a model; those of `USUAL` it may leave out.
      scalars: names. Their ranges are widened by `MARGIN` of themselves, all by rounding.

    Raises:
      KeyError: a scalar has no range.
    """
    names = (*scalars, *CONDITIONS)
    low, high = np.array([(USUAL | ranges)[name] for name in names], float).T
    is_scalar = np.arange(len(names)) < len(scalars)
    extra = np.where(is_scalar, MARGIN * (high - low), 0.0) + 1e-6
    return Ranges(names, low, high, np.stack([low - extra, high + extra]))


def conditions(axes, pose, before, dt, frames, in_soil) -> np.ndarray:
    """Scalars and `CONDITIONS` [T, J] of frames, as `Ranges` judges them.

    Args:
      axes: of the scene.
      pose: [T, 7] of the tool, world.
      before: [T, 7] likewise, one frame before; its own pose in a first frame.
      dt: s, a number or [T].
      frames: `swept.Frame` of them; its bins' second channel is the surface from the level.
      in_soil: bool [T]: whether the tool may touch soil; where not, conditions are 0.
    """
    pose, before = np.asarray(pose, float), np.asarray(before, float)
    turned = axes.sideways(pose)
    step = axes.points(pose[:, :3]) - axes.points(before[:, :3])
    way = np.hypot(step[:, 0], step[:, 1])
    surface = frames.bins[..., 1]
    found = np.stack(
        [
            *turned.T,
            axes.points(pose[:, :3])[:, 2],
            np.abs(step[:, 2]) / np.maximum(way, LEAST_SPEED * dt),
            surface.min(axis=1),
            surface.max(axis=1),
            np.broadcast_to(dt, len(pose)),
        ],
        axis=1,
    )
    return np.concatenate([frames.scalars, np.where(in_soil[:, None], found, 0.0)], axis=1)
