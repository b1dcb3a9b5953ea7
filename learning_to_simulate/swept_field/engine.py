"""`FieldEngine`: the frames of a swept field for a `live.stepper.Stepper`, at a cost that does not
grow with the length of the path.

A step may last any time, since nothing is integrated, and no particle is computed before it is
asked for.
"""

from typing import Any

import numpy as np

from learning_to_simulate import error_bound
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live.engine import Engine, Frame
from learning_to_simulate.swept_field.field import SweptSoil

# A pose that is farther than this from the one before is a jump, m/s and rad/s.
FASTEST, FASTEST_TURN = 3.0, 20.0


def begin(field, starts, subspace, start, bed=None, blade_width=None):
    """What a tool begins with: the one place where an episode of a user begins.

    Args:
      field: `SweptField`.
      starts, subspace: of the model folder.
      start: `live.starts.Start`. Where it is of a case, the bed is that of the case; so is
        that of a driven wheel, which has sunk in.
      bed: None for that of the start; [N, 3] particles, m; or a `tool.bed.HeightMap`.
      blade_width: m; None for that of the case.

    Returns:
      `Ground`, and the velocity that `Tool.begin` takes.

    Raises:
      ValueError: a context, a width or a bed that cannot be.
    """
    tool, case = field.tool, starts.cases[start.index]
    context = None
    if start.context is not None:
        field.check_contexts(start.context[None])
        context = field.context(start.context)
    if blade_width is not None:
        if tool.predicts_height or not 0 < float(blade_width) < np.inf:
            raise ValueError(f'blade_width is {blade_width}, must be positive, and of a blade')
        case = case | {'blade_width_m': blade_width}
    size = tool.size(field.axes, case, start.nodes(start.pose), context)
    if bed is None:
        bed = bed_of_start(field, starts, subspace, start)
    (u,) = field.axes.plane(start.pose[None])[:, 0]
    return field.ground(u, size, bed), tool.velocity(field.axes, start.velocity, size)


def bed_of_start(field, starts, subspace, start) -> np.ndarray | None:
    """float64 [N, 3], m: the particles that a start has; None for the flat bed."""
    if subspace is None or not (start.is_case or field.tool.predicts_height):
        return None
    modes = starts.modes[start.index][: subspace.n_modes]
    return subspace.decode(modes).astype(np.float64)


