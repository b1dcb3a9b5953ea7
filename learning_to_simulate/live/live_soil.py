"""`LiveSoil`: a model that is stepped with the poses of its body, from a bed at rest.

    live = lts.load('excavation').stepper()
    live.start(pose, velocity)
    frame = live.step(next_pose)        # once for every 1/60 s of the model's frame time

A frame of the model is `dt` seconds and cannot be divided: between frames hold the last one.
"""

from typing import Any

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live import poses
from learning_to_simulate.live.frame_judge import FrameJudge
from learning_to_simulate.live.resting_start import Starts
from learning_to_simulate.live.stepping import FLAG, HOLD, Frame, Stepper
from learning_to_simulate.rollout_status import Judgement, RolloutStatus
from learning_to_simulate.scene import RigidMotion
from pca_tools import rigid_fit


class Beginning:
    """Checked input of a start: a bed, a body, its first pose and velocity, the context.

    Args:
      scene: of the model.
      starts: of the model folder.
      n_modes: r.

    Attributes:
      index: which of the starts was chosen.
      body, kept: particles of the body in its own frame, and which are nodes.
      pose: float64 [7].
      velocity: float64 [6], m/s and rad/s.
      context: float64 [C] or None.
    """

    def __init__(self, scene, starts: Starts, n_modes: int):
        self._scene, self._starts, self._n_modes = scene, starts, n_modes
        self.index: int | None = None

    def choose(self, pose=None, velocity=None, case=None, context=None) -> 'Beginning':
        """Takes what a user gives, and the rest from the start of a case; returns itself.

        Raises:
          ValueError: no such case, not a pose, a velocity or a context.
        """
        starts, names = self._starts, self._scene.context_names
        contexts: Any = starts.context  # there is one for every start, or the scene names none
        index = starts.index(case)
        if context is not None:
            context = self.read_context(context)
            if case is None:  # the bed of the most similar case
                spread = contexts.std(axis=0)
                far = (contexts - context) / np.where(spread > 0, spread, 1.0)
                index = int((far**2).sum(axis=1).argmin())
        elif names:
            context = contexts[index]
        reader = self._reader(index)
        pose = starts.pose[index] if pose is None else reader.read(pose)
        velocity = reader.read_velocity(velocity)
        self.index, self.pose, self.velocity, self.context = index, pose, velocity, context
        self.body, self.kept = starts.body[index], starts.kept[index]
        return self

    def _reader(self, index):
        up = self._scene.up_axis
        across = 2 if up != 2 else 1
        return poses.PoseReader(up, self._starts.pose[index, across])

    def read(self, pose) -> np.ndarray:
        """float64 [7] of a pose of the path; raises as `poses.PoseReader.read`."""
        return self._reader(self.index or 0).read(pose)

    def read_context(self, context) -> np.ndarray:
        """float64 [C] of a context [C] or {name: value}.

        Raises:
          ValueError: a scene without one, other names, not numbers.
        """
        names = self._scene.context_names
        if not names:
            raise ValueError(f'the scene {self._scene.name} takes no context')
        if isinstance(context, dict):
            if set(context) != set(names):
                raise ValueError(f'context names {sorted(context)}, must name {list(names)}')
            context = [context[name] for name in names]
        return poses.numbers('context', context, (len(names),))

    def nodes(self, pose) -> np.ndarray:
        """float64 [R, 3], m, of the body's nodes at a pose."""
        return poses.placed(self.body[self.kept], pose)

    def past(self) -> np.ndarray:
        """float64 [H, 7]: the poses of a body on its way at constant velocity, newest last."""
        seconds = self._scene.dt * np.arange(H - 1, -1, -1)
        return np.stack([poses.moved_back(self.pose, self.velocity, t) for t in seconds])

    def history(self) -> np.ndarray:
        """float64 [H, V, 3], m: the bed at rest, the body on its way."""
        modes = self._starts.modes[self.index][: self._n_modes]
        return np.stack([np.concatenate([self.nodes(pose), modes]) for pose in self.past()])

    def judged(self, judge: FrameJudge) -> Judgement:
        """How the start is to be judged: its newest frame. The frames before it are made up."""
        history = self.history()
        moving = bool(self.velocity.any())
        body = history[:, : len(self.kept)]
        return judge.start(history[-1], self.context, body[-1] - body[-2] if moving else None)


