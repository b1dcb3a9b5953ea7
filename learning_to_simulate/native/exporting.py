"""A trained model as a C project or an FMU, for `learning_to_simulate.export`."""

import os

from learning_to_simulate.native import agreement, fmu, project


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
        sizes = ('n_rigid', 'n_start', 'n_member')
        return {
            'symbol': self._name,
            'digest': self._values['digest'],
            'scene': self._opened.model.simulator.scene.to_json(),
        } | {name: self._values[name] for name in sizes if name in self._values}

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
