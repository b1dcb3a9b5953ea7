"""Soil at rest, body and scene values that a run in C starts from: those of the dataset's runs."""

import os

import numpy as np

from learning_to_simulate import checkpoints
from learning_to_simulate.live import poses
from learning_to_simulate.live import starts as live_starts
from learning_to_simulate.subspace import subspace_model
from pca_tools.dataset import read_metadata
from pca_tools.subspace import Subspace


def read_model(model_path: str, data_path: str, n_rigid: int | None = None):
    """A model with what belongs to it.

    Args:
      model_path: of `subspace_model.load`.
      data_path: its dataset folder.
      n_rigid: R; default: that of the model's first training run.

    Returns:
      the model, R, its `Subspace` or None, and the starts of `read`.

    Raises:
      FileNotFoundError, ValueError: no model or dataset there, or they do not belong together.
    """
    model = subspace_model.load(model_path)
    metadata = read_metadata(data_path)
    checkpoints.check_dataset(model_path, model, data_path, metadata)
    path = os.path.join(data_path, 'subspace.npz')
    subspace = Subspace.load(path) if os.path.exists(path) else None
    n_rigid = checkpoints.read_config(model_path)['n_rigid'] if n_rigid is None else n_rigid
    return model, n_rigid, subspace, read(data_path, model.simulator.config, n_rigid)


def read(data_path: str, config, n_rigid: int) -> list[dict]:
    """The different starts of a dataset's runs, those of the training runs first.

    Args:
      data_path: dataset folder.
      config: `TrainConfig`; says which particles and modes are nodes.
      n_rigid: R.

    Returns:
      dicts of `modes` [r, 3], `points` [R, 3] and `context` [C] of the first frame.

    Raises:
      FileNotFoundError, ValueError: as `live_starts.collect`.
    """
    found = live_starts.collect(data_path, config.nodes)
    context = np.zeros((len(found), 0)) if found.context is None else found.context
    n_modes = config.modes or found.modes.shape[1]
    return [
        {
            'modes': found.modes[i][:n_modes],
            'points': poses.placed(found.body[i][kept], found.pose[i]),
            'context': context[i],
        }
        for i, kept in enumerate(found.kept)
        if len(kept) == n_rigid
    ]
