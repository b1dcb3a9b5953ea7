"""Compares models in C with the same models by TensorFlow, frame by frame, over a recorded run.

Both are steppers, so that what is compared is what a user gets.
"""

from typing import Any, NamedTuple

import numpy as np

from learning_to_simulate import registry
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live import starts as live_starts
from learning_to_simulate.live.stepper import Stepper
from learning_to_simulate.native import engines, model_data
from learning_to_simulate.native.binding import CSubspace
from learning_to_simulate.rollout_status import RolloutStatus

# Largest difference to TensorFlow as a share of the motion, or of the largest force. Measured 1e-7
# to 5e-6. Where all of the body's motion is predicted, a rounding of its velocity lasts, and
# TensorFlow itself is up to 3e-4 from the same networks in float64.
TOLERANCE = 1e-4
TOLERANCE_OF_PREDICTED = 1e-3
COMPARED_STEPS = 40
# How many frames of a run have their particles compared.
PARTICLE_FRAMES = 5


class Opened(NamedTuple):
    """A model folder: `subspace_model.Model`, starts and subspace of `live.starts.read`, and R of
    the first start."""

    model: Any
    starts: live_starts.Starts
    subspace: Any
    n_rigid: int

    @classmethod
    def of(cls, model_path: str) -> 'Opened':
        model = registry.of_folder(model_path).load_code().load(model_path)
        starts, subspace = live_starts.read(model_path)
        return cls(model, starts, subspace, len(starts.kept[0]))

    def values(self) -> dict:
        return model_data.values(self.model, self.n_rigid, self.subspace, self.starts)

    def steppers(self, library_path: str | None = None, symbol: str = '') -> list[Stepper]:
        """A stepper by C, of a compiled project or of this machine's library, and one by
        TensorFlow."""
        model, starts, space, n = self

        def make(*_):
            if library_path is not None:
                return CSubspace.open(library_path, symbol)
            return CSubspace.of(model, n, subspace=space)

        by_c = engines.by_c(model, starts, space, make, n_rigid=n)
        return [by_c, Stepper(model, starts, space, n)]


def checked(difference: dict[str, float], tolerance: float) -> dict[str, float]:
    """Differences by kind, as shares of the motion or of the largest force; ValueError where one is
    above the tolerance, or not finite."""
    if bad := {k: v for k, v in difference.items() if not v <= tolerance}:
        raise ValueError(
            f'the C code differs from the model by {bad}, more than {tolerance:g} of the motion or '
            f'force; nothing was written'
        )
    return difference


def over_frames(ours: Stepper, theirs: Stepper, group, limit: int | None = None) -> dict:
    """Largest differences of two steppers of one model, by C and by TensorFlow, over a recorded
    one-run `RunGroup`, by particles of the body.

    Returns:
      `frames` until the first that left its bounds: beyond it, or `limit`, nothing is compared;
      `position` (of nodes and modes) and `particles` as shares of their motion, `force` as a share
        of
      the largest, `particles_m`, and `same_status`: in how many frames kind, frame and node of the
      judgements agree.
    """
    truth, n = group.position[0], group.n_rigid
    for stepper in (ours, theirs):
        stepper.reset(truth[:H], group.context_at(H, 0))
    known, first = theirs.scene.rigid_motion.is_known, theirs.state.frame
    frames = range(H, len(truth))[:limit]
    every = max(1, len(frames) // PARTICLE_FRAMES)
    apart = dict.fromkeys(('position', 'force', 'particles'), 0.0)
    sizes, same, count = dict(apart), 0, 0

    def note(name, one, other, size):
        apart[name] = max(apart[name], float(np.abs(one - other).max(initial=0.0)))
        sizes[name] = max(sizes[name], float(np.abs(size).max(initial=0.0)))

    for k in frames:
        pose = truth[k, :n] if known else None
        context = group.context_at(k, 0) if group.context_changes else None
        mine, frame = (stepper.step(pose, context) for stepper in (ours, theirs))
        if frame.now not in (RolloutStatus.OK, RolloutStatus.EXTRAPOLATING):
            break
        same += mine.now == frame.now and mine.judgement[:3] == frame.judgement[:3]
        one, other, start = (np.concatenate([f.rigid_pose, f.modes]) for f in (mine, frame, first))
        note('position', one, other, other - start)
        if frame.force is not None:
            note('force', mine.force, frame.force, frame.force)
        if first.soil.has_particles and count % every == 0:
            # Steppers decode particles themselves: here those of the library count.
            points, drawn = frame.particles(), ours.computing.particles()
            note('particles', drawn, points, points - first.particles())
        count += 1
    shares = {k: apart[k] / sizes[k] if sizes[k] > 0 else apart[k] for k in apart}
    return {'frames': count, 'same_status': same, 'particles_m': apart['particles']} | shares
