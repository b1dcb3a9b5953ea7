"""Live stepping: one frame per call, for embedding in an interactive program.

`Stepper` takes the body as particles; `live.LiveSoil`, which `lts.load(...).stepper()` makes, takes
poses and starts by itself. What computes a frame is a back end with the four methods of
`CompiledStep`.

Example:
    stepper = Stepper.load('models/excavation/pcg', 'datasets/excavation', n_rigid=10)
    stepper.reset(history)                          # [6, R + r, 3], the last six frames
    while running:
        frame = stepper.step(next_blade_points)     # [R, 3], where the blade will be
        draw(frame.particles(), frame.rigid_pose, frame.force, frame.status)

A stepper compiles once, when it is made. After that no call traces, and none allocates memory that
it does not give back. Input that cannot be used is refused before anything changes; input unlike
the training runs is used and flagged, in that frame and all that follow.
"""

import os
import threading
from typing import NamedTuple

import numpy as np

from learning_to_simulate import checkpoints, loads
from learning_to_simulate.compiled.compiled_step import CompiledStep
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live.frame_judge import FrameJudge, worse
from learning_to_simulate.live.poses import numbers
from learning_to_simulate.live.soil import Soil
from learning_to_simulate.rollout_status import Judgement, RolloutStatus
from learning_to_simulate.subspace import subspace_model
from pca_tools.dataset import read_metadata
from pca_tools.subspace import Subspace

FLAG, HOLD, RAISE = 'flag', 'hold', 'raise'


class Frame(NamedTuple):
    """One predicted frame; its arrays cannot be written to.

    Attributes:
      modes: float64 [r, D] scores, m; of a method without modes, what `soil` takes in their place.
      force: float32 [D] on the body, N, or [B, D] on several; None where the scene has no force.
      rigid_pose: float64 [R, D] particles of the body that are nodes, m.
      judgement: how far the rollout can be trusted up to this frame: the worst since the start,
        with the frame in which it began and the reason.
      now: the status of this frame alone.
      soil: turns modes into particles; None without a subspace.
      pose: float64 [7], position (m) and quaternion (w, x, y, z) of the body; None from `Stepper`.
      torque: [D] on the body about its reference point, N m, where the model predicts one.
      bound: N, what the root mean square error of the force per component keeps in 95 % of frames;
        None where the model was not calibrated.
    """

    modes: np.ndarray
    force: np.ndarray | None
    rigid_pose: np.ndarray
    judgement: Judgement
    now: RolloutStatus
    soil: Soil | None = None
    pose: np.ndarray | None = None
    torque: np.ndarray | None = None
    bound: float | None = None

    def __repr__(self) -> str:
        values = [] if self.force is None else [f'{value:.4g}' for value in np.ravel(self.force)]
        force = f'force {", ".join(values)} N, ' if values else ''
        return f'<frame: {force}{self.status}{f" ({self.reason})" if self.reason else ""}>'

    @property
    def status(self) -> RolloutStatus:
        """The worst status since the start, as a rollout file would have it."""
        return self.judgement.status

    @property
    def reason(self) -> str:
        """Value and limits behind the status, in words; '' where it is OK."""
        return self.judgement.reason

    def particles(self) -> np.ndarray:
        """float32 [N, D] positions of the soil, m.

        Raises:
          ValueError: without a subspace.
        """
        return _soil_of(self.soil).particles(self.modes)

    def height_map(self, nx: int, nz: int) -> np.ndarray:
        """float32 [nx, nz] heights of the surface, m; see `Soil.height_map`."""
        return _soil_of(self.soil).height_map(self.modes, nx, nz)


def _soil_of(soil):
    if soil is None:
        raise ValueError('particles need a subspace: the model has none')
    return soil


