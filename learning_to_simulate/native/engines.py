"""Who gets which engine of a `live.stepper.Stepper`: C where model and machine have it, else
TensorFlow, which then says why.

The C engines give the frames of those of TensorFlow to round-off.
"""

import numpy as np

from learning_to_simulate.live.engine import Proposal, SubspaceEngine
from learning_to_simulate.live.soil import plan_extent, surface
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
    field = getattr(model, 'field', None)
    name = 'TensorFlow'
    if kind != TENSORFLOW:
        try:
            if field is not None:
                return CFieldEngine(field, starts, subspace)
            engine = SubspaceEngine(model, starts, subspace, n_rigid, CStep)
            engine.name = f'C ({engine.step.name})'
            return engine
        except (ValueError, library.NoCompiler) as error:
            if kind == C:
                raise
            reason = str(error).splitlines()[0]
            name = f'TensorFlow ({reason})'
    if field is not None:
        return FieldEngine(field, starts, subspace, name=name)
    return SubspaceEngine(model, starts, subspace, n_rigid, name=name)


class CStep:
    """A step of `SubspaceEngine` by the C library: the same frames as `live.engine.TfStep`.

    Args:
      model: `subspace_model.Model`; its weights are taken as they are now.
      n_rigid: R, rigid particles that are nodes.

    Raises:
      ValueError: a model that has no C form.
      library.NoCompiler, library.CompileFailed: as `library.load`.
    """

    def __init__(self, model, n_rigid: int):
        self._soil = CSubspace.of(model, n_rigid)
        self._before = self._soil.another()
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


class CFieldSoil:
    """The soil of a frame of a field in C; nothing is computed before it is asked for.

    Args:
      engine: `CFieldEngine`, in whose newest frame it is until `keep`.
    """

    def __init__(self, engine: 'CFieldEngine'):
        self._engine = engine
        self._state: bytes | None = None
        self.subspace = engine.subspace

    def keep(self, state: bytes) -> None:
        """Takes the state of its frame: the engine goes on."""
        self._state = state

    @property
    def modes(self) -> np.ndarray:
        """float64 [r, 3] scores of the particles, m; ValueError without a subspace."""
        return self._engine.encoded(self.particles())

    def particles(self) -> np.ndarray:
        """float32 [N, 3], world, m; none of it inside the tool."""
        return self._engine.particles(self, self._state)

    def height_map(self, nx: int, nz: int) -> np.ndarray:
        """float32 [nx, nz] heights of the surface, m; as `live.soil.ModesSoil.height_map`."""
        return surface(self.particles(), self._engine.extent, self._engine.up, nx, nz)


