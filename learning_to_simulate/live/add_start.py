"""Puts into a model folder what the model needs to run without its dataset.

Models that are trained now carry it from the start; this is for folders from before.

Example:
  lts add-start --model_path=models/excavation/pcg --data_path=datasets/excavation
"""

import os

from absl import flags

from learning_to_simulate import command
from pca_tools import files


def add_start(model_path: str, data_path: str) -> list[str]:
    """Writes `start.npz` and `subspace.npz` into a model folder; returns their names.

    Args:
      model_path: of a model in the subspace.
      data_path: the dataset it was trained on.

    Raises:
      FileNotFoundError, ValueError: no model or dataset there, or they do not belong together.
    """
    command.import_tensorflow()
    from learning_to_simulate import checkpoints, registry
    from learning_to_simulate.live import resting_start
    from pca_tools import dataset

    if registry.of_folder(model_path).network is None:
        raise ValueError(f'{model_path}: no model in a subspace, which alone lacks its start')
    model = checkpoints.load_model(model_path)
    metadata = dataset.read_metadata(data_path)
    checkpoints.check_dataset(model_path, model, data_path, metadata)
    written = resting_start.write(model_path, data_path, model.simulator.config.nodes)
    values = checkpoints.read_config(model_path) | {'files': written}
    files.write_json(os.path.join(model_path, checkpoints.CONFIG_FILE), values)
    return list(written)


def run(values) -> None:
    """Runs the command with its flags."""
    written = add_start(values.model_path, values.data_path)
    print(f'wrote {", ".join(written)} to {values.model_path}')


if __name__ == '__main__':
    flags.DEFINE_string('model_path', None, 'Model folder to complete.', required=True)
    flags.DEFINE_string('data_path', None, 'Dataset it was trained on.', required=True)
    command.start(run)
