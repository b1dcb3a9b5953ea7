"""A trained model as a C project or an FMU, for `learning_to_simulate.export`: compiled, and
compared with TensorFlow over the first test run of its dataset."""

import os
import tempfile

import numpy as np

from learning_to_simulate import registry
from learning_to_simulate.native import agreement, fmu, library, project, soil_data, soil_engine
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.soil_field import runs
from learning_to_simulate.soil_field.engine import TfEngine


class CModel:
    """A model in a subspace, for bodies of the size of its first start.

    Raises:
      FileNotFoundError, ValueError: no model there, or one that has no C form.
    """

    def __init__(self, model_path: str, data_path: str):
        self._paths, self._opened = (model_path, data_path), agreement.Opened.of(model_path)
        self._name, self._values = project.symbol(model_path), self._opened.values()

    def describe(self) -> dict:
        """What a user of the exported model must know; JSON-able."""
        names = ('digest', 'n_rigid', 'n_start')
        found = {'symbol': self._name} | {name: self._values[name] for name in names}
        return found | {'scene': self._opened.model.simulator.scene.to_json()}

    def write(self, kind: str, folder: str) -> dict:
        """Writes the files of a format of `native.FORMATS`; returns how they compare. ValueError
        for C that does not compile, a dataset that the model does not fit, or outputs beyond the
        tolerance."""
        return _write(kind, folder, self._name, self._values, self._compared)

    def _compared(self, library_path):
        pair = self._opened.steppers(library_path, self._name)
        groups = registry.open_model(*self._paths, 'test').groups
        group = next((g for g in groups if g.n_rigid == self._opened.n_rigid), None)
        if group is None:
            return {'skipped': f'no test run has {self._opened.n_rigid} rigid nodes'}
        free = self._opened.model.simulator.scene.rigid_motion is RigidMotion.PREDICTED
        tolerance = agreement.TOLERANCE_OF_PREDICTED if free else agreement.TOLERANCE
        row = agreement.over_frames(*pair, group.select(0), agreement.COMPARED_STEPS)
        difference = agreement.checked({n: row[n] for n in ('position', 'force')}, tolerance)
        return {
            'calls': row['frames'],
            'engine': pair[0].engine,
            'relative_difference': difference,
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
        loaded = soil_engine.Library.open(library_path, self._name)
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
            'relative_difference': agreement.checked(apart, agreement.TOLERANCE),
            'tolerance': agreement.TOLERANCE,
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