class CFieldEngine:
    """Frames of a swept field by C, as those of `swept_field.engine.FieldEngine`.

    A bed of another number of particles than that of the training has no place in C: runs on it are
    stepped by TensorFlow, and `name` says so.

    Args:
      field: `SweptField`.
      starts, subspace: of the model folder.
      kernel: of `binding.CField`.

    Raises:
      ValueError: inputs that C does not know.
      library.NoCompiler, library.CompileFailed: as `library.load`.

    Attributes:
      scene, starts, subspace: as given.
      up, extent: axis against gravity, and what a height map spans, see `live.soil.plan_extent`.
    """

    def __init__(self, field, starts, subspace=None, kernel: str = 'best'):
        self.scene, self.starts = field.scene, starts
        self.up, self.extent = field.axes.up, plan_extent(field.rest, field.axes.up)
        self._field, self.subspace = field, subspace
        given = {'starts': starts, 'subspace': subspace} if field.tool.predicts_height else {}
        self._c = CField.of(field, kernel, **given)
        self._scratch = self._c.another()  # for particles of frames before
        self._other: FieldEngine | None = None
        self._uses_other = False
        self._start = self._ground = self._soil = self._proposed_soil = None
        self._before = b''  # the state before the proposed frame
        self._is_proposed = False
        self._pose = np.zeros(7)  # of the newest frame, and of the proposed one
        self._coming = self._pose

    @property
    def name(self) -> str:
        """What computes the frames."""
        return self._other.name if self._uses_other else f'C ({self._c.kernel})'

    def begin(self, start, bed=None, blade_width=None) -> Proposal:
        """Begins from a `live.starts.Start`; as `FieldEngine.begin`."""
        if start.velocity is None:
            raise ValueError('a swept field begins from a pose: call start()')
        field = self._field
        ground, _ = field_engine.begin(field, self.starts, self.subspace, start, bed, blade_width)
        if len(ground.points) != len(field.rest):
            return self._begin_other(start, bed, blade_width, len(ground.points))
        self._release()
        if field.tool.predicts_height:  # the library knows the beds of its starts
            of_start = {'index': start.index, 'context': start.context}
            judged = self._c.start(start.pose, start.velocity, bed, **of_start)
        else:
            if bed is None:
                bed = field_engine.bed_of_start(field, self.starts, self.subspace, start)
            judged = self._c.start(start.pose, start.velocity, bed, float(ground.size[0]))
        self._uses_other, self._is_proposed = False, False
        self._start, self._ground, self._pose = start, ground, start.pose
        self._soil = CFieldSoil(self)
        force, torque = np.zeros(3), np.zeros(3)
        nodes = start.nodes(start.pose)
        return Proposal(judged, self._soil, nodes, start.pose, force, torque)

    def _begin_other(self, start, bed, blade_width, n):
        if self._other is None:
            self._other = FieldEngine(self._field, self.starts, self.subspace)
        self._other.name = (
            f'TensorFlow (the C form takes a bed of {len(self._field.rest)} particles, not {n})'
        )
        self._release()
        first = self._other.begin(start, bed, blade_width)
        self._uses_other = True
        return first

    def _release(self):
        """The newest soil keeps its own state: the library goes on to another one."""
        if self._soil is not None and not self._uses_other:
            self._soil.keep(self._now())
        self._soil = None

    def _now(self):
        return self._before if self._is_proposed else self._c.save()

    def propose(self, number: int, coming, context=None, dt: float | None = None) -> Proposal:
        """The frame in which the tool reaches a pose; as `FieldEngine.propose`."""
        if self._uses_other:
            return self._other.propose(number, coming, context, dt)
        if coming is None:
            raise ValueError(f'the body is {self.scene.rigid_motion}: step() takes a pose')
        if self._is_proposed:
            self._proposed_soil.keep(self._c.save())  # type: ignore[attr-defined]
            self._c.load_state(self._before)
        else:
            self._before = self._c.save()
            self._is_proposed = True
        try:
            found = self._c.step(coming, dt, context)
        except ValueError as error:
            self._is_proposed = False  # the library stays where it was
            self._refuse(coming, context, dt)
            raise ValueError(f'{error}; call start() anew') from None
        if self._field.tool.predicts_height:
            coming[self.up] = found.point[self.up]
        for values in (found.force, found.torque, coming):
            values.setflags(write=False)
        judgement = OK
        if found.status:
            judgement = self._c.judgement._replace(frame=number)
        self._coming = coming
        self._proposed_soil = CFieldSoil(self)
        nodes = self._start.nodes(coming)  # type: ignore[attr-defined]
        return Proposal(
            judgement, self._proposed_soil, nodes, coming, found.force, found.torque, found.bound
        )

    def accept(self) -> None:
        """Takes the frame that was proposed last as the newest one."""
        if self._uses_other:
            self._other.accept()
            return
        self._soil.keep(self._before)  # type: ignore[attr-defined]
        self._soil, self._pose, self._is_proposed = self._proposed_soil, self._coming, False

    def _refuse(self, coming, context, dt):
        """Raises what Python says of a step that C refuses, with its values and limits."""
        field, before = self._field, self._pose
        named = None
        if self.scene.context_names:
            now = self._c.context()
            given = now if context is None else context
            field.check_contexts(np.stack([now, given]))
            named = {k: v[None] for k, v in field.context(given).items()}
        (was,) = field.tool.poses(field.axes, before[None], named)
        (plane,) = field.tool.poses(field.axes, coming[None], named, was)
        dt = self.scene.dt if dt is None else float(dt)
        field_engine.refuse_jump(field, plane, was, dt)
        if not field.tool.predicts_height:
            field_engine.refuse_floor(field, plane, self._ground)
        grid, first = field.grid, self._ground.origin[0]
        radius = self._ground.size[0] if field.tool.predicts_height else grid.radius
        low, high = grid.offsets[[0, -1]] + [radius, -radius]
        if not low <= plane[0] - first <= high:
            raise ValueError(
                f'the tool is {plane[0] - first:.3f} m from its first place, the bins of the path '
                f'reach from {low:g} to {high:g} m; begin anew where it is: '
                f'start(pose, bed=stepper.particles())'
            )

    def particles(self, soil: CFieldSoil, state: bytes | None) -> np.ndarray:
        """float32 [N, 3], m, of a state; None for that of the newest or the proposed frame."""
        if state is None:
            # The library is at the proposed frame until that is accepted.
            if soil is self._proposed_soil or not self._is_proposed:
                return self._c.particles()
            state = self._before
        self._scratch.load_state(state)
        return self._scratch.particles()

    def encoded(self, particles) -> np.ndarray:
        """float64 [r, 3] scores of particles, m.

        Raises:
          ValueError: without a subspace.
        """
        if self.subspace is None:
            raise ValueError('modes need a subspace: the model folder has none')
        return self.subspace.encode(particles)

    @property
    def state(self) -> tuple:
        """All that the coming frames follow from; what is put back goes on to the same bits."""
        if self._uses_other:
            return self._other, self._other.state
        return None, (self._start, self._ground, self._pose, self._now(), self._soil)

    @state.setter
    def state(self, state: tuple) -> None:
        self._release()
        other, kept = state
        self._uses_other = other is not None
        if self._uses_other:
            other.state = kept
            return
        self._start, self._ground, self._pose, of_c, soil = kept
        self._c.load_state(of_c)
        self._is_proposed = False
        soil.keep(of_c)
        self._soil = CFieldSoil(self)

    def explain(self) -> str:
        """What the newest frame leaves out."""
        if self._uses_other:
            return self._other.explain()
        return field_engine.left_out(self._c.moving(), len(self._field.rest))
