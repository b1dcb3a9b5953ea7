"""Compares models in C with the same models by TensorFlow, frame by frame, over a recorded run.

Both are steppers, so that what is compared is what a user gets.
"""

import os
import tempfile
from typing import Any, NamedTuple

import numpy as np

from learning_to_simulate import registry
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live import starts as live_starts
from learning_to_simulate.live.stepper import Stepper
from learning_to_simulate.native import engines, field_data, library, model_data, project
from learning_to_simulate.native.binding import CField, CSubspace
from learning_to_simulate.rollout_status import RolloutStatus
from learning_to_simulate.scene import RigidMotion
from pca_tools import dataset

# Largest difference to TensorFlow as a share of the motion, or of the largest force. Measured 1e-7
# to 5e-6. Where all of the body's motion is predicted, a rounding of its velocity lasts, and
# TensorFlow itself is up to 3e-4 from the same networks in float64.
TOLERANCE = 1e-4
TOLERANCE_OF_PREDICTED = 1e-3
COMPARED_STEPS = 40
# How many frames of a run have their particles compared.
PARTICLE_FRAMES = 5


class Opened(NamedTuple):
    """A model folder.

    Attributes:
      model: `subspace_model.Model`, or what a swept field is opened as.
      starts, subspace: of `live.starts.read`.
      n_rigid: R of the graph of a model in a subspace.
    """

    model: Any
    starts: live_starts.Starts
    subspace: Any
    n_rigid: int

    @classmethod
    def of(cls, model_path: str, n_rigid: int | None = None) -> 'Opened':
        """Reads a model folder; R is by default that of the first start.

        Raises:
          FileNotFoundError, ValueError: no model there, a damaged one, or one without starts.
        """
        model = registry.of_folder(model_path).load_code().load(model_path)
        starts, subspace = live_starts.read(model_path)
        return cls(model, starts, subspace, len(starts.kept[0]) if n_rigid is None else n_rigid)

    @property
    def field(self):
        """The `SweptField`, or None."""
        return getattr(self.model, 'field', None)

    def values(self) -> dict:
        """Of `model_data.values` or `field_data.values`, whose errors this raises."""
        if self.field is not None:
            return field_data.values(self.field, self.starts, self.subspace)
        return model_data.values(self.model, self.n_rigid, self.subspace, self.starts)

    def steppers(self, library_path: str | None = None, symbol: str = '') -> list[Stepper]:
        """A stepper by C, of a compiled project or of this machine's library, and one by
        TensorFlow."""
        model, starts, space, n = self

        def make(*_):
            if library_path is not None:
                return CSubspace.open(library_path, symbol)
            return CSubspace.of(model, n, subspace=space)

        if self.field is None:
            by_c = engines.c_subspace_engine(model, starts, space, n, make)
        else:
            soil = None if library_path is None else CField.open(library_path, symbol)
            by_c = engines.CFieldEngine(self.field, starts, space, soil)
        return [Stepper(by_c), Stepper(engines.of(model, starts, space, engines.TENSORFLOW, n))]


def of_project(model_path: str, data_path: str, name: str, opened: Opened) -> dict:
    """Differences of a compiled project to TensorFlow over frames of the first test run.

    Args:
      model_path, data_path: of the model and its dataset.
      name: of the model in C.
      opened: the model.

    Returns:
      `calls`, `engine`, `relative_difference` by kind, `tolerance` and `particles_difference_m`; or
      `skipped`: why nothing was compared.

    Raises:
      ValueError: a difference above the tolerance.
      library.CompileFailed: the project does not compile.
    """
    with tempfile.TemporaryDirectory() as folder:
        project.write(folder, name, opened.values())
        built = os.path.join(folder, 'model.so')
        try:
            library.compile_sources(built, *library.parts_of(folder))
        except library.NoCompiler as error:
            return {'skipped': str(error)}
        pair = opened.steppers(built, name)
    tolerance = TOLERANCE
    if opened.field is not None:
        run = dataset.read_split(data_path, 'test')[0]
        if run.rigid_pose is None:
            return {'skipped': 'the first test run holds no pose of its tool'}
        cases = dataset.read_metadata(data_path).get('cases', {}).get('test', [{}])
        row = over_poses(*pair, run, cases[0].get('case'))  # type: ignore[call-arg]
    else:
        groups = registry.open_model(model_path, data_path, 'test').groups
        group = next((g for g in groups if g.n_rigid == opened.n_rigid), None)
        if group is None:
            return {'skipped': f'no test run has {opened.n_rigid} rigid nodes'}
        if opened.model.simulator.scene.rigid_motion is RigidMotion.PREDICTED:
            tolerance = TOLERANCE_OF_PREDICTED
        row = over_frames(*pair, group.select(0), COMPARED_STEPS)  # type: ignore[call-arg]
    names = ('position', 'force', 'particles')[: 3 if opened.field else 2]
    difference = {name: row[name] for name in names}
    if bad := {k: v for k, v in difference.items() if not v <= tolerance}:
        raise ValueError(
            f'the C code differs from the model by {bad}, more than {tolerance:g} of the motion or '
            f'force; nothing was written'
        )
    return {
        'calls': row['frames'],
        'engine': pair[0].engine,
        'relative_difference': difference,
        'tolerance': tolerance,
        'particles_difference_m': row['particles_m'],
    }


