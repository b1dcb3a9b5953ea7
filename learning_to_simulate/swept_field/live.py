"""`LiveField`: a swept field that follows a tool pose by pose, and `FieldRoller`: whole paths.

    live = lts.load('excavation_v2/swept_field').stepper()
    live.start(pose)                      # on the flat bed; or start(pose, bed=...)
    frame = live.step(next_pose)          # force and torque; no particle is computed
    points = frame.particles()            # only where they are asked for

As `live.LiveSoil`, with two differences: a step may last any time, since nothing is integrated, and
`state` can be kept and put back. Frames of a whole path do not wait for each other: all loads come
from one call.
"""

import dataclasses
import threading
from typing import NamedTuple

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live import poses, resting_start
from learning_to_simulate.live.frame_judge import worse
from learning_to_simulate.live.live_soil import Beginning
from learning_to_simulate.live.path_rollout import SoilRollout, of_recorded_run, velocity_between
from learning_to_simulate.live.stepping import FLAG, HOLD, RAISE, Frame, Held
from learning_to_simulate.rollout_status import Judgement, RolloutStatus
from learning_to_simulate.swept_field import calibration
from learning_to_simulate.swept_field.field import FieldSoil, Swept, SweptFrames
from learning_to_simulate.tool.bed import Ground

# A pose that is farther than this from the one before is a jump, m/s and rad/s.
FASTEST, FASTEST_TURN = 3.0, 20.0


def stepper(path: str, model, outside: str = FLAG) -> 'LiveField':
    """A `LiveField` of a model folder and the model that was loaded from it.

    Raises:
      FileNotFoundError, ValueError: as `resting_start.read`.
    """
    return LiveField(model.field, *resting_start.read(path), outside=outside)


def roller(path: str, model) -> 'FieldRoller':
    """A `FieldRoller` of a model folder; arguments as of `stepper`."""
    return FieldRoller(model.field, *resting_start.read(path))


def begin(field, starts, subspace, chosen, is_given, bed=None, blade_width=None, contexts=None):
    """What a tool of a start begins with: the one place where an episode of a user begins.

    Args:
      field: `SweptField`.
      starts, subspace: of the model folder.
      chosen: `Beginning`.
      is_given: whether a case was asked for, whose bed it then is; so is that of a driven wheel,
        which has sunk in.
      bed, blade_width: see `LiveField.start`.
      contexts: [T, C] of the frames, or None.

    Returns:
      `Ground`, and the velocity that `Tool.begin` takes.

    Raises:
      ValueError: a context, a width or a bed that cannot be.
    """
    tool, case = field.tool, starts.cases[chosen.index]
    context = None
    if chosen.context is not None:
        contexts = chosen.context[None] if contexts is None else contexts
        field.check_contexts(contexts)
        context = field.context(contexts[0])
    if blade_width is None:
        size = tool.size(field.axes, case, chosen.nodes(chosen.pose), context)
    elif 0 < float(blade_width) < np.inf:
        size = field.blade.size(field.axes, {'blade_width_m': blade_width})
    else:
        raise ValueError(f'blade_width is {blade_width}, must be positive')
    if bed is None and subspace is not None and (is_given or tool.predicts_height):
        modes = starts.modes[chosen.index][: subspace.n_modes]
        bed = subspace.decode(modes).astype(np.float64)
    (u,) = field.axes.plane(chosen.pose[None])[:, 0]
    return field.ground(u, size, bed), tool.velocity(field.axes, chosen.velocity, size)


class LiveState(NamedTuple):
    """All that a field knows of its tool; its arrays cannot be written to.

    Attributes:
      beginning: the body, and which start it began from.
      ground: what it began on.
      tool: state of one tool, see `Tool.begin`.
      frame: the newest.
      count: frames since the start.
      context: float64 [C] in that frame, or None.
    """

    beginning: Beginning
    ground: Ground
    tool: tuple
    frame: Frame
    count: int
    context: np.ndarray | None


