"""`FrameJudge`: the status of a rollout frame by frame, as cheap as a few small numpy calls.

The limits are those of `rollout_status`, which judges finished rollouts; here every frame is held
against them as it comes, with the given motion before the frame is computed.
"""

import numpy as np

from learning_to_simulate import normalization
from learning_to_simulate.body_height import without_height
from learning_to_simulate.rollout_status import (
    BOUNDS_FACTOR,
    RANGE_MARGIN,
    Judgement,
    RolloutStatus,
    first_outside,
    outside_context,
    widened,
)
from learning_to_simulate.scene import RigidMotion

OK = Judgement(RolloutStatus.OK)
_RANK = {status: rank for rank, status in enumerate(RolloutStatus)}
# A force may exceed the largest of the training runs by this factor; positions have one as well.
FORCE_FACTOR = BOUNDS_FACTOR


def worse(one: Judgement, other: Judgement) -> Judgement:
    """The worse of two judgements; the first where they are equally bad."""
    return other if _RANK[other.status] > _RANK[one.status] else one


class FrameJudge:
    """Judges starts and frames of one body size.

    Args:
      n_rigid: R.
      statistics: of the training runs.
      scene: says what of the body's motion is given.
      force_limit: N, the largest force of the training runs, or None if it is not known.

    Attributes:
      statistics: as given.
    """

    def __init__(self, n_rigid: int, statistics, scene, force_limit: float | None = None):
        self._n, self.statistics, self._scene = n_rigid, statistics, scene
        self._first = n_rigid if scene.rigid_motion == RigidMotion.PRESCRIBED else 0
        node_class = normalization.node_classes(n_rigid, scene.n_modes)
        lowest, highest = statistics.position_range
        low, high = widened(lowest, highest, BOUNDS_FACTOR)
        self._bounds = low[node_class[self._first :]], high[node_class[self._first :]]
        extra = 1 + 2 * RANGE_MARGIN
        low, high = widened(lowest, highest, extra)
        self._start = low[node_class], high[node_class]
        self._force_limit = None if force_limit is None else FORCE_FACTOR * force_limit
        self._driven = scene.rigid_motion == RigidMotion.DRIVEN
        self._given = scene.rigid_motion.is_known and statistics.given_range is not None
        if self._given:
            limits = (
                statistics.given_range, statistics.given_velocity_range,
                statistics.body_extent_range, statistics.body_speed_range,
            )  # fmt: skip
            self._limits = [widened(low, high, extra) for low, high in limits]

    def start(self, position, context, displacement=None) -> Judgement:
        """The judgement of a start.

        Args:
          position: float64 [..., V, D], m, of the frames that are there; the newest last.
          context: [C] or None.
          displacement: [R, D], m, of the body into the newest frame, or None if it is at rest.
        """
        found = [outside_context(context, self.statistics, self._scene)]
        position = position.reshape(-1, *position.shape[-2:])
        found.append(first_outside(RolloutStatus.EXTRAPOLATING, position, *self._start))
        body = position[-1, : self._n]
        before = None if displacement is None else body - displacement
        found.append(self.given(0, body, before))
        return next((judgement for judgement in found if judgement), OK)

    def context(self, frame: int, context) -> Judgement | None:
        """What is unlike the training runs in the context [C] of a frame, or None."""
        return outside_context(context, self.statistics, self._scene, frame)

    def given(self, frame: int, body, before, in_words: bool = True) -> Judgement | None:
        """What is unlike the training runs in the given motion of a frame, or None.

        Args:
          frame: its number, for the judgement.
          body: float64 [R, D], m, the particles of the body in the frame.
          before: [R, D] in the frame before; None where there is none.
          in_words: whether a reason is wanted, which costs four times the check.
        """
        if not self._given:
            return None
        if self._driven:  # the height is not given: the up component holds the shape only
            up = self._scene.up_axis
            body = without_height(body, up)
            before = None if before is None else without_height(before, up)
        (low, high), *moving, (slowest, fastest) = self._limits
        extent = body.max(axis=0) - body.min(axis=0)
        good = ((body >= low) & (body <= high)).all()
        good &= ((extent >= moving[1][0]) & (extent <= moving[1][1])).all()
        if before is not None:
            step = body - before
            square = np.einsum('rd,rd->', step, step) / len(step)
            good &= ((step >= moving[0][0]) & (step <= moving[0][1])).all()
            good &= max(slowest[0], 0.0) ** 2 <= square <= fastest[0] ** 2
        if good:
            return None
        if not in_words:
            return Judgement(RolloutStatus.EXTRAPOLATING, frame)
        return self._worded(frame, body, before, extent)

    def _worded(self, frame, body, before, extent):
        """The same once more, slowly, for a judgement with its reason."""
        rows = [('coordinate', body, 0, 0), ('extent of the body', extent[None], 2, -1)]
        if before is not None:
            speed = np.sqrt(((body - before) ** 2).sum(axis=-1).mean()).reshape(1, 1)
            rows += [
                ('displacement', body - before, 1, 0),
                ('displacement of the body', speed, 3, -1),
            ]
        for name, values, which, node in rows:
            found = first_outside(
                RolloutStatus.EXTRAPOLATING, values[None], *self._limits[which], frame, node, name
            )
            if found:
                return found
        return None

    def predicted(self, frame: int, position, force, torque=None) -> Judgement:
        """The judgement of what was predicted.

        Args:
          frame: its number.
          position: float64 [V, D], m.
          force: [D], N, or None.
          torque: [D], N m, or None.
        """
        low, high = self._bounds
        inside = ((position[self._first :] >= low) & (position[self._first :] <= high)).all()
        size = 0.0 if force is None else float(np.dot(force, force)) ** 0.5
        limit = np.inf if self._force_limit is None else self._force_limit
        turns = torque is None or np.isfinite(torque).all()
        if inside and size <= limit and np.isfinite(size) and turns:
            return OK
        if not np.isfinite(position).all():
            node = int((~np.isfinite(position).all(axis=1)).argmax())
            return Judgement(RolloutStatus.NON_FINITE, frame, node, 'position is not finite')
        if not np.isfinite(size):
            return Judgement(RolloutStatus.NON_FINITE, frame, -1, 'force is not finite')
        if not turns:
            return Judgement(RolloutStatus.NON_FINITE, frame, -1, 'torque is not finite')
        values = position[None, self._first :]
        outside = first_outside(RolloutStatus.LEFT_BOUNDS, values, low, high, frame, self._first)
        if outside:
            return outside
        reason = f'force {size:.4g} N is above {FORCE_FACTOR:g} x the largest of training'
        return Judgement(RolloutStatus.LEFT_BOUNDS, frame, -1, f'{reason} ({limit:.4g} N)')
