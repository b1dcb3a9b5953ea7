"""Models on synthetic data, shared by the tests of the simulator."""

import dataclasses

import numpy as np

from learning_to_simulate import presets, reading_utils
from learning_to_simulate.subspace import method
from pca_tools import dataset
from tests.learning_to_simulate import synthetic

SMALL = {'latent_size': 16, 'batch_size': 4, 'mode_edges': 5}


def make(
    folder,
    preset='pcg',
    motion='prescribed',
    rigid_motion=None,
    overrides=None,
    contact=False,
    **data,
):
    """Writes a dataset and makes an untrained small model for it, with `contact` one whose body
    comes from the air into the soil; returns (model, groups, metadata)."""
    synthetic.write_dataset(folder, motion=motion, **data)
    config = presets.make_config(preset, **SMALL | (overrides or {}))
    metadata = dataset.read_metadata(str(folder))
    groups = reading_utils.read_groups(str(folder), 'train', metadata, **config.nodes)
    model = method.make_model(str(folder), metadata, groups, config, rigid_motion)
    if contact:
        simulator = model.simulator
        simulator.statistics = dataclasses.replace(simulator.statistics, **surface(groups))
        model = dataclasses.replace(model)  # without the layouts of before
    return model, groups, metadata


def surface(groups):
    """Statistics of a surface that the body of the longest way is clear of at first only."""
    lowest = np.concatenate([g.position[..., : g.n_rigid, 1].min(axis=2) for g in groups])
    rng, places = np.random.default_rng(3), np.linspace(0.3, 1.2, 40)
    rows = [places, np.full(40, lowest.min()), *rng.normal(0, 1e-3, (3 * synthetic.N_MODES, 40))]
    middle = np.ptp(lowest) / 2
    return {'contact': np.array([0.0, middle]), 'surface': np.stack(rows, axis=1)}


def stepper(model, n_rigid, space=None, kind='tensorflow', **options):
    """A `Stepper` of a model that begins from recorded frames."""
    from learning_to_simulate.live.stepper import Stepper
    from learning_to_simulate.native import engines

    return Stepper(engines.of(model, None, space, kind, n_rigid), **options)
