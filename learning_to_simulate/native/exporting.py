"""A trained model as a C project or an FMU, for `learning_to_simulate.export`."""

import abc
import os
import tempfile

import numpy as np

from learning_to_simulate import registry
from learning_to_simulate.native import agreement, fmu, library, project, soil_data, soil_engine
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.soil_field import runs
from learning_to_simulate.soil_field.engine import TfEngine


class _CForm(abc.ABC):
    """A model on its way to C: compiled, and compared with TensorFlow over a recorded run."""

    _tools = 1  # of an FMU

    def __init__(self, model_path, values):
        self._name, self._values = project.symbol(model_path), values

    @abc.abstractmethod
    def _compared(self, library_path) -> dict:
        """How the compiled project compares with TensorFlow over the first test run."""

    def describe(self) -> dict:
        """What a user of the exported model must know; JSON-able."""
        return {'symbol': self._name, 'digest': self._values['digest']}

    def write(self, kind: str, folder: str) -> dict:
        """Writes the files of a format of `native.FORMATS`; returns how they compare. ValueError
        for C that does not compile, a dataset that the model does not fit, or outputs beyond the
        tolerance."""
        with tempfile.TemporaryDirectory() as scratch:
            project.write(scratch, self._name, self._values)
            built = os.path.join(scratch, 'model.so')
            try:
                library.compile_sources(built, *library.parts_of(scratch))
                compared = self._compared(built)
            except library.NoCompiler as error:
                compared = {'skipped': str(error)}
        if kind == 'fmu':
            path = os.path.join(folder, f'{self._name}.fmu')
            fmu.write(path, self._name, self._values, self._tools)
        else:
            project.write(folder, self._name, self._values)
        return {'compared': compared}


class CModel(_CForm):
    """A model in a subspace, for bodies of the size of its first start; the first test run of its
    dataset is compared."""

    def __init__(self, model_path: str, data_path: str):
        self._paths, self._opened = (model_path, data_path), agreement.Opened.of(model_path)
        super().__init__(model_path, self._opened.values())

    def describe(self) -> dict:
        sizes = {name: self._values[name] for name in ('n_rigid', 'n_start')}
        scene = self._opened.model.simulator.scene
        return super().describe() | {'scene': scene.to_json()} | sizes

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


class CSoilField(_CForm):
    """A soil field; of an FMU, `tools` work on its terrain."""

    def __init__(self, model_path: str, data_path: str, tools: int = 1):
        self._field = registry.of_folder(model_path).load_code().load(model_path)
        self._data_path, self._tools = data_path.split(',')[0], tools
        super().__init__(model_path, soil_data.values(self._field))

    def describe(self) -> dict:
        own = {'tool': self._field.networks.tool.name, 'n_member': self._values['n_member']}
        return super().describe() | own

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