class LiveField:
    """Steps a field with poses.

    Args:
      field: `SweptField`.
      starts: `resting_start.Starts` of the model folder.
      subspace: of the model folder, or None.
      members: networks that answer; fewer are faster, the mean of all is what was measured.
      outside: what is done with a frame that is not `ok`: 'flag' goes on and says so, 'hold' stays
        in the frame before, 'raise' refuses it.

    Raises:
      ValueError: so many members there are not; an unknown `outside`.
    """

    def __init__(self, field, starts, subspace=None, members=None, outside: str = FLAG):
        if members is not None and not 1 <= members <= field.config.members:
            raise ValueError(f'members is {members}, must lie in [1, {field.config.members}]')
        if outside not in (FLAG, HOLD, RAISE):
            raise ValueError(f'outside is {outside!r}, must be one of {(FLAG, HOLD, RAISE)}')
        self._field, self._members, self._outside = field, members, outside
        self._starts, self._space = starts, subspace
        self._lock = threading.Lock()
        self.soil = FieldSoil(field, subspace, members)
        self._state: LiveState | None = None
        field.warm_up(members)  # compiles now and not in the first frame

    @property
    def dt(self) -> float:
        """Seconds of a frame where nothing else is said."""
        return self._field.scene.dt

    @property
    def state(self) -> LiveState:
        """What is kept can be put back, and goes on from there to the same bits.

        Raises:
          ValueError: before `start`.
          RuntimeError: put back while another thread is at work here.
        """
        if self._state is None:
            raise ValueError('call start() before step()')
        return self._state

    @state.setter
    def state(self, state: LiveState) -> None:
        with Held(self._lock):
            self._state = state

    @property
    def cases(self) -> list:
        """Numbers or names of the recorded starts' cases."""
        return [values.get('case') for values in self._starts.cases]

    @property
    def start_index(self) -> int | None:
        """Which of the recorded starts the run began from; None before `start`."""
        return None if self._state is None else self._state.beginning.index

    def start(
        self, pose=None, velocity=None, case=None, context=None, bed=None, blade_width=None
    ) -> Judgement:
        """Begins where the tool is; returns how the start is to be judged.

        Args:
          pose: of the tool now (see `live.poses`); None for that of the case.
          velocity: [3] or [6] of the tool now; None for one at rest.
          case: of the dataset, for its bed and its tool; None for the flat bed.
          context: [C] or {name: value}, where the scene has one; None for that of the case.
            Gravity and load must be positive.
          bed: None for that of the case; [N, 3] particles, m; or a `beds.HeightMap`.
          blade_width: m; None for that of the case.

        Raises:
          ValueError: something that cannot be used; the state stays as it was.
          RuntimeError: another thread is at work here.
        """
        with Held(self._lock):
            return self._start(pose, velocity, case, context, bed, blade_width)

    def _start(self, pose, velocity, case, context, bed, blade_width):
        field = self._field
        chosen = Beginning(field.scene, self._starts, field.scene.n_modes)
        chosen.choose(pose, velocity, case, context)
        ground, speed = begin(
            field, self._starts, self._space, chosen, case is not None, bed, blade_width
        )
        named = _in_time(field.context(chosen.context))
        plane = field.tool.poses(field.axes, chosen.pose[None], named)
        tool, frame = field.tool.begin(
            field.grid, ground.bed, ground.size[None], plane, speed[None]
        )
        values = field.judged(chosen.pose[None], frame, field.scene.dt)
        judgement = field.limits.judge(values, H - 1)
        first = self._frame(
            Swept(frame, plane[0], ground), chosen, chosen.pose, np.zeros(3), None, judgement,
            judgement,
        )  # fmt: skip
        self._state = _frozen(LiveState(chosen, ground, tool, first, 0, chosen.context))
        return judgement

    def step(self, pose, context=None, dt: float | None = None) -> Frame:
        """Moves the tool in a straight line to its next pose.

        Args:
          pose: see `live.poses`; of a driven wheel the height is ignored.
          context: [C] or {name: value} in the coming frame and those after it, where it changes; of
            a wheel only the load may. None leaves it as it was.
          dt: s; None for the frame time of the training data.

        Returns:
          `stepping.Frame`; its `bound` is what the root mean square error of the force per
          component keeps in 95 % of frames like those of valid.

        Raises:
          ValueError: before `start`; not a pose, a jump, a time that does not pass, a place beyond
            the bins or under the floor; another soil or planet, or a load that is not positive;
            with `outside='raise'` a frame that is not `ok`. The state stays as it was.
          RuntimeError: another thread is at work here.
        """
        with Held(self._lock):
            return self._step(pose, context, dt)

    def _step(self, pose, context, dt):
        before, field = self.state, self._field
        ground, was = before.ground, before.frame
        dt = field.scene.dt if dt is None else float(dt)
        context = before.context if context is None else self._changed(context, before)
        pose = before.beginning.read(pose)
        named = _in_time(field.context(context))
        plane = field.tool.poses(field.axes, pose[None], named, was.modes.pose)[0]
        self._refuse_bad(plane, before, dt)
        tool, (plane,), frame = field.tool.step(
            field.grid, ground.bed, ground.size[None], before.tool, plane[None], dt,
            lambda known: field.heights(known, self._members),
        )  # fmt: skip
        if field.tool.predicts_height:
            self._refuse_floor(plane, before)
            pose[field.axes.up] = plane[1]
        loads = field.loads(frame, self._members)
        values = field.judged(pose[None], frame, dt, was.pose)
        finite = bool(np.isfinite(loads).all())
        judgement = field.limits.judge(values, H + before.count, finite)
        if judgement.status != RolloutStatus.OK and self._outside != FLAG:
            if self._outside == RAISE:
                raise ValueError(
                    f'{judgement.status}: {judgement.reason}; the state stays as it was'
                )
            held = before.frame._replace(
                judgement=worse(before.frame.judgement, judgement), now=judgement.status
            )
            self._state = before._replace(frame=held)
            return held
        bound = None
        if (weights := field.calibration.get('force')) is not None:
            spread, size = (f(loads[..., :2])[0] for f in (calibration.spread, calibration.size))
            bound = float(calibration.bound(spread, size, weights))
        result = self._frame(
            Swept(frame, plane, before.ground), before.beginning, pose,
            loads.mean(axis=0)[0, :3].astype(np.float64), bound,
            worse(before.frame.judgement, judgement), judgement,
        )  # fmt: skip
        self._state = _frozen(
            before._replace(tool=tool, frame=result, count=before.count + 1, context=context)
        )
        return result

    def _frame(self, swept, beginning, pose, loads, bound, judgement, now):
        force, torque = self._field.axes.world_loads(loads)
        return Frame(
            swept, force, beginning.nodes(pose), judgement, now.status, self.soil, pose, torque,
            bound,
        )  # fmt: skip

    def _refuse_bad(self, plane, before, dt):
        """Raises ValueError for poses that no tool can reach."""
        field = self._field
        if not 0 < dt < np.inf:
            raise ValueError(f'dt is {dt} s: time must go on')
        change = np.abs(plane - before.frame.modes.pose) / dt
        if field.tool.predicts_height:
            change[1] = 0.0  # ignored
        if np.hypot(change[0], change[1]) > FASTEST or change[2] > FASTEST_TURN:
            raise ValueError(
                f'the pose jumps: {np.hypot(change[0], change[1]):.3g} m/s and {change[2]:.3g} '
                f'rad/s, at most {FASTEST} and {FASTEST_TURN} are taken; call start() anew'
            )
        if not field.tool.predicts_height:
            self._refuse_floor(plane, before)

    def _refuse_floor(self, plane, before):
        """Raises ValueError for a tool that would be under the floor."""
        field, ground = self._field, before.ground
        floor = ground.places[:, 1].min() - field.spacing / 2
        lowest = field.tool.lowest(plane, ground.size)
        if lowest < floor:
            raise ValueError(
                f'the edge would be at {lowest:.4g} m, under the floor of the bed at {floor:.4g} m'
            )

    def _changed(self, context, before):
        """The context [C] of a coming frame; raises as `SweptField.check_contexts`."""
        context = before.beginning.read_context(context)
        self._field.check_contexts(np.stack([before.context, context]))
        return context

    def particles(self) -> np.ndarray:
        """float32 [N, 3] of the soil now, world, m; none of it inside the tool."""
        return self.state.frame.particles()

    def body(self, pose) -> np.ndarray:
        """float64 [R', 3], m: all particles of the tool at a pose, for drawing; raises before
        `start`."""
        beginning = self.state.beginning
        return poses.placed(beginning.body, beginning.read(pose))

    def explain(self) -> str:
        """What the newest frame leaves out."""
        swept = self.state.frame.modes
        moving = self._field.may_move(swept.frame, swept.ground.local).sum()
        n = len(swept.ground.points)
        return (
            f'{moving} of {n} particles may have moved; the other {n - moving} '
            f'({100 * (1 - moving / n):.0f} %) are left out, exactly'
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


class FieldRoller:
    """Rolls out paths.

    Args:
      field: `SweptField`.
      starts, subspace: of the model folder.
    """

    def __init__(self, field, starts, subspace=None):
        self._field, self._starts, self._space = field, starts, subspace
        self._soil = FieldSoil(field, subspace)

    def beginning(self, path, velocity=None, case=None, context=None):
        """The start of a path, its poses, whether it begins on the bed of a case, and its context
        [T, C] or None; as `live.path_rollout.PathRoller.beginning`. Raises for contexts as
        `SweptField.check_contexts`."""
        values = poses.numbers('path', path, (None, 7), (None, 3))
        if len(values) < 2:
            raise ValueError(f'a path of {len(values)} poses has no step, at least two are needed')
        scene, contexts = self._field.scene, None
        if np.ndim(context) == 2 and scene.context_names:
            shape = (len(values), len(scene.context_names))
            contexts = poses.numbers('context', context, shape)
            context = contexts[0]
        chosen = Beginning(scene, self._starts, scene.n_modes)
        chosen.choose(case=case, context=context)
        values = np.stack([chosen.read(pose) for pose in values])
        if velocity is None:
            velocity = velocity_between(values[0], values[1], scene.dt)
        chosen.choose(values[0], velocity, case, context)
        if contexts is None and chosen.context is not None:
            contexts = np.repeat(chosen.context[None], len(values), axis=0)
        if contexts is not None:
            self._field.check_contexts(contexts)
        return chosen, values, case is not None, contexts

    def roll_out(self, begun) -> list[SoilRollout]:
        """Rolls out paths of `beginning`.

        Raises:
          ValueError: a path that leaves the bins.
        """
        return [self._rolled(*one) for one in begun]

    def recorded(self, evaluator, group, name: str) -> SoilRollout:
        """The rollout of a recorded run, with its truth.

        Args:
          evaluator: `FieldEvaluator` of its split.
          group: one-run `RunGroup`.
          name: for files and titles.
        """
        rollout = evaluator.roll_out(group)
        found = of_recorded_run(group, rollout, self._field.scene, self._soil, name)
        return dataclasses.replace(found, modes=SweptFrames(rollout.swept[H:], self._soil))

    def _rolled(self, chosen, path, is_given, contexts) -> SoilRollout:
        field = self._field
        ground, speed = begin(
            field, self._starts, self._space, chosen, is_given, contexts=contexts
        )
        plane = field.tool.poses(field.axes, path, field.context(contexts))
        plane, frames = field.frames(ground, plane, field.scene.dt, speed)
        path = path.copy()
        path[:, field.axes.up] = plane[:, 1]
        loads = field.loads(frames).mean(axis=0)
        force, torque = field.axes.world_loads(loads[:, :3])
        values, finite = field.judged(path, frames, field.scene.dt), np.isfinite(loads).all(axis=1)
        swept = [
            Swept(frames.at(slice(t, t + 1)), plane[t], ground) for t in range(1, len(plane))
        ]
        body = np.stack([poses.placed(chosen.body, p) for p in [*chosen.past(), *path[1:]]])
        return SoilRollout(
            history=chosen.history(),
            modes=SweptFrames(swept, self._soil),
            force=force[1:].astype(np.float32),
            rigid_nodes=body[H:, chosen.kept],
            judgement=field.limits.judge(values, H - 1, finite.all()),
            frame_status=tuple(field.limits.statuses(values, finite)[1:]),
            body=body,
            scene=field.scene,
            soil=self._soil,
            torque=torque[1:].astype(np.float32),
        )