class FieldEngine(Engine):
    """Frames of a field by TensorFlow.

    Args:
      field: `SweptField`.
      starts: `live.starts.Starts` of the model folder.
      subspace: of the model folder, or None.
      members: networks that answer; fewer are faster, the mean of all is what was measured.
      name: what it is called.

    Raises:
      ValueError: the model has fewer members.
    """

    def __init__(self, field, starts, subspace=None, members=None, name: str = 'TensorFlow'):
        if members is not None and not 1 <= members <= field.config.members:
            raise ValueError(f'members is {members}, must lie in [1, {field.config.members}]')
        self.scene, self.starts, self.name = field.scene, starts, name
        self._field, self._members, self._space = field, members, subspace
        self._start: Any = None
        # Of the newest frame and of the proposed one: state of the tool, soil, pose, context.
        self._now: Any = None
        self._coming: Any = None
        field.warm_up(members)  # compiles now and not in the first frame

    def begin(self, start, bed=None, blade_width=None) -> Frame:
        if start.velocity is None:
            raise ValueError('a swept field begins from a pose: call start()')
        field = self._field
        ground, speed = begin(field, self.starts, self._space, start, bed, blade_width)
        named = _in_time(field.context(start.context))
        plane = field.tool.poses(field.axes, start.pose[None], named)
        tool, frame = field.tool.begin(
            field.grid, ground.bed, ground.size[None], plane, speed[None]
        )
        judgement = field.limits.judge(field.judged(start.pose[None], frame, self.scene.dt), H - 1)
        self._start = start
        soil = self._soil(frame, plane[0], ground)
        self._now = _frozen((tool, soil, start.pose, start.context))
        return self._frame(judgement, soil, start.pose, np.zeros(3))

    def propose(self, number: int, coming, context=None, dt: float | None = None) -> Frame:
        """See `Engine`: the tool goes in a straight line, within any time."""
        if coming is None:
            raise ValueError(f'the body is {self.scene.rigid_motion}: step() takes a pose')
        field = self._field
        before, was, last, had = self._now
        ground = was.ground
        dt = self.scene.dt if dt is None else float(dt)
        context = had if context is None else context
        if context is not None:
            field.check_contexts(np.stack([had, context]))
        named = _in_time(field.context(context))
        plane = field.tool.poses(field.axes, coming[None], named, was.pose)[0]
        refuse_jump(field, plane, was.pose, dt)
        if not field.tool.predicts_height:
            refuse_floor(field, plane, ground)
        tool, (plane,), frame = field.tool.step(
            field.grid, ground.bed, ground.size[None], before, plane[None], dt,
            lambda known: field.heights(known, self._members),
        )  # fmt: skip
        if field.tool.predicts_height:
            refuse_floor(field, plane, ground)
            coming[field.axes.up] = plane[1]
        loads = field.loads(frame, self._members)
        values = field.judged(coming[None], frame, dt, last)
        judgement = field.limits.judge(values, number, bool(np.isfinite(loads).all()))
        bound = None
        if (weights := field.calibration.get('force')) is not None:
            spread, size = (f(loads[..., :2])[0] for f in (error_bound.spread, error_bound.size))
            bound = float(error_bound.bound(spread, size, weights))
        soil = self._soil(frame, plane, ground)
        self._coming = _frozen((tool, soil, coming, context))
        mean = loads.mean(axis=0)[0, :3].astype(np.float64)
        return self._frame(judgement, soil, coming, mean, bound)

    def _soil(self, frame, plane, ground):
        _frozen((frame, plane, ground))
        return SweptSoil(self._field, frame, plane, ground, self._space, self._members)

    def _frame(self, judgement, soil, pose, loads, bound=None):
        force, torque = _frozen(self._field.axes.world_loads(loads))
        return Frame(judgement, soil, self._start.nodes(pose), pose, force, torque, bound)

    def accept(self) -> None:
        self._now = self._coming

    @property
    def state(self) -> tuple:
        return self._start, self._now

    @state.setter
    def state(self, state: tuple) -> None:
        self._start, self._now = state

    def explain(self) -> str:
        soil = self._now[1]
        moving = int(self._field.may_move(soil.frame, soil.ground.local).sum())
        return left_out(moving, len(soil.ground.points))


def left_out(moving: int, n: int) -> str:
    """Says how many of n particles a frame leaves out."""
    return (
        f'{moving} of {n} particles may have moved; the other {n - moving} '
        f'({100 * (1 - moving / n):.0f} %) are left out, exactly'
    )


def refuse_jump(field, plane, before, dt: float) -> None:
    """Raises ValueError for a pose [K] that no tool reaches from the one before in dt s."""
    if not 0 < dt < np.inf:
        raise ValueError(f'dt is {dt} s: time must go on')
    change = np.abs(plane - before) / dt
    if field.tool.predicts_height:
        change[1] = 0.0  # ignored
    if np.hypot(change[0], change[1]) > FASTEST or change[2] > FASTEST_TURN:
        raise ValueError(
            f'the pose jumps: {np.hypot(change[0], change[1]):.3g} m/s and {change[2]:.3g} '
            f'rad/s, at most {FASTEST} and {FASTEST_TURN} are taken; call start() anew'
        )


def refuse_floor(field, plane, ground) -> None:
    """Raises ValueError for a tool at a pose [K] under the floor of its bed."""
    floor = ground.places[:, 1].min() - field.spacing / 2
    lowest = field.tool.lowest(plane, ground.size)
    if lowest < floor:
        raise ValueError(
            f'the edge would be at {lowest:.4g} m, under the floor of the bed at {floor:.4g} m'
        )


def _in_time(context):
    """A context of one frame as one of a path of that frame."""
    return None if context is None else {name: value[None] for name, value in context.items()}


def _frozen(values):
    """The same values, their arrays closed for writing: the coming frames follow from them."""
    if isinstance(values, np.ndarray):
        values.setflags(write=False)
    elif isinstance(values, tuple):
        for value in values:
            _frozen(value)
    return values
