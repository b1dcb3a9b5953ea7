"""A trained model as a C project or an FMU, for `learning_to_simulate.export`."""

import os
import tempfile

import numpy as np

from learning_to_simulate import registry
from learning_to_simulate.native import agreement, fmu, library, project, soil_data, soil_engine
from learning_to_simulate.soil_field import runs
from learning_to_simulate.soil_field.engine import TfEngine


class CModel:
    """A model on its way to C: compiled, and compared with TensorFlow over a recorded run.

    Args:
      model_path, data_path: trained model, and its dataset, whose first test run is compared.
      n_rigid: R of the exported graph; None for that of the model's first start.

    Raises:
      FileNotFoundError, ValueError: no model there, or one that has no C form.
    """

    def __init__(self, model_path: str, data_path: str, n_rigid: int | None = None):
        self._paths, self._name = (model_path, data_path), project.symbol(model_path)
        self._opened = agreement.Opened.of(model_path, n_rigid)
        self._values = self._opened.values()

    def describe(self) -> dict:
        """What a user of the exported model must know; JSON-able."""
        sizes = ('n_rigid', 'n_start')
        return {
            'symbol': self._name,
            'digest': self._values['digest'],
            'scene': self._opened.model.simulator.scene.to_json(),
        } | {name: self._values[name] for name in sizes}

    def write(self, kind: str, folder: str) -> dict:
        """Writes the files of a format of `native.FORMATS`; returns how they compare.

        Raises:
          ValueError: C that does not compile, a dataset that the model does not fit, or outputs
            beyond the tolerance.
        """
        compared = agreement.of_project(*self._paths, self._name, self._opened)
        if kind == 'fmu':
            fmu.write(os.path.join(folder, f'{self._name}.fmu'), self._name, self._values)
        else:
            project.write(folder, self._name, self._values)
        return {'compared': compared}


class CSoilField:
    """A soil field on its way to C, as `CModel`.

    Args:
      model_path, data_path: as there.
      tools: of an FMU, how many tools work on its terrain.
    """

    def __init__(self, model_path: str, data_path: str, tools: int = 1):
        self._tools = tools
        self._field = registry.of_folder(model_path).load_code().load(model_path)
        self._data_path, self._name = data_path.split(',')[0], project.symbol(model_path)
        self._values = soil_data.values(self._field)

    def describe(self) -> dict:
        """What a user of the exported model must know; JSON-able."""
        return {
            'symbol': self._name,
            'digest': self._values['digest'],
            'tool': self._field.networks.tool.name,
            'n_member': self._values['n_member'],
        }

    def write(self, kind: str, folder: str) -> dict:
        """Writes the files of a format of `native.FORMATS`; returns how they compare.

        Raises:
          ValueError: C that does not compile, a number of tools that no FMU has, or outputs beyond
            the tolerance.
        """
        with tempfile.TemporaryDirectory() as scratch:
            project.write(scratch, self._name, self._values)
            compared = self._compared(scratch)
        if kind == 'fmu':
            path = os.path.join(folder, f'{self._name}.fmu')
            fmu.write(path, self._name, self._values, self._tools)
        else:
            project.write(folder, self._name, self._values)
        return {'compared': compared}

    def _compared(self, project_folder):
        """Differences of the project to TensorFlow over the first test run."""
        run = runs.read(self._data_path, 'test')[0]
        with tempfile.TemporaryDirectory() as folder:
            built = os.path.join(folder, 'model.so')
            try:
                library.compile_sources(built, *library.parts_of(project_folder))
            except library.NoCompiler as error:
                return {'skipped': str(error)}
            loaded = soil_engine.Library.open(built, self._name)
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
        force = float(np.abs(c - wanted).max()) / size
        if not force <= agreement.TOLERANCE:
            raise ValueError(
                f'the C code differs from the model by {force:.3g} of the largest force, more than '
                f'{agreement.TOLERANCE:g}; nothing was written'
            )
        return {
            'calls': len(loads),
            'engine': pair[0].name,
            'relative_difference': {'force': force},
            'tolerance': agreement.TOLERANCE,
            'heights_difference_m': float(np.abs(heights[0] - heights[1]).max()),
        }
