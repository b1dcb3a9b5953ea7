"""Who gets which engine of a `live.stepper.Stepper`: C where model and machine have it, else
TensorFlow, which then says why.

The C engines give the frames of those of TensorFlow to round-off.
"""

from typing import Any

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live.engine import Frame, SubspaceEngine
from learning_to_simulate.live.soil import Soil, plan_extent
from learning_to_simulate.native import library
from learning_to_simulate.native.binding import CField, CSubspace
from learning_to_simulate.rollout_status import OK
from learning_to_simulate.swept_field import engine as field_engine
from learning_to_simulate.swept_field.engine import FieldEngine

BEST, C, TENSORFLOW = 'best', 'c', 'tensorflow'


def of(model, starts=None, subspace=None, kind: str = BEST, n_rigid: int | None = None):
    """The engine of a model.

    Args:
      model: `subspace_model.Model`, or what a swept field is opened as.
      starts, subspace: of its model folder (`live.starts.read`).
      kind: 'best', 'c' or 'tensorflow'.
      n_rigid: R of the first run, where there are no starts.

    Raises:
      ValueError: an unknown kind; with 'c' a model that has no C form.
      library.NoCompiler: with 'c', where there is no compiler.
    """
    if kind not in (BEST, C, TENSORFLOW):
        raise ValueError(f'engine is {kind!r}, must be one of {(BEST, C, TENSORFLOW)}')
    field, name = getattr(model, 'field', None), 'TensorFlow'
    if kind != TENSORFLOW:
        try:
            if field is not None:
                return CFieldEngine(field, starts, subspace)
            return c_subspace_engine(model, starts, subspace, n_rigid)
        except (ValueError, library.NoCompiler) as error:
            if kind == C:
                raise
            name = f'TensorFlow ({str(error).splitlines()[0]})'
    if field is not None:
        return FieldEngine(field, starts, subspace, name=name)
    return SubspaceEngine(model, starts, subspace, n_rigid, name=name)


def c_subspace_engine(model, starts, subspace, n_rigid, make=CSubspace.of) -> SubspaceEngine:
    """The engine of a model in a subspace whose step is by C; `make` makes the `CSubspace` of
    (model, R)."""
    engine = SubspaceEngine(
        model, starts, subspace, n_rigid, lambda *model_and_size: CStep(make(*model_and_size))
    )
    engine.name = f'C ({engine.step.name})'
    return engine


class CStep:
    """A step of `SubspaceEngine` by the C library: the same frames as `live.engine.TfStep`.

    Args:
      soil: `CSubspace`.
    """

    def __init__(self, soil: CSubspace):
        self._soil, self._before = soil, soil.another()
        self._is_proposed = False

    @property
    def name(self) -> str:
        """The instructions that run."""
        return self._soil.kernel

    def reset(self, history, context) -> None:
        """Starts after the frames float64 [H, V, 3], with a context float64 [C] or None."""
        self._soil.reset(history, context)
        self._is_proposed = False

    def propose(self, body, displacement, context=None):
        """The next frame; arguments and results as of `live.engine.TfStep.propose`, the
        displacement is not needed: the library keeps the body of the last frame."""
        del displacement
        if self._is_proposed:
            self._soil.copy_state(self._before)
        else:
            self._before.copy_state(self._soil)
        self._is_proposed = True
        frame = self._soil.step(body, context)
        return np.concatenate([frame.rigid_pose, frame.modes]), frame.force

    def particles(self) -> np.ndarray:
        """float32 [N, 3], m, of the frame that was computed last, as the library decodes them."""
        return self._soil.particles()

    def accept(self) -> None:
        """Takes the frame that was proposed last as the newest one."""
        self._is_proposed = False

    @property
    def state(self) -> bytes:
        """All that the coming frames follow from; can be put back."""
        return (self._before if self._is_proposed else self._soil).save()

    @state.setter
    def state(self, state: bytes) -> None:
        self._soil.load_state(state)
        self._is_proposed = False


class CFieldSoil(Soil):
    """The soil of a frame of a field in C; nothing is computed before it is asked for.

    Args:
      engine: `CFieldEngine`.
      state: of the library in that frame.
    """

    def __init__(self, engine: 'CFieldEngine', state: bytes):
        self._engine, self._state = engine, state
        self.subspace, self.up_axis, self.extent = engine.subspace, engine.up, engine.extent

    def particles(self) -> np.ndarray:
        """float32 [N, 3], world, m; none of it inside the tool."""
        return self._engine.particles(self._state)


