"""`RolloutStatus`: how far a rollout can be trusted, judged on the host after the compiled loop.

The judgement costs no time per step: it looks at finished arrays, at the motion and context that
were given, and at the ranges of the training runs (`normalization.Statistics`).
"""

import enum
from typing import NamedTuple

import numpy as np

from learning_to_simulate import loads, normalization
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH
from learning_to_simulate.scene import RigidMotion

# A predicted node may leave the hull of its training positions by half of it on either side.
BOUNDS_FACTOR = 2.0
# Given values may leave their training range by this share of it: float32 records of one speed
# differ in the fifth digit.
RANGE_MARGIN = 0.01
# An axis counts as at least this wide, as a share of the widest axis of its node: what runs across
# a symmetric scene is noise, and twice the range of noise is no bound.
SPAN_FLOOR = 0.05
# ... and as a share of the values themselves: differences of float32 records round.
ROUNDING = 1e-4


class RolloutStatus(enum.StrEnum):
    """How a rollout ended, from best to worst; the worst that holds is reported.

    OK: finite, inside the bounds, and driven by inputs like those of the training runs.
    EXTRAPOLATING: the start, the given motion of the body or the context lie outside the range of
      the training runs; nothing is known about the error there.
    LEFT_BOUNDS: a predicted node left the hull of its training positions times two.
    NON_FINITE: a position, a force or a torque is infinite or NaN.
    """

    OK = 'ok'
    EXTRAPOLATING = 'extrapolating'
    LEFT_BOUNDS = 'left_bounds'
    NON_FINITE = 'non_finite'


class Judgement(NamedTuple):
    """The status of one run.

    Attributes:
      status: `RolloutStatus`.
      frame: index of the first frame in which it holds; -1 where the status is OK.
      node: index of a node in which it holds there; -1 for the force, the context, or the body as
        a whole.
      reason: the value and its limits, in words; '' where the status is OK.
    """

    status: RolloutStatus
    frame: int = -1
    node: int = -1
    reason: str = ''


def judge(group, position, load, statistics, scene) -> list[Judgement]:
    """The status of each rolled-out run of a group.

    Args:
      group: `RunGroup` of S runs, whose first H frames, body and context were the inputs.
      position: float64 [S, T - H, V, D], the predicted frames.
      load: [S, T - H, F] force, and torque behind it where there is one; or None.
      statistics: of the training runs.
      scene: says what of the body's motion is given.

    Returns:
      S judgements.
    """
    given = normalization.given_body(group.position, scene)
    return [
        _non_finite(position[run], None if load is None else load[run], statistics)
        or _outside_bounds(position[run], group.n_rigid, statistics, scene)
        or _outside_training(group, run, given, statistics, scene)
        or Judgement(RolloutStatus.OK)
        for run in range(len(position))
    ]


def widened(low, high, factor):
    """A range [..., D] stretched by `factor` about its middle; still axes have a floor."""
    middle, half = (low + high) / 2, (high - low) / 2
    half = np.maximum(half, SPAN_FLOOR * half.max(axis=-1, keepdims=True))
    half = np.maximum(half, ROUNDING * np.maximum(np.abs(low), np.abs(high)))
    return middle - factor * half, middle + factor * half


def _non_finite(position, load, statistics):
    bad = ~np.isfinite(position).all(axis=2)
    if load is not None:
        bad = np.concatenate([bad, ~np.isfinite(load).all(axis=1, keepdims=True)], axis=1)
    if not bad.any():
        return None
    frame = int(bad.any(axis=1).argmax())
    node = int(bad[frame].argmax())
    name = 'position'
    if node == position.shape[1]:
        force, _ = loads.split(load[frame], statistics)
        node, name = -1, 'torque' if np.isfinite(force).all() else 'force'
    return Judgement(
        RolloutStatus.NON_FINITE, frame + INPUT_SEQUENCE_LENGTH, node, f'{name} is not finite'
    )


def _outside_bounds(position, n_rigid, statistics, scene):
    first = n_rigid if scene.rigid_motion == RigidMotion.PRESCRIBED else 0
    node_class = normalization.node_classes(n_rigid, scene.n_modes)[first:]
    low, high = (x[node_class] for x in widened(*statistics.position_range, BOUNDS_FACTOR))
    return first_outside(
        RolloutStatus.LEFT_BOUNDS, position[:, first:], low, high, INPUT_SEQUENCE_LENGTH, first
    )


def _outside_training(group, run, given, statistics, scene):
    """The earliest of what lies outside the training range: context, start, given motion."""
    extra = 1 + 2 * RANGE_MARGIN
    context = None if group.context is None else group.context[run]
    found = [outside_context(context, statistics, scene)]
    node_class = normalization.node_classes(group.n_rigid, scene.n_modes)
    low, high = (x[node_class] for x in widened(*statistics.position_range, extra))
    start = group.position[run, :INPUT_SEQUENCE_LENGTH]
    found.append(first_outside(RolloutStatus.EXTRAPOLATING, start, low, high))
    if given is not None:
        body = given[run]
        extent, speed = (x[0, :, None] for x in normalization.body_measures(body[None]))
        for name, values, limits, node in (
            ('coordinate', body, statistics.given_range, 0),
            ('displacement', np.diff(body, axis=0), statistics.given_velocity_range, 0),
            # The body as a whole is no node.
            ('extent of the body', extent, statistics.body_extent_range, -1),
            ('displacement of the body', speed, statistics.body_speed_range, -1),
        ):
            low, high = widened(*limits, extra)
            first = len(body) - len(values)  # a displacement belongs to the later frame
            found.append(
                first_outside(RolloutStatus.EXTRAPOLATING, values, low, high, first, node, name)
            )
    found = [judgement for judgement in found if judgement]
    return min(found, key=lambda judgement: judgement.frame, default=None)


def outside_context(context, statistics, scene, first_frame: int = 0) -> Judgement | None:
    """The first value of a context [C] or [T, C] that the training runs did not cover, or None."""
    if statistics.context_range is None or context is None:
        return None
    low, high = statistics.context_range
    context = np.atleast_2d(context)
    margins = RANGE_MARGIN * np.abs(low), RANGE_MARGIN * np.abs(high)
    inside = (context >= low - margins[0]) & (context <= high + margins[1])
    if inside.all():
        return None
    frame, i = (int(k) for k in np.argwhere(~inside)[0])
    reason = f'{scene.context_names[i]} {context[frame, i]:.4g} is outside '
    reason += f'[{low[i]:.4g}, {high[i]:.4g}] of training'
    return Judgement(RolloutStatus.EXTRAPOLATING, first_frame + frame, -1, reason)


def first_outside(status, values, low, high, first_frame=0, first_node=0, name='coordinate'):
    """The first of `values` [T, V, D] outside [low, high] ([V, D] or [D]), or None.

    Values and limits are in m, displacements per frame.
    """
    bad = ~((values >= low) & (values <= high))
    if not bad.any():
        return None
    frame, node, axis = (int(i) for i in np.argwhere(bad)[0])
    low, high = (np.broadcast_to(x, values.shape[1:])[node, axis] for x in (low, high))
    reason = f'{name} {"xyz"[axis] if values.shape[2] == 3 else ""}'.strip()
    reason += f' {values[frame, node, axis]:.4g} m is outside [{low:.4g}, {high:.4g}] m'
    return Judgement(status, frame + first_frame, node + first_node, reason)
