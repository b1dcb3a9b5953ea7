"""Soil at rest, body and scene values that a live run starts from: those of the training runs."""

import os

import numpy as np

from learning_to_simulate import checkpoints, reading_utils
from pca_tools.dataset import read_metadata
from pca_tools.subspace import Subspace

# Two starts are one if nothing in them differs by more than float32 records do, m.
SAME = 1e-5


def read_model(model_path: str, data_path: str, n_rigid: int | None = None):
    """A model with what belongs to it.

    Args:
      model_path: of `checkpoints.load_model`.
      data_path: its dataset folder.
      n_rigid: R; default: that of the model's first training run.

    Returns:
      the model, R, its `Subspace` or None, and the starts of `read`.

    Raises:
      FileNotFoundError, ValueError: no model or dataset there, or they do not belong together.
    """
    model = checkpoints.load_model(model_path)
    metadata = read_metadata(data_path)
    checkpoints.check_dataset(model_path, model, data_path, metadata)
    path = os.path.join(data_path, 'subspace.npz')
    subspace = Subspace.load(path) if os.path.exists(path) else None
    n_rigid = checkpoints.read_config(model_path)['n_rigid'] if n_rigid is None else n_rigid
    return model, n_rigid, subspace, read(data_path, metadata, model.simulator.config, n_rigid)


def read(data_path: str, metadata: dict, config, n_rigid: int) -> list[dict]:
    """The different starts of the training runs, in their order.

    Args:
      data_path: dataset folder.
      metadata: its validated metadata.
      config: `TrainConfig`; says which particles and modes are nodes.
      n_rigid: R.

    Returns:
      dicts of `modes` [r, 3], `points` [R, 3] and `context` [C] of the first frame.
    """
    found: list[dict] = []
    for group in reading_utils.read_groups(data_path, 'train', metadata, **config.nodes):
        if group.n_rigid != n_rigid:
            continue
        for run, nodes in enumerate(group.position[:, 0]):
            start = {
                'modes': nodes[n_rigid:],
                'points': nodes[:n_rigid],
                'context': np.zeros(0) if group.context is None else group.context_at(0, run),
            }
            if not any(_same(start, other) for other in found):
                found.append(start)
    return found


def _same(a, b):
    """Whether soil, scene and the shape of the body are the same; where it stands does not
    matter."""
    distances = [np.linalg.norm(x['points'][:, None] - x['points'], axis=-1) for x in (a, b)]
    return (
        np.abs(a['modes'] - b['modes']).max() < SAME
        and np.array_equal(a['context'], b['context'])
        and np.abs(distances[0] - distances[1]).max(initial=0.0) < SAME
    )
