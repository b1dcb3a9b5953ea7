"""A trained model as a C project, and a soil field as an FMU, for `learning_to_simulate.export`:
compiled, and compared with TensorFlow over the first test run of its dataset.

Of a model in the subspace both are steppers, so that what is compared is what a user gets.
"""

import os
import tempfile

import numpy as np

from learning_to_simulate import registry
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live import starts as live_starts
from learning_to_simulate.live.stepper import Stepper
from learning_to_simulate.native import (
    binding,
    engines,
    fmu,
    library,
    model_data,
    project,
    soil_data,
    soil_engine,
)
from learning_to_simulate.rollout_status import RolloutStatus
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.soil_field import runs
from learning_to_simulate.soil_field.engine import TfEngine

# Largest difference to TensorFlow as a share of the motion, or of the largest force. Measured 1e-7
# to 5e-6. Where all of the body's motion is predicted, a rounding of its velocity lasts, and
# TensorFlow itself is up to 3e-4 from the same networks in float64.
TOLERANCE = 1e-4
TOLERANCE_OF_PREDICTED = 1e-3
COMPARED_STEPS = 40
# How many frames of a run have their particles compared.
PARTICLE_FRAMES = 5


class CModel:
    """A model in a subspace, for bodies of the size of its first start.

    Raises:
      FileNotFoundError, ValueError: no model there, or one that has no C form.
    """

    def __init__(self, model_path: str, data_path: str):
        self._paths = model_path, data_path
        self._model = registry.of_folder(model_path).load_code().load(model_path)
        self._starts, self._space = live_starts.read(model_path)
        self._n_rigid = len(self._starts.kept[0])
        self._name = project.symbol(model_path)
        self._values = model_data.values(self._model, self._n_rigid, self._space, self._starts)

    def describe(self) -> dict:
        """What a user of the exported model must know; JSON-able."""
        names = ('digest', 'n_rigid', 'n_start')
        found = {'symbol': self._name} | {name: self._values[name] for name in names}
        return found | {'scene': self._model.simulator.scene.to_json()}

    def write(self, kind: str, folder: str) -> dict:
        """Writes the files of a format of `native.FORMATS`; returns how they compare. ValueError
        for C that does not compile, a dataset that the model does not fit, or outputs beyond the
        tolerance."""
        return _write(kind, folder, self._name, self._values, self._compared)

    def steppers(self, library_path: str | None = None) -> list[Stepper]:
        """A stepper by C, of a compiled project or of this machine's library, and one by
        TensorFlow."""
        parts, n = (self._model, self._starts, self._space), self._n_rigid

        def make(*_):
            if library_path is not None:
                return binding.CSubspace(binding.Loaded.open(library_path, self._name))
            return binding.CSubspace.of(self._model, n, subspace=self._space)

        return [engines.by_c(*parts, make, n_rigid=n), Stepper(*parts, n)]

    def _compared(self, library_path):
        groups = registry.open_model(*self._paths, 'test').groups
        group = next((g for g in groups if g.n_rigid == self._n_rigid), None)
        if group is None:
            return {'skipped': f'no test run has {self._n_rigid} rigid nodes'}
        pair = self.steppers(library_path)
        free = self._model.simulator.scene.rigid_motion is RigidMotion.PREDICTED
        tolerance = TOLERANCE_OF_PREDICTED if free else TOLERANCE
        row = over_frames(*pair, group.select(0), COMPARED_STEPS)
        return {
            'calls': row['frames'],
            'engine': pair[0].engine,
            'relative_difference': _checked(row, ('position', 'force'), tolerance),
            'tolerance': tolerance,
            'particles_difference_m': row['particles_m'],
        }


class CSoilField:
    """A soil field; of an FMU, `tools` work on its terrain. As `CModel`."""

    def __init__(self, model_path: str, data_path: str, tools: int = 1):
        self._field = registry.of_folder(model_path).load_code().load(model_path)
        self._data_path, self._tools = data_path.split(',')[0], tools
        self._name, self._values = project.symbol(model_path), soil_data.values(self._field)

    def describe(self) -> dict:
        """See `CModel`."""
        found = {name: self._values[name] for name in ('digest', 'n_member')}
        return {'symbol': self._name, 'tool': self._field.networks.tool.name} | found

    def write(self, kind: str, folder: str) -> dict:
        """See `CModel`; ValueError for a number of tools that no FMU has, too."""
        return _write(kind, folder, self._name, self._values, self._compared, self._tools)

    def _compared(self, library_path):
        run = runs.read(self._data_path, 'test')[0]
        loaded = binding.Loaded.open(library_path, self._name)
        grounds = [run.before() for _ in range(2)]
        pair = [
            soil_engine.CEngine(loaded, grounds[0], run.tool),
            TfEngine(self._field, grounds[1], run.tool, None),
        ]
        loads = []
        for t, pose in enumerate(run.pose):
            frames = [one.step(pose, run.dt) if t else one.start(pose) for one in pair]
            loads.append([np.concatenate([f.force, f.torque]) for f in frames])
        (c, wanted), heights = np.moveaxis(loads, 1, 0), [ground.heights for ground in grounds]
        size = max(float(np.abs(wanted).max()), 1e-6)
        apart = {'force': float(np.abs(c - wanted).max()) / size}
        return {
            'calls': len(loads),
            'engine': pair[0].name,
            'relative_difference': _checked(apart, ('force',), TOLERANCE),
            'tolerance': TOLERANCE,
            'heights_difference_m': float(np.abs(heights[0] - heights[1]).max()),
        }


def _write(kind, folder, name, values, compare, tools=1):
    with tempfile.TemporaryDirectory() as scratch:
        project.write(scratch, name, values)
        built = os.path.join(scratch, 'model.so')
        try:
            library.compile_sources(built, *library.parts_of(scratch))
            compared = compare(built)
        except library.NoCompiler as error:
            compared = {'skipped': str(error)}
    if kind == 'fmu':
        fmu.write(os.path.join(folder, f'{name}.fmu'), name, values, tools)
    else:
        project.write(folder, name, values)
    return {'compared': compared}


def _checked(found, names, tolerance):
    """Some of the differences that were found; ValueError where one is above the tolerance, or not
    finite."""
    difference = {name: found[name] for name in names}
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
      of the largest, `particles_m`, and `same_status`: in how many frames kind, frame and node of
      the judgements agree.
    """
    truth, n = group.position[0], group.n_rigid
    for stepper in (ours, theirs):
        stepper.reset(truth[:H], group.context_at(H, 0))
    known, first = theirs.scene.rigid_motion.is_known, theirs.frame
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
        if frame.now.status not in (RolloutStatus.OK, RolloutStatus.EXTRAPOLATING):
            break
        same += mine.now[:3] == frame.now[:3] and mine.judgement[:3] == frame.judgement[:3]
        one, other, start = (np.concatenate([f.rigid_pose, f.modes]) for f in (mine, frame, first))
        note('position', one, other, other - start)
        if frame.force is not None:
            note('force', mine.force, frame.force, frame.force)
        if first.decoder is not None and count % every == 0:
            # Steppers decode particles themselves: here those of the library count.
            points, drawn = frame.particles(), ours.computing.particles()
            note('particles', drawn, points, points - first.particles())
        count += 1
    shares = {k: apart[k] / sizes[k] if sizes[k] > 0 else apart[k] for k in apart}
    return {'frames': count, 'same_status': same, 'particles_m': apart['particles']} | shares