class CFieldEngine:
    """Frames of a swept field by C, as those of `swept_field.engine.FieldEngine`.

    A bed of another number of particles than that of the training has no place in C: runs on it are
    stepped by TensorFlow, and `name` says so.

    Args:
      field: `SweptField`.
      starts, subspace: of the model folder.
      soil: `CField` of the field; None for that of this machine's library.

    Raises:
      ValueError: inputs that C does not know.
      library.NoCompiler, library.CompileFailed: as `library.load`.

    Attributes:
      scene, starts, subspace: as given.
      up, extent: axis against gravity, and what a height map spans, see `live.soil.plan_extent`.
    """

    def __init__(self, field, starts, subspace=None, soil: CField | None = None):
        self.scene, self.starts, self.subspace = field.scene, starts, subspace
        self.up, self.extent = field.axes.up, plan_extent(field.rest, field.axes.up)
        self._field, self._c = field, soil or CField.of(field, starts, subspace)
        self._drawn = self._c.another()  # for particles of any frame, now that of a state
        self._drawn_state = b''
        self._other: FieldEngine | None = None
        self._uses_other = False
        self._start = self._ground = None
        # Of the newest frame and of the proposed one: pose, and state of the library, which is at
        # the proposed one where there is one.
        self._now: Any = None
        self._coming: Any = None

    @property
    def name(self) -> str:
        """What computes the frames."""
        return self._other.name if self._uses_other else f'C ({self._c.kernel})'

    def begin(self, start, bed=None, blade_width=None) -> Frame:
        """Begins from a `live.starts.Start`; as `FieldEngine.begin`."""
        if start.velocity is None:
            raise ValueError('a swept field begins from a pose: call start()')
        field, given = self._field, (self.starts, self.subspace, start)
        ground, _ = field_engine.begin(field, *given, bed, blade_width)
        if len(ground.points) != len(field.rest):
            return self._begin_other(start, bed, blade_width, len(ground.points))
        if self._c.is_wheel:  # the library knows the beds of its starts
            options = {'index': start.index, 'context': start.context}
        else:
            bed = field_engine.bed_of_start(field, *given) if bed is None else bed
            options = {'blade_width': float(ground.size[0])}
        self._c.start(start.pose, start.velocity, bed, **options)
        self._uses_other, self._start, self._ground = False, start, ground
        self._now, self._coming = (start.pose, self._c.save()), None
        return self._proposal(self._judged(H - 1), *self._now, np.zeros(3), np.zeros(3))  # type: ignore[call-arg]

    def _begin_other(self, start, bed, blade_width, n):
        self._other = self._other or FieldEngine(self._field, self.starts, self.subspace)
        wanted = len(self._field.rest)
        self._other.name = f'TensorFlow (the C form takes a bed of {wanted} particles, not {n})'
        first = self._other.begin(start, bed, blade_width)
        self._uses_other = True
        return first

    def _judged(self, number):
        judgement = self._c.judgement
        return judgement if judgement == OK else judgement._replace(frame=number)

    def _proposal(self, judgement, pose, state, force, torque, bound=None):
        for values in (force, torque, pose):
            values.setflags(write=False)
        soil, nodes = CFieldSoil(self, state), self._start.nodes(pose)
        return Frame(judgement, soil, nodes, pose, force, torque, bound)

    def propose(self, number: int, coming, context=None, dt: float | None = None) -> Frame:
        """The frame in which the tool reaches a pose; as `FieldEngine.propose`."""
        if self._uses_other:
            return self._other.propose(number, coming, context, dt)
        if coming is None:
            raise ValueError(f'the body is {self.scene.rigid_motion}: step() takes a pose')
        if self._coming is not None:
            self._c.load_state(self._now[1])
            self._coming = None
        try:
            found = self._c.step(coming, dt, context)
        except ValueError as error:
            self._refuse(coming, context, dt)
            raise ValueError(f'{error}; call start() anew') from None
        if self._c.is_wheel:
            coming[self.up] = found.point[self.up]
        judgement = self._judged(number) if found.status else OK
        self._coming = coming, self._c.save()
        return self._proposal(judgement, *self._coming, found.force, found.torque, found.bound)  # type: ignore[call-arg]

    def accept(self) -> None:
        """Takes the frame that was proposed last as the newest one."""
        if self._uses_other:
            self._other.accept()
        else:
            self._now, self._coming = self._coming, None

    def _refuse(self, coming, context, dt):
        """Raises what Python says of a step that C refuses, with its values and limits."""
        field, named = self._field, None
        if self.scene.context_names:
            now = np.empty(len(self.scene.context_names))
            self._c.call('context', now)
            given = now if context is None else context
            field.check_contexts(np.stack([now, given]))
            named = {k: v[None] for k, v in field.context(given).items()}
        (was,) = field.tool.poses(field.axes, self._now[0][None], named)
        (plane,) = field.tool.poses(field.axes, coming[None], named, was)
        field_engine.refuse_jump(field, plane, was, self.scene.dt if dt is None else float(dt))
        if not self._c.is_wheel:
            field_engine.refuse_floor(field, plane, self._ground)
        radius = self._ground.size[0] if self._c.is_wheel else field.grid.radius
        field.grid.check_within(plane[:1] - self._ground.origin[0], radius)

    def particles(self, state: bytes) -> np.ndarray:
        """float32 [N, 3], m, of a state of the library."""
        self._draw(state)
        return self._drawn.particles()

    def _draw(self, state):
        if state is not self._drawn_state:  # asked again, the library has them already
            self._drawn.load_state(state)
            self._drawn_state = state

    @property
    def state(self) -> tuple:
        """All that the coming frames follow from; what is put back goes on to the same bits."""
        if self._uses_other:
            return self._other, self._other.state
        return None, (self._start, self._ground, *self._now)

    @state.setter
    def state(self, state: tuple) -> None:
        other, kept = state
        self._uses_other = other is not None
        if self._uses_other:
            other.state = kept
            return
        self._start, self._ground, *now = kept
        self._c.load_state(now[1])
        self._now, self._coming = tuple(now), None

    def explain(self) -> str:
        """What the newest frame leaves out."""
        if self._uses_other:
            return self._other.explain()
        self._draw(self._now[1])
        return field_engine.left_out(self._drawn.call('moving'), len(self._field.rest))