class LiveSoil:
    """Steps a model with poses.

    Args:
      model: `subspace_model.Model`.
      starts: of the model folder.
      subspace: of the model folder, or None.
      outside: of `Stepper`.
      back_end: makes the back end of a `Stepper` of (model, R); default: `CompiledStep`.
    """

    def __init__(self, model, starts: Starts, subspace, outside: str = FLAG, back_end=None):
        self._model, self._starts, self._space = model, starts, subspace
        self._scene = model.simulator.scene
        self._outside, self._make = outside, back_end
        self._steppers: dict[int, Stepper] = {}
        self._stepper = None
        self._pose: np.ndarray | None = None  # of the newest frame
        self._beginning = Beginning(self._scene, starts, self._scene.n_modes)
        self._of_size(len(starts.kept[0]))  # compiles now and not in the first frame

    def _of_size(self, n_rigid):
        """The stepper for bodies of R nodes, compiled once."""
        if n_rigid not in self._steppers:
            back_end = self._make(self._model, n_rigid) if self._make else None
            self._steppers[n_rigid] = Stepper(
                self._model,
                n_rigid,
                self._space,
                outside=self._outside,
                force_limit=self._starts.force_limit,
                back_end=back_end,
            )
        return self._steppers[n_rigid]

    @property
    def dt(self) -> float:
        """Seconds of a frame."""
        return self._scene.dt

    def start(self, pose=None, velocity=None, case: int | None = None, context=None) -> Judgement:
        """Begins on the bed at rest; returns how the start is to be judged.

        Args:
          pose: of the body now (see `poses`); None for that of the case.
          velocity: [3] linear, m/s, or [6] with the angular one, rad/s, in the world's axes; None
            for a body at rest.
          case: of the dataset, where beds or bodies differ by case; None for the most similar
            context, or the first.
          context: [C] or {name: value}, where the scene has one; None for that of the case.

        Raises:
          ValueError: something that cannot be used; the state stays as it was.
          RuntimeError: another thread is at work here.
        """
        chosen = Beginning(self._scene, self._starts, self._scene.n_modes)
        chosen.choose(pose, velocity, case, context)
        stepper = self._of_size(len(chosen.kept))
        judgement = chosen.judged(stepper.judge)
        stepper.begin(chosen.history(), chosen.context, judgement)
        chosen.pose.setflags(write=False)
        self._stepper, self._beginning, self._pose = stepper, chosen, chosen.pose
        return judgement

    def step(self, pose=None, context=None) -> Frame:
        """Predicts the frame in which the body reaches a pose.

        Args:
          pose: of the body in the coming frame (see `poses`), where its motion is given; of a
            driven body the height is ignored. None where the body is predicted.
          context: [C] or {name: value} in the coming frame and those after it, where it changes;
            None leaves it as it was.

        Raises:
          ValueError: before `start`; not a pose, or one where none is taken; with `outside='raise'`
            a frame that is not `ok`. The state stays as it was.
          RuntimeError: another thread is at work here.
        """
        if self._stepper is None:
            raise ValueError('call start() before step()')
        if context is not None:
            context = self._beginning.read_context(context)
        if pose is not None:
            pose = self._beginning.read(pose)
        frame = self._stepper.step(None if pose is None else self._beginning.nodes(pose), context)
        if self._outside == HOLD and frame.now != RolloutStatus.OK:  # the body stayed, too
            return frame._replace(pose=self._pose)
        if pose is None:
            pose = self._fitted(frame.rigid_pose)
        elif self._scene.rigid_motion == RigidMotion.DRIVEN:  # the height is the model's
            up = self._scene.up_axis
            pose[up] += (frame.rigid_pose - self._beginning.nodes(pose))[:, up].mean()
        if pose is not None:
            pose.setflags(write=False)
        self._pose = pose
        return frame._replace(pose=pose)

    def _fitted(self, nodes):
        """The pose [7] of predicted particles; None where they do not fix one."""
        if len(nodes) < rigid_fit.MIN_POINTS or not np.isfinite(nodes).all():
            return None
        body = self._beginning.body[self._beginning.kept]
        motion = rigid_fit.fit_rigid_motion(body, nodes)
        return np.concatenate([motion.translation, poses.quaternion_of(motion.rotation)])

    def particles(self) -> np.ndarray:
        """float32 [N, 3] of the soil in the newest frame, or at the start, m; raises as
        `Stepper.particles`."""
        if self._stepper is None:
            raise ValueError('call start() before particles()')
        return self._stepper.particles()

    def body(self, pose) -> np.ndarray:
        """float64 [R', 3], m: all particles of the body at a pose [7], for drawing."""
        return poses.placed(self._beginning.body, self._beginning.read(pose))