def over_frames(ours: Stepper, theirs: Stepper, group, limit: int | None = None) -> dict:
    """`compare` over a recorded run of a model in a subspace, by particles of the body.

    Args:
      ours, theirs: two steppers of the model.
      group: one-run `RunGroup`.
      limit: frames; None for all.
    """
    truth, n = group.position[0], group.n_rigid
    for stepper in (ours, theirs):
        stepper.reset(truth[:H], group.context_at(H, 0))
    known = theirs.computing.scene.rigid_motion.is_known
    steps = [
        (truth[k, :n] if known else None,
         group.context_at(k, 0) if group.context_changes else None)
        for k in range(H, len(truth))
    ]  # fmt: skip
    return compare(ours, theirs, steps[:limit])


def over_poses(ours: Stepper, theirs: Stepper, run, case=None, limit: int | None = None) -> dict:
    """`compare` over a recorded run of a swept field.

    Args:
      ours, theirs: two steppers of the model.
      run: `dataset.Run` with poses.
      case: of the run; where the model knows it, its start and its bed.
      limit: frames; None for all.
    """
    poses, contexts = run.rigid_pose.astype(np.float64), run.step_context
    contexts = [None] * len(poses) if contexts is None else contexts.astype(np.float64)
    # Of runs that start alike one start was kept: its context is the nearest.
    case = case if case in theirs.cases else None
    for stepper in (ours, theirs):
        stepper.start(poses[0], case=case, context=contexts[0])
    return compare(ours, theirs, list(zip(poses, contexts))[1:][:limit])


def compare(ours: Stepper, theirs: Stepper, steps) -> dict:
    """Largest differences of two steppers that have begun alike.

    Args:
      ours, theirs: two steppers of one model, by C and by TensorFlow.
      steps: poses and contexts, or None, of `Stepper.step`.

    Returns:
      `frames` until the first that both refuse, or that left its bounds: beyond them nothing is
      compared; `position` (of nodes, and of modes where there are) and `particles` as shares of
      their motion, `force`, `torque` and `bound` as shares of the largest, `particles_m`, and
      `same_status`: in how many frames kind, frame and node of the judgements agree.

    Raises:
      ValueError: a frame that one of them refuses and the other does not.
    """
    has_modes = isinstance(theirs.computing, engines.SubspaceEngine)
    first = theirs.state.frame
    draws = not has_modes or first.soil.subspace is not None
    every = max(1, len(steps) // PARTICLE_FRAMES)
    names = ('position', 'force', 'torque', 'bound', 'particles')
    apart: dict[str, float] = dict.fromkeys(names, 0.0)
    sizes, same, count = dict(apart), 0, 0

    def note(name, one, other, size=None):
        if other is not None:
            apart[name] = max(apart[name], float(np.abs(one - other).max(initial=0.0)))
            size = other if size is None else size
            sizes[name] = max(sizes[name], float(np.abs(size).max(initial=0.0)))

    for k, (pose, context) in enumerate(steps):
        mine, frame = (_step(stepper, pose, context) for stepper in (ours, theirs))
        if (mine is None) != (frame is None):
            raise ValueError(f'frame {k} is refused by {"C" if mine is None else "Python"} alone')
        if frame is None or frame.now not in (RolloutStatus.OK, RolloutStatus.EXTRAPOLATING):
            break
        count += 1
        same += mine.now == frame.now and mine.judgement[:3] == frame.judgement[:3]
        shown = [_shown(f, has_modes) for f in (mine, frame, first)]
        note('position', *shown[:2], shown[1] - shown[2])  # type: ignore[call-arg]
        for name in ('force', 'torque', 'bound'):
            note(name, getattr(mine, name), getattr(frame, name))
        if draws and k % every == 0:
            # In a subspace steppers decode particles themselves: here those of the library count.
            drawn = ours.computing.step if has_modes else mine
            points = frame.particles()
            note('particles', drawn.particles(), points, points - first.particles())
    shares = {k: apart[k] / sizes[k] if sizes[k] > 0 else apart[k] for k in apart}
    particles = {'particles_m': apart['particles']}
    return {'frames': count, 'same_status': same} | particles | shares


def _shown(frame, has_modes):
    """Nodes of the body, and modes where those are cheap."""
    return np.concatenate([frame.rigid_pose, frame.modes]) if has_modes else frame.rigid_pose


def _step(stepper, pose, context):
    """A frame, or None where the pose is refused."""
    try:
        return stepper.step(pose, context)
    except ValueError:
        return None
