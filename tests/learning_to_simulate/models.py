"""Models on synthetic data, shared by the tests of the simulator."""

from learning_to_simulate import presets, reading_utils
from learning_to_simulate.methods import subspace_method
from pca_tools import dataset
from tests.learning_to_simulate import synthetic

SMALL = {'latent_size': 16, 'batch_size': 4, 'mode_edges': 5}


def make(folder, preset='pcg', motion='prescribed', rigid_motion=None, overrides=None, **data):
    """Writes a dataset and makes an untrained small model for it; returns (model, groups,
    metadata)."""
    synthetic.write_dataset(folder, motion=motion, **data)
    config = presets.make_config(preset, **SMALL | (overrides or {}))
    metadata = dataset.read_metadata(str(folder))
    groups = reading_utils.read_groups(str(folder), 'train', metadata, **config.nodes)
    return (
        subspace_method.make_model(str(folder), metadata, groups, config, rigid_motion),
        groups,
        metadata,
    )
