"""Training runs and trained models on disk by their former names; see `methods.registry`."""

from learning_to_simulate.checkpoints import check_dataset
from learning_to_simulate.methods.subspace_method import (
    data_digests,
    make_model,
    open_model,
    train,
)

__all__ = ['check_dataset', 'data_digests', 'load_for_evaluation', 'make_model', 'train']


def load_for_evaluation(model_path, data_path, split, overrides):
    """The model, its dataset's metadata and the runs of the split; raises as `open_model`."""
    opened = open_model(model_path, data_path, split, overrides)
    return opened.model, opened.metadata, opened.groups
