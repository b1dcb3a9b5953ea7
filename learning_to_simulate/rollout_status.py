"""How far a frame and a rollout can be trusted: `RolloutStatus`, `Judgement`; `Ranges` of named
numbers, and `NodeRanges`, which judges a frame of a model in a subspace.

`judge` of these is the one place where a frame is held against the training runs; whole rollouts
are a loop over it. `lts_status.c` and `lts_soil_step.c` are their twins.
"""

import enum
from typing import NamedTuple

import numpy as np

from learning_to_simulate import normalization
from learning_to_simulate.axes import without_height
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.scene import RigidMotion

# A predicted node may leave the hull of its training positions by half of it on either side, and a
# force may exceed the largest of the training runs by as much.
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
    LEFT_BOUNDS: a predicted node left the hull of its training positions times two, or the force
      is above twice the largest of the training runs.
    NON_FINITE: a position or a force is infinite or NaN.
    """

    OK = 'ok'
    EXTRAPOLATING = 'extrapolating'
    LEFT_BOUNDS = 'left_bounds'
    NON_FINITE = 'non_finite'


_RANK = {status: rank for rank, status in enumerate(RolloutStatus)}


class Judgement(NamedTuple):
    """The status of a frame or of a run.

    Attributes:
      frame: index of the first frame in which it holds; -1 where the status is OK.
      node: index of a node in which it holds there; -1 for the force, the context, or the body as
        a whole.
      reason: the value and its limits, in words; '' where the status is OK.
    """

    status: RolloutStatus
    frame: int = -1
    node: int = -1
    reason: str = ''

    def fields(self) -> dict:
        """As it stands in metrics.json and in rollout files."""
        names = 'status', 'first_bad_frame', 'first_bad_node', 'status_reason'
        return dict(zip(names, (str(self.status), *self[1:])))


OK = Judgement(RolloutStatus.OK)


class Judged:
    """A rollout of a name with a judgement: how far it can be trusted, and in words why not."""

    judgement: Judgement
    name: str

    def __repr__(self) -> str:
        reason = f' ({self.reason})' if self.reason else ''
        return f'<rollout {self.name!r}: {len(self)} frames, {self.status}{reason}>'

    @property
    def status(self) -> RolloutStatus:
        return self.judgement.status

    @property
    def reason(self) -> str:
        return self.judgement.reason


def worse(one: Judgement, other: Judgement) -> Judgement:
    """The worse of two judgements; the first where they are equally bad."""
    return other if _RANK[other.status] > _RANK[one.status] else one


def widened(low, high, factor):
    """A range [..., D] stretched by `factor` about its middle; still axes have a floor."""
    middle, half = (low + high) / 2, (high - low) / 2
    half = np.maximum(half, SPAN_FLOOR * half.max(axis=-1, keepdims=True))
    half = np.maximum(half, ROUNDING * np.maximum(np.abs(low), np.abs(high)))
    return middle - factor * half, middle + factor * half


def outside(status: RolloutStatus, measure: str, value: float, low: float, high: float) -> str:
    """Why a value has a status; low and high are the range of training, not the wider one in which
    all is well."""
    twice = 'twice ' if status == RolloutStatus.LEFT_BOUNDS else ''
    value += 0.0  # a 0 without sign
    return f'{measure} {value:.4g} is outside {twice}[{low:.4g}, {high:.4g}] of training'


class Ranges(NamedTuple):
    """Ranges of J named numbers over the training runs.

    Attributes:
      low, high: float64 [J].
      limits: float64 [2, J] least and most that is not outside: somewhat wider.
    """

    names: tuple[str, ...]
    low: np.ndarray
    high: np.ndarray
    limits: np.ndarray

    def outside(self, values) -> np.ndarray:
        """bool [T, J] of values [T, J]; of fewer columns, of the first numbers."""
        least, most = self.limits[:, : values.shape[1]]
        return ~((values >= least) & (values <= most))

    def judge(self, values, first: int = 0, finite: bool = True) -> Judgement:
        """The first of frames from number `first` on, with values [T, J], that is outside, and why;
        NON_FINITE where not all that was predicted is finite."""
        if not finite:
            return Judgement(RolloutStatus.NON_FINITE, first, -1, 'a prediction is not finite')
        bad = self.outside(values)
        if not bad.any():
            return OK
        (frame, i), status = np.argwhere(bad)[0], RolloutStatus.EXTRAPOLATING
        reason = outside(status, self.names[i], values[frame, i], self.low[i], self.high[i])
        return Judgement(status, first + int(frame), -1, reason)


def _limits(limits, factor):
    """[4, ...]: least and most that is not outside, and the range of training [2, ...]."""
    return np.stack([*widened(*limits, factor), *limits])


class NodeRanges:
    """The ranges of a model's training runs by their statistics, for bodies of R particles. The
    scene says what of the body's motion is given; `force_limit` is the largest force of the
    training runs, N, or None if it is not known.

    Attributes:
      bounds, start_limits: [4, V, D] of predicted nodes, and of those of a start: least and most
        that is not outside, then the range of training.
      context: [4, C], likewise, or None.
      motion: the same of a given body, or None: [4, D] of its coordinates, its displacements, its
        extent, and [4, 1] of the root mean square of its displacement.
      force: [4, 1] likewise of the size of the force, N, or None if its limit is not known.
    """

    def __init__(self, n_rigid: int, statistics, scene, force_limit: float | None = None):
        self._n, self._scene = n_rigid, scene
        # Of a body whose whole motion is given nothing is predicted.
        self._first = n_rigid if scene.rigid_motion == RigidMotion.PRESCRIBED else 0
        node_class = normalization.node_classes(n_rigid, scene.n_modes)
        # Soil particles share one range, modes have one each.
        node_class = np.minimum(node_class, statistics.position_range.shape[1] - 1)
        extra = 1 + 2 * RANGE_MARGIN
        self.bounds = _limits(statistics.position_range, BOUNDS_FACTOR)[:, node_class]
        self.start_limits = _limits(statistics.position_range, extra)[:, node_class]
        self.force = None
        if force_limit is not None:
            self.force = np.array([[0.0], [BOUNDS_FACTOR * force_limit], [0.0], [force_limit]])
        self._driven = scene.rigid_motion == RigidMotion.DRIVEN
        self.context = self.motion = None
        if statistics.context_range is not None:
            low, high = statistics.context_range
            more = RANGE_MARGIN * np.abs(low), RANGE_MARGIN * np.abs(high)
            self.context = np.stack([low - more[0], high + more[1], low, high])
        if scene.rigid_motion.is_known and statistics.given_range is not None:
            self.motion = [
                _limits(getattr(statistics, f'{name}_range'), extra)
                for name in ('given', 'given_velocity', 'body_extent', 'body_speed')
            ]

    def history(self, frames, contexts) -> Judgement:
        """The worst judgement of frames float64 [H, V, D], m, that are given as a whole; arguments
        of `start`: of each frame its context [C], None where it is that of the frame before."""
        found = OK
        for k, (frame, context) in enumerate(zip(frames, contexts)):
            before = frames[k - 1, : self._n] if k else None
            found = worse(found, self.start(frame, context, before, k))
        return found

    def start(self, position, context=None, before=None, frame: int = 0) -> Judgement:
        """The judgement of a frame of a number that is given as a whole: position float64 [V, D],
        m, context [C] or None, and the body in the frame before [R, D], m (None where there is none
        or it rests)."""
        return (
            self._unlike_context(frame, context)
            or _first_outside(RolloutStatus.EXTRAPOLATING, position, self.start_limits, frame)
            or self._unlike_motion(frame, position[: self._n], before)
            or OK
        )

    def judge(
        self, frame: int, position, force=None, body=None, before=None, context=None
    ) -> Judgement:
        """The judgement of a predicted frame of a number: positions float64 [V, D], m; force [D]
        (or [B D] of several bodies), N, or None; the body [R, D], m, as it was given in this frame
        and in the one before, None where its motion is predicted; the context [C] in this frame, or
        None where it is that of the last frame."""
        return (
            self._predicted(frame, position, force)
            or self._unlike_context(frame, context)
            or self._unlike_motion(frame, body, before)
            or OK
        )

    def _predicted(self, frame, position, force):
        bad, left = RolloutStatus.NON_FINITE, RolloutStatus.LEFT_BOUNDS
        if not (finite := np.isfinite(position).all(axis=1)).all():
            return Judgement(bad, frame, int((~finite).argmax()), 'position is not finite')
        if force is not None and not np.isfinite(force).all():
            return Judgement(bad, frame, -1, 'force is not finite')
        n = self._first
        if found := _first_outside(left, position[n:], self.bounds[:, n:], frame, n):
            return found
        if force is None or self.force is None:
            return None
        size, most = float(np.linalg.norm(np.asarray(force, float))), self.force[1, 0]
        if size <= most:
            return None
        reason = f'force {size:.4g} N is above {BOUNDS_FACTOR:g} x the largest of training'
        return Judgement(left, frame, -1, f'{reason} ({most:.4g} N)')

    def _unlike_context(self, frame, context):
        if self.context is None or context is None:
            return None
        ranges = Ranges(self._scene.context_names, *self.context[2:], self.context[:2])
        found = ranges.judge(context[None], frame)
        return None if found is OK else found

    def _unlike_motion(self, frame, body, before):
        if self.motion is None or body is None:
            return None
        if self._driven:  # the height is not given: the up component holds the shape only
            up = self._scene.up_axis
            body = without_height(body, up)
            before = None if before is None else without_height(before, up)
        rows = [('coordinate', body, 0, 0), ('extent of the body', np.ptp(body, 0)[None], 2, -1)]
        if before is not None:
            step = body - before
            speed = np.sqrt(np.einsum('rd,rd->', step, step) / len(step)).reshape(1, 1)
            rows.insert(1, ('displacement', step, 1, 0))
            rows.append(('displacement of the body', speed, 3, -1))
        found = (
            _first_outside(RolloutStatus.EXTRAPOLATING, x, self.motion[which], frame, node, name)
            for name, x, which, node in rows
        )
        return next(filter(None, found), None)


def _first_outside(status, values, limits, frame, first_node=0, name='coordinate'):
    """The first of values [V, D] outside limits ([4, V, D] or [4, D]), or None; m, displacements
    per frame."""
    bad = ~((values >= limits[0]) & (values <= limits[1]))
    if not bad.any():
        return None
    node, axis = (int(i) for i in np.argwhere(bad)[0])
    low, high = (np.broadcast_to(x, values.shape)[node, axis] for x in limits[2:])
    measure = f'{name} {"xyz"[axis]} (m)' if values.shape[1] == 3 else f'{name} (m)'
    reason = outside(status, measure, values[node, axis], low, high)
    return Judgement(status, frame, node + first_node, reason)


def judge(
    group, position, force, statistics, scene, force_limit: float | None = None
) -> list[Judgement]:
    """The status of each rolled-out run of a `RunGroup` of S runs, whose first H frames, body and
    context were the inputs: of predicted frames float64 [S, T - H, V, D], m, and forces [S, T - H,
    F], or None; `force_limit` as of `NodeRanges`."""
    n = group.n_rigid
    ranges = NodeRanges(n, statistics, scene, force_limit)
    judgements = []
    for run, given in enumerate(group.position):
        contexts = [
            group.context_at(k, run) if not k or group.context_changes else None
            for k in range(len(given))
        ]
        found = ranges.history(given[:H], contexts)
        for k in range(H, len(given)):
            of_frame = None if force is None else force[run, k - H]
            now = ranges.judge(
                k, position[run, k - H], of_frame, given[k, :n], given[k - 1, :n], contexts[k]
            )
            found = worse(found, now)
        judgements.append(found)
    return judgements
