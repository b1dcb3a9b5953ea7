"""Models on synthetic data, shared by the tests of the simulator."""

import contextlib
import dataclasses
import os
from unittest import mock

import numpy as np
import tensorflow as tf

from learning_to_simulate import checkpoints, presets, reading_utils, rollout
from learning_to_simulate.live import starts
from learning_to_simulate.subspace import method
from pca_tools import dataset
from tests.learning_to_simulate import synthetic

SMALL = {'latent_size': 16, 'batch_size': 4, 'mode_edges': 5}


@contextlib.contextmanager
def eagerly():
    """A few training steps take less time than a trace of them, which is tested elsewhere. A
    rollout has many."""
    roll_out = rollout.RolloutFunction.__call__

    def traced(*arguments):
        tf.config.run_functions_eagerly(False)
        try:
            return roll_out(*arguments)
        finally:
            tf.config.run_functions_eagerly(True)

    tf.config.run_functions_eagerly(True)
    try:
        with mock.patch.object(rollout.RolloutFunction, '__call__', traced):
            yield
    finally:
        tf.config.run_functions_eagerly(False)


def make(
    folder,
    preset='pcg',
    motion='prescribed',
    rigid_motion=None,
    overrides=None,
    contact=False,
    shaken=0.0,
    **data,
):
    """Writes a dataset and makes an untrained small model for it; returns (model, groups,
    metadata). With `contact` its body comes from the air into the soil; `shaken` is the spread of
    random weights, so that nothing hides behind a zero."""
    synthetic.write_dataset(folder, motion=motion, **data)
    own = {} if presets.PRESETS[preset].has_graph else {'mode_edges': 0}
    config = presets.make_config(preset, **SMALL | own | (overrides or {}))
    model, groups, metadata = of_dataset(folder, config, rigid_motion)
    simulator = model.simulator
    if contact:
        simulator.statistics = dataclasses.replace(simulator.statistics, **surface(groups))
        model = dataclasses.replace(model)  # without the layouts of before
    if shaken:
        rng = np.random.default_rng(0)
        for variable in simulator.trainable_variables:
            variable.assign(rng.normal(0.0, shaken, variable.shape))
    return model, groups, metadata


def of_dataset(folder, config, rigid_motion=None):
    """An untrained model for a dataset that is there: (model, groups, metadata)."""
    metadata = dataset.read_metadata(str(folder))
    groups = reading_utils.read_groups(str(folder), 'train', metadata, **config.nodes)
    return method.make_model(str(folder), metadata, groups, config, rigid_motion), groups, metadata


def saved(folder, preset='pcg', with_subspace=True, **case):
    """Folders of an untrained model and of its data, of the options of `make`."""
    path, data = f'{folder}/model', f'{folder}/data'
    model, groups, _ = make(data, preset, **case)
    if with_subspace:
        synthetic.write_subspace(data)
    os.makedirs(path)
    beside = starts.write(path, data, model.simulator.config.nodes)
    checkpoints.save_config(path, model, groups[0].n_rigid, {'path': data}, beside)
    checkpoints.save_weights(path, checkpoints.weights_of(model))
    return path, data


def surface(groups):
    """Statistics of a surface that the body of the longest way is clear of at first only."""
    lowest = np.concatenate([g.position[..., : g.n_rigid, 1].min(axis=2) for g in groups])
    rng, places = np.random.default_rng(3), np.linspace(0.3, 1.2, 40)
    rows = [places, np.full(40, lowest.min()), *rng.normal(0, 1e-3, (3 * synthetic.N_MODES, 40))]
    middle = np.ptp(lowest) / 2
    return {'contact': np.array([0.0, middle]), 'surface': np.stack(rows, axis=1)}


def steps(model, group, run=0, count=1):
    """Positions [count, V, 3] and loads [count, F] of single steps of one run from frame H on."""
    one, layout = group.select(run), model.layout(group.n_rigid)
    state, known, context, _ = rollout.rollout_inputs(one, layout, model.simulator.scene)
    positions, loads = [], []
    for k in range(count):
        now = context if context is None or len(context.shape) == 2 else context[k]
        coming = None if known is None else known.at(k)
        state, load = model.simulator.step(state, coming, now, layout)
        positions.append(state.offset[0].numpy() + layout.origin)
        loads.append(None if load is None else load[0].numpy())
    return np.stack(positions), np.stack(loads)


def rolled(model, group):
    """`Rollout` of all runs of a group."""
    function = rollout.RolloutFunction(model.simulator, model.layout(group.n_rigid))
    function.is_warm = True
    return rollout.roll_out(function, group)


def stepper(model, n_rigid, space=None, kind='tensorflow', **options):
    """A `Stepper` of a model that begins from recorded frames."""
    from learning_to_simulate.native import engines

    return engines.stepper(model, None, space, kind, n_rigid=n_rigid, **options)