class Stepper:
    """Steps a trained model frame by frame.

    Args:
      model: `subspace_model.Model`; its weights are taken as they are now.
      n_rigid: R, rigid particles that are nodes.
      subspace: turns modes into particles; None if particles are never asked for.
      rigid_correction: whether a predicted body is kept rigid.
      outside: what is done with a frame that is not `ok`: 'flag' goes on and says so; 'hold' stays
        in the frame before; 'raise' refuses it. A frame that is not finite never becomes the state.
      force_limit: N, the largest force of the training runs, or None; a force above twice of it
        has left the bounds.
      back_end: computes the frames; default: a `CompiledStep`.

    Raises:
      ValueError: a subspace of another number of modes or particles than the model's, or a body
        that the model cannot take.
    """

    def __init__(
        self,
        model: subspace_model.Model,
        n_rigid: int,
        subspace: Subspace | None = None,
        rigid_correction: bool = True,
        outside: str = FLAG,
        force_limit: float | None = None,
        back_end=None,
    ):
        if outside not in (FLAG, HOLD, RAISE):
            raise ValueError(f'outside is {outside!r}, must be one of {(FLAG, HOLD, RAISE)}')
        simulator = model.simulator
        self._scene, self._dim, self._outside = simulator.scene, simulator.dim, outside
        self._layout = model.layout(n_rigid)
        of_each = simulator.force_size > self._dim
        self._predicts_torque = simulator.config.predict_torque
        self._force_shape = (len(self._scene.bodies), self._dim) if of_each else (self._dim,)
        self.soil = (
            None
            if subspace is None
            else Soil(model.fitting_subspace(subspace), self._scene.up_axis)
        )
        self.judge = FrameJudge(n_rigid, simulator.statistics, self._scene, force_limit)
        self._back_end = back_end or CompiledStep(model, n_rigid, rigid_correction)
        self._lock = threading.Lock()
        self._pose: np.ndarray | None = None
        self._last: Frame | None = None
        self._frame = 0
        self._warm_up(n_rigid)

    @classmethod
    def load(cls, model_path: str, data_path: str, n_rigid: int | None = None, **options):
        """A stepper of a model folder and the dataset folder it belongs to.

        Args:
          model_path: of `subspace_model.load`.
          data_path: its metadata and, if it has one, its subspace are read.
          n_rigid: R; default: that of the model's first training run.
          **options: of the constructor.

        Raises:
          FileNotFoundError, ValueError: no model or dataset there, or they do not belong together.
        """
        model = subspace_model.load(model_path)
        checkpoints.check_dataset(model_path, model, data_path, read_metadata(data_path))
        path = os.path.join(data_path, 'subspace.npz')
        subspace = Subspace.load(path) if os.path.exists(path) else None
        n_rigid = checkpoints.read_config(model_path)['n_rigid'] if n_rigid is None else n_rigid
        return cls(model, n_rigid, subspace, **options)

    @property
    def traces(self) -> int:
        """How often the frame was traced; 1 for the life of a stepper."""
        return self._back_end.traces

    def reset(self, history, context=None) -> Judgement:
        """Starts from the last H frames; returns how the start is to be judged.

        Args:
          history: [H, V, D] positions, m; R rigid particles, then r modes; newest last.
          context: [C], where the scene has one.

        Raises:
          ValueError: wrong shape or kind of values, or values that are not finite in float32; the
            state stays as it was.
          RuntimeError: another thread uses the stepper.
        """
        layout = self._layout
        history = numbers('history', history, (H, layout.n_node, self._dim))
        bodies = history[:, : layout.n_rigid]
        context = self._checked_context(context)
        judgement = self.judge.start(history, context, bodies[-1] - bodies[-2])
        for k in range(1, H):
            judgement = worse(judgement, self.judge.given(k, bodies[k], bodies[k - 1]) or judgement)
        self.begin(history, context, judgement)
        return judgement

    def begin(self, history, context, judgement: Judgement) -> None:
        """Starts from checked float64 arrays, as `reset`, with the judgement of the start."""
        n = self._layout.n_rigid
        history.setflags(write=False)
        with Held(self._lock):
            self._back_end.reset(history, context)
            self._pose, self._frame = history[-1, :n], H - 1
            force = np.zeros(self._force_shape, np.float32) if self._scene.has_force else None
            torque = np.zeros(self._dim, np.float32) if self._predicts_torque else None
            self._last = Frame(
                history[-1, n:], force, history[-1, :n], judgement, judgement.status, self.soil,
                torque=torque,
            )  # fmt: skip

    def _checked_context(self, context):
        names = self._scene.context_names
        if (context is None) == bool(names):
            raise ValueError(f'the scene takes context {list(names)}, got {context}')
        return numbers('context', context, (len(names),)) if names else None

    def step(self, rigid_pose=None, context=None) -> Frame:
        """Predicts the next frame.

        Args:
          rigid_pose: [R, D] positions of the body in the coming frame, m, where its motion is given
            (of a driven body the mean height is ignored); None where it is predicted.
          context: [C] in the coming frame and those after it; None leaves it as it was.

        Raises:
          ValueError: before `reset`; a context or a pose where none is taken, or no pose where one
            is; wrong shape or kind of values; values that are not finite in float32; with
            `outside='raise'` a frame that is not `ok`. The state stays as it was.
          RuntimeError: another thread uses the stepper.
        """
        with Held(self._lock):
            if self._last is None:
                raise ValueError('call reset() with the first frames before step()')
            body = self._checked_body(rigid_pose)
            n, frame = self._layout.n_rigid, self._frame + 1
            displacement = judgement = None
            if body is not None:
                displacement = body - self._pose
                # The reason of a rollout is that of its first bad frame.
                flagged = self._last.judgement.status != RolloutStatus.OK
                in_words = not flagged or self._outside != FLAG
                judgement = self.judge.given(frame, body, self._pose, in_words)
            if context is not None:
                context = self._checked_context(context)
                judgement = judgement or self.judge.context(frame, context)
            if judgement and self._outside != FLAG:
                return self._refused(judgement)
            position, load = self._back_end.propose(body, displacement, context)
            force, torque = loads.split(load, self.judge.statistics)
            predicted = self.judge.predicted(frame, position, force, torque)
            now = worse(predicted, judgement) if judgement else predicted
            if self._outside != FLAG and now.status != RolloutStatus.OK:
                return self._refused(now)
            for values in (position, force, torque):
                if values is not None:
                    values.setflags(write=False)
            so_far = worse(self._last.judgement, now)
            if force is not None:
                force = force.reshape(self._force_shape)
            result = Frame(
                position[n:], force, position[:n], so_far, now.status, self.soil, torque=torque
            )
            if now.status == RolloutStatus.NON_FINITE:
                self._last = self._last._replace(judgement=so_far)
                return result
            self._back_end.accept()
            self._pose, self._frame, self._last = body, frame, result
            return result

    def _refused(self, judgement):
        """The frame of before with the judgement of what was asked for."""
        if self._outside == RAISE:
            raise ValueError(f'{judgement.status}: {judgement.reason}; the state stays as it was')
        so_far = worse(self._last.judgement, judgement)
        self._last = self._last._replace(judgement=so_far)
        return self._last._replace(now=judgement.status)

    def particles(self) -> np.ndarray:
        """float32 [N, D] positions of the soil in the newest frame, m.

        Raises:
          ValueError: before `reset`, or without a subspace.
        """
        if self._last is None:
            raise ValueError('particles() needs reset() first')
        return self._last.particles()

    def _checked_body(self, rigid_pose):
        """The given body as float64, or None where it is predicted."""
        if self._scene.rigid_motion.is_known != (rigid_pose is not None):
            takes = 'takes' if rigid_pose is None else 'does not take'
            raise ValueError(f'the body is {self._scene.rigid_motion}: step() {takes} a pose')
        if rigid_pose is None:
            return None
        return numbers('rigid_pose', rigid_pose, (self._layout.n_rigid, self._dim))

    def _warm_up(self, n_rigid):
        """Runs one frame at rest, so that the first real call is as fast as the others."""
        origin = self._layout.origin
        context = np.ones(len(self._scene.context_names)) if self._scene.context_names else None
        self._back_end.reset(np.tile(origin, (H, 1, 1)), context)
        known = self._scene.rigid_motion.is_known
        self._back_end.propose(
            *(origin[:n_rigid], np.zeros((n_rigid, self._dim))) if known else (None, None)
        )


class Held:
    """A lock that is held for a call, or a message: two threads would mix their paths."""

    def __init__(self, lock):
        self._lock = lock

    def __enter__(self):
        if not self._lock.acquire(blocking=False):
            raise RuntimeError('another thread is using this stepper; give each thread its own')

    def __exit__(self, *_):
        self._lock.release()
