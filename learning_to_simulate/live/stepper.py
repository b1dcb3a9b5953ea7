"""`Stepper`: a model in a subspace, stepped with the poses of its body, one frame per call.

    stepper = lts.load('excavation/pcg').stepper()
    stepper.start(pose, velocity)
    frame = stepper.step(next_pose)
    points = frame.particles()        # only where they are asked for

An engine (`engine`, `native.engines`) computes the frames. Input that cannot be used is refused
before anything changes; input unlike the training runs is used and flagged, in that frame and in
all that follow. After the first call nothing is compiled any more.
"""

import threading
from typing import Any, NamedTuple

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live import poses
from learning_to_simulate.live.engine import Frame
from learning_to_simulate.live.starts import RecordedStart, Start
from learning_to_simulate.rollout_status import Judgement, RolloutStatus, worse

FLAG, HOLD, RAISE = 'flag', 'hold', 'raise'


class StepperState(NamedTuple):
    """All that a stepper knows; what is kept can be put back.

    Attributes:
      start: what the run began from.
      frame: the newest.
      count: frames since the start.
      of_engine: what its engine knows.
    """

    start: Any
    frame: Frame
    count: int
    of_engine: Any


class Stepper:
    """Steps a model frame by frame.

    Args:
      engine: computes the frames; see `engine` and `native.engines`.
      outside: what is done with a frame that is not `ok`: 'flag' goes on and says so; 'hold' stays
        in the frame before; 'raise' refuses it. A frame that is not finite never becomes the state.

    Raises:
      ValueError: an unknown `outside`.
    """

    def __init__(self, engine, outside: str = FLAG):
        if outside not in (FLAG, HOLD, RAISE):
            raise ValueError(f'outside is {outside!r}, must be one of {(FLAG, HOLD, RAISE)}')
        self._engine, self._outside = engine, outside
        self._lock = threading.Lock()
        self._start: Any = None
        self._last: Any = None
        self._count = 0

    @property
    def engine(self) -> str:
        """What computes the frames: C with its instructions, or TensorFlow and why not C."""
        return self._engine.name

    @property
    def computing(self):
        """The engine itself; for whole paths and for comparisons."""
        return self._engine

    @property
    def dt(self) -> float:
        """Seconds of a frame."""
        return self._engine.scene.dt

    @property
    def cases(self) -> list:
        """Numbers or names of the recorded starts' cases."""
        return [values.get('case') for values in self._engine.starts.cases]

    def start(self, pose=None, velocity=None, case=None, context=None) -> Judgement:
        """Begins where the body is; returns how the start is to be judged.

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
        with _Held(self._lock):
            engine = self._engine
            start = Start(engine.scene, engine.starts, pose, velocity, case, context)
            start.pose.setflags(write=False)
            return self._begin(start)

    def reset(self, history, context=None) -> Judgement:
        """Starts from the last H frames, the body told by its particles; `step` then takes those.

        Args:
          history: [H, V, D] positions, m; R rigid particles, then r modes; newest last.
          context: [C], where the scene has one.

        Raises:
          ValueError: wrong shape or kind of values, or values that are not finite in float32; the
            state stays as it was.
          RuntimeError: another thread uses the stepper.
        """
        with _Held(self._lock):
            scene = self._engine.scene
            shape = np.shape(history)
            n_rigid = shape[1] - scene.n_modes if len(shape) == 3 else 0
            return self._begin(RecordedStart(scene, max(n_rigid, 0), history, context))

    def _begin(self, start):
        first = self._engine.begin(start)
        self._start, self._count = start, 0
        self._last = first._replace(now=first.status)
        return first.judgement

    def step(self, pose=None, context=None, dt: float | None = None) -> Frame:
        """Predicts the frame in which the body reaches a pose.

        Args:
          pose: of the body in the coming frame (see `poses`), where its motion is given; of a
            driven body the height is ignored. None where the body is predicted. After `reset` the
            particles [R, D] of the body, m.
          context: [C] or {name: value} in the coming frame and those after it, where it changes;
            None leaves it as it was.
          dt: s; None or the frame time of the model, which cannot be divided.

        Raises:
          ValueError: before the start; not a pose, or one where none is taken; another time step; a
            path beyond what a memory of it reaches; with `outside='raise'` a frame that is not
            `ok`. The state stays as it was.
          RuntimeError: another thread is at work here.
        """
        with _Held(self._lock):
            last = self._last
            if last is None:
                raise ValueError('call start() before step()')
            if context is not None:
                context = self._start.read_context(context)
            if pose is not None:
                pose = self._start.read(pose)
            frame = self._engine.propose(H + self._count, pose, context, dt)
            alone = frame.judgement
            so_far = worse(last.judgement, alone)
            if alone.status != RolloutStatus.OK and self._outside != FLAG:
                if self._outside == RAISE:
                    raise ValueError(f'{alone.status}: {alone.reason}; the state stays as it was')
                self._last = last._replace(judgement=so_far)
                return self._last._replace(now=alone.status)
            frame = frame._replace(judgement=so_far, now=alone.status)
            if alone.status == RolloutStatus.NON_FINITE:
                self._last = last._replace(judgement=so_far)
                return frame
            self._engine.accept()
            self._count, self._last = self._count + 1, frame
            return frame

    @property
    def state(self) -> StepperState:
        """What is kept can be put back, and goes on from there to the same bits.

        Raises:
          ValueError: before `start`.
          RuntimeError: put back while another thread is at work here.
        """
        frame = self._newest()
        return StepperState(self._start, frame, self._count, self._engine.state)

    @state.setter
    def state(self, state: StepperState) -> None:
        with _Held(self._lock):
            self._start, self._last, self._count, of_engine = state
            self._engine.state = of_engine

    def particles(self) -> np.ndarray:
        """float32 [N, 3] of the soil in the newest frame, or at the start, m; raises as
        `Frame.particles`, and before the start."""
        return self._newest().particles()

    def _newest(self):
        if self._last is None:
            raise ValueError('call start() first')
        return self._last

    def body(self, pose) -> np.ndarray:
        """float64 [R', 3], m: all particles of the body at a pose, for drawing; raises before
        `start`."""
        self._newest()
        return poses.placed(self._start.body, self._start.read(pose))


class _Held:
    """A lock that is held for a call, or a message: two threads would mix their paths."""

    def __init__(self, lock):
        self._lock = lock

    def __enter__(self):
        if not self._lock.acquire(blocking=False):
            raise RuntimeError('another thread is using this stepper; give each thread its own')

    def __exit__(self, *_):
        self._lock.release()
