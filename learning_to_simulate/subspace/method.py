"""Methods on the scores of the modes: data, model, training and evaluation on disk.

The `code` of gns, the MLP and the mixers in `registry`; `subspace_model` makes their networks.
"""

import dataclasses
import os

import tensorflow as tf

from learning_to_simulate import bed, checkpoints, evaluation, normalization, reading_utils
from learning_to_simulate.axes import Axes
from learning_to_simulate.live import starts
from learning_to_simulate.live.stepper import TfStep as Step  # noqa: F401  # of `registry`
from learning_to_simulate.registry import OpenedModel
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace import contact, edge_lists
from learning_to_simulate.subspace.path_memory import PathMemory
from learning_to_simulate.subspace.subspace_model import Model, load, make_simulator
from pca_tools import dataset
from pca_tools.subspace import Subspace

__all__ = ['load', 'make_model', 'open_model', 'train']


def make_model(data_path, metadata, groups, config, rigid_motion=None) -> Model:
    """A fresh model for the training runs (`RunGroup`s) of a dataset, its variables created;
    `rigid_motion` overrides the scene's. ValueError for edges that do not fit the dataset, or a
    scene that the config cannot model."""
    scene = reading_utils.read_scene(data_path, metadata, groups, rigid_motion)
    driven = rigid_motion is None and scene.rigid_motion == RigidMotion.DRIVEN
    if config.is_published and driven:
        scene = reading_utils.read_scene(data_path, metadata, groups, str(RigidMotion.PREDICTED))
    statistics = normalization.compute_statistics(groups, metadata, scene, config)
    further = {}
    if config.reads_path:
        further['path'] = _path_memory(data_path, metadata, groups, scene).to_statistics()
    space_path = os.path.join(data_path, checkpoints.SUBSPACE_FILE)
    if not config.is_published and os.path.exists(space_path):
        space = Subspace.load(space_path).truncated(scene.n_modes)
        if found := contact.fit(groups, space, statistics.origin[1:], scene):
            further |= found.to_statistics()
    statistics = dataclasses.replace(statistics, **further)
    velocities = [g.velocity[:, :, g.n_rigid :] for g in groups]
    edges = edge_lists.choose(config, data_path, scene.n_modes, velocities)
    types = groups[0].particle_type
    types = int(types[0]), int(types[-1])
    model = Model(make_simulator(scene, config, statistics, types), *edges)
    for group in groups:
        model.layout(group.n_rigid)
    tf.random.set_seed(config.seed)
    model.create_variables(groups[0].n_rigid)
    return model


def _path_memory(data_path, metadata, groups, scene):
    if scene.rigid_motion != RigidMotion.PRESCRIBED or scene.bodies:
        raise ValueError(
            f'mode_order 0 needs one body whose whole motion is given (prescribed); in {data_path} '
            f'it is {scene.rigid_motion}, bodies {len(scene.bodies) or 1}'
        )
    bodies = [g.position[:, :, : g.n_rigid] for g in groups]
    axes = Axes.of_bodies(bodies, scene.up_axis)
    surface = bed.height_of_dataset(data_path, metadata, axes)
    return PathMemory.of_runs(bodies, axes, surface, scene.dt)


def _with_copies(model, groups, data_path):
    """The runs that a config trains on: with copies of them where it asks for some."""
    config, scene = model.simulator.config, model.simulator.scene
    if not config.copies:
        return groups
    from learning_to_simulate.subspace import symmetric_copies

    path = os.path.join(data_path, checkpoints.SUBSPACE_FILE)
    if not scene.rigid_motion.is_known or scene.bodies or not os.path.exists(path):
        raise ValueError(
            f'copies is {config.copies}: shifted runs need one body whose motion is known and a '
            f'subspace.npz in {data_path}'
        )
    space = model.fitting_subspace(Subspace.load(path))
    return symmetric_copies.with_copies(groups, space, scene.up_axis, config.copies, config.seed)


def train(data_path, model_path, config, options) -> dict:
    """Trains to the end of both stages, or resumes; see `registry.train`."""
    # A model that is only run waits neither for Keras nor for the rest of training.
    from learning_to_simulate.subspace.trainer import Trainer
    from learning_to_simulate.training import loop

    metadata = dataset.read_metadata(data_path)
    groups = reading_utils.read_groups(data_path, 'train', metadata, **config.nodes)
    valid = []
    if os.path.exists(dataset.split_path(data_path, 'valid')):
        valid = reading_utils.read_groups(data_path, 'valid', metadata, **config.nodes)
    model = make_model(data_path, metadata, groups, config, options.rigid_motion)
    trainer = Trainer(model, _with_copies(model, groups, data_path))
    layouts = [model.layout(g.n_rigid) for g in groups]
    training = loop.Training(
        model=model,
        trainer=trainer,
        evaluator=evaluation.Evaluator(model, metadata, starts.largest_force(groups)),
        valid=valid,
        n_rigid=groups[0].n_rigid,
        data=checkpoints.data_record(data_path, metadata),
        title=f'{config.preset} on {data_path}: {sum(len(g.position) for g in groups)} runs, '
        f'{", ".join(f"{x.n_node} nodes / {x.n_edge} edges" for x in layouts)} '
        f'({model.edge_source})',
        write_files=lambda path: starts.write(path, data_path, config.nodes),
    )
    if trainer.gates:
        training.close_gates = lambda path: _close_gates(training, data_path, path)
    return loop.run(training, model_path, options)


def _close_gates(training, data_path, model_path):
    """Fixes the learned edges, writes them beside the model, and says what they are."""
    trainer, model = training.trainer, training.model
    config = model.simulator.config
    edges = trainer.gates.edge_list(config, data_path)
    trainer.fix_edges(edges.mask)
    edge_lists.write(os.path.join(model_path, edge_lists.FILE_NAME), edges)
    beside = checkpoints.read_config(model_path).get('files')
    checkpoints.save_config(model_path, model, training.n_rigid, training.data, beside)
    text = f'step {config.gate_steps}: {edges.n_edge} of {edges.mask.size} mode edges stay'
    return text + (f'; the graph is {edges.degenerate}' if edges.degenerate else '')


def open_model(model_path, data_path, split, raw_path=None) -> OpenedModel:
    """A trained model with the runs of a split; see `registry`."""

    def one_step_errors():
        from learning_to_simulate.subspace.trainer import Trainer

        return Trainer(model, groups).one_step_errors()

    model = load(model_path)
    metadata = dataset.read_metadata(data_path)
    checkpoints.check_dataset(model_path, model, data_path, metadata)
    nodes = model.simulator.config.nodes
    groups = reading_utils.read_groups(data_path, split, metadata, **nodes)
    for group in groups:
        model.layout(group.n_rigid)
    force_limit = starts.read_force_limit(model_path)
    evaluator = evaluation.Evaluator(model, metadata, force_limit)
    return OpenedModel(model, groups, metadata, evaluator, one_step_errors)
