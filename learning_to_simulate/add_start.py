"""Puts into a model folder what the model needs to run without its dataset.

Models that are trained now carry it from the start; this is for folders from before.

Example:
  python -m learning_to_simulate.add_start --model_path=models/excavation/pcg \\
      --data_path=datasets/excavation
"""

import os
import sys

from absl import app, flags

from pca_tools import files


def add_start(model_path: str, data_path: str) -> list[str]:
    """Writes `start.npz` and `subspace.npz` into a model folder; returns their names.

    Args:
      model_path: of a model in the subspace.
      data_path: the dataset it was trained on.

    Raises:
      FileNotFoundError, ValueError: no model or dataset there, or they do not belong together.
    """
    from learning_to_simulate import checkpoints, resting_start
    from pca_tools import dataset

    model = checkpoints.load_model(model_path)
    metadata = dataset.read_metadata(data_path)
    checkpoints.check_dataset(model_path, model, data_path, metadata)
    written = resting_start.write(model_path, data_path, model.simulator.config.nodes)
    values = checkpoints.read_config(model_path) | {'files': written}
    files.write_json(os.path.join(model_path, checkpoints.CONFIG_FILE), values)
    return list(written)


def main(argv) -> None:
    """Runs the command."""
    if len(argv) > 1:
        raise app.UsageError(f'unknown arguments: {argv[1:]}')
    try:
        written = add_start(flags.FLAGS.model_path, flags.FLAGS.data_path)
    except (ValueError, OSError) as error:
        sys.exit(f'error: {error}')
    print(f'wrote {", ".join(written)} to {flags.FLAGS.model_path}')


if __name__ == '__main__':
    flags.DEFINE_string('model_path', None, 'Model folder to complete.', required=True)
    flags.DEFINE_string('data_path', None, 'Dataset it was trained on.', required=True)
    app.run(main)
