"""Training runs and trained models on disk: train, resume, open for evaluation.

What `train.py` does once its flags are read; scripts call these functions directly.
"""

import dataclasses
import os
import time

import numpy as np
import tensorflow as tf
import tqdm

from learning_to_simulate import (
    checkpoints,
    connectivity_utils,
    evaluation,
    normalization,
    reading_utils,
)
from learning_to_simulate.learned_simulator import LearnedSimulator
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.training import Trainer
from pca_tools import dataset, files


def _digests(folder):
    names = [
        n for n in ('metadata.json', 'train.tfrecord') if os.path.exists(os.path.join(folder, n))
    ]
    return {n: files.sha256_of_file(os.path.join(folder, n)) for n in names}


def make_model(data_path, metadata, groups, config, rigid_motion=None) -> checkpoints.Model:
    """A fresh model for the training runs of a dataset, its variables created.

    Args:
      data_path: dataset folder.
      metadata: its metadata.
      groups: `RunGroup`s of the training split.
      config: `TrainConfig`.
      rigid_motion: override of the scene's, or None.

    Raises:
      ValueError: edges that do not fit the dataset, or a scene that the config cannot model.
    """
    scene = reading_utils.read_scene(data_path, metadata, groups, rigid_motion)
    if (
        config.predict_driven_body
        and rigid_motion is None
        and scene.rigid_motion == RigidMotion.DRIVEN
    ):
        scene = reading_utils.read_scene(data_path, metadata, groups, str(RigidMotion.PREDICTED))
    statistics = normalization.compute_statistics(
        [g.position for g in groups],
        [g.force for g in groups],
        [g.context for g in groups],
        metadata,
        scene,
        config,
    )
    mode_mask = loaded_mask = None
    if config.adjacency == 'algorithm2':
        velocities = np.concatenate([g.velocity[:, :, g.n_rigid :] for g in groups])
        mode_mask = connectivity_utils.rank_mode_edges(velocities, config.mode_edges)
    elif config.adjacency != 'fully_connected':
        loaded_mask = connectivity_utils.load_mask(config.adjacency)
    types = groups[0].particle_type
    simulator = LearnedSimulator(scene, config, statistics, (int(types[0]), int(types[-1])))
    model = checkpoints.Model(simulator, mode_mask, loaded_mask)
    for group in groups:
        model.layout(group.n_rigid)
    model.create_variables(groups[0].n_rigid)
    if config.zero_decoder:
        simulator.zero_decoder()
    return model


def _open_model_path(path, model, n_rigid, data):
    """Claims a model folder: writes config.json into a new one, compares with the config of an old
    one."""
    os.makedirs(path, exist_ok=True)
    if not os.path.exists(os.path.join(path, checkpoints.CONFIG_FILE)):
        if strangers := os.listdir(path):
            raise ValueError(
                f'{path}: not empty and not a model folder (holds {sorted(strangers)[:3]}); '
                f'nothing was written'
            )
        checkpoints.save_config(path, model, n_rigid, data)
        return
    stored = checkpoints.read_config(path)
    fresh = {
        'config': dataclasses.asdict(model.simulator.config),
        'scene': model.simulator.scene.to_json(),
        'data': data,
    }
    for part, values in fresh.items():
        old = stored[part]
        differing = [
            k
            for k in values.keys() | old.keys()
            if _plain(values.get(k)) != _plain(old.get(k)) and k != 'path'
        ]
        if differing:
            listed = ', '.join(
                f'{k}: {old.get(k)!r} there, {values.get(k)!r} now' for k in sorted(differing)
            )
            raise ValueError(
                f'{path}: holds a model of another {part} ({listed}); nothing was written, give '
                f'another --model_path'
            )
    if not tf.train.latest_checkpoint(path) and os.path.exists(
        os.path.join(path, checkpoints.WEIGHTS_FILE)
    ):
        raise ValueError(
            f'{path}: holds weights without training state, so training cannot resume; give '
            f'another --model_path'
        )


def _plain(value):
    return [_plain(v) for v in value] if isinstance(value, (list, tuple)) else value


def train(data_path, model_path, config, rigid_motion=None, save_every=None) -> dict:
    """Trains to the end of both stages, or resumes; returns the metrics of the last validation
    rollout.

    Raises:
      ValueError: bad data, edges or config; a model folder of something else; a loss that is not
        finite.
    """
    metadata = dataset.read_metadata(data_path)
    groups = reading_utils.read_groups(data_path, 'train', metadata, config.rigid_particles)
    has_valid = os.path.exists(dataset.split_path(data_path, 'valid'))
    valid = (
        reading_utils.read_groups(data_path, 'valid', metadata, config.rigid_particles)
        if has_valid
        else []
    )
    model = make_model(data_path, metadata, groups, config, rigid_motion)
    data = {'path': os.path.abspath(data_path), 'sha256': _digests(data_path)}
    trainer = Trainer(model, groups)
    _open_model_path(model_path, model, groups[0].n_rigid, data)
    step = tf.Variable(0, dtype=tf.int64)
    checkpoint = tf.train.Checkpoint(
        simulator=model.simulator, optimizer=trainer.optimizer, averages=trainer.averages, step=step
    )
    manager = tf.train.CheckpointManager(checkpoint, model_path, max_to_keep=2)
    if manager.latest_checkpoint:
        checkpoint.restore(manager.latest_checkpoint).assert_consumed()
        print(f'resumed {model_path} at step {int(step)}')
    total = trainer.total_steps
    save_every = save_every or max(total // 10, 1)
    evaluator = evaluation.Evaluator(model, metadata)
    writer = tf.summary.create_file_writer(model_path)
    layouts = [model.layout(g.n_rigid) for g in groups]
    print(
        f'{config.preset} on {data_path}: {sum(len(g.position) for g in groups)} runs, '
        f'{", ".join(f"{x.n_node} nodes / {x.n_edge} edges" for x in layouts)}, '
        f'{sum(int(np.prod(v.shape)) for v in model.simulator.trainable_variables)} weights, '
        f'{total} steps'
    )
    summary = {}
    start = int(step)
    with (
        tqdm.tqdm(total=total, initial=start, unit='step', disable=None, smoothing=0.05) as bar,
        writer.as_default(),
    ):
        clock = time.perf_counter()
        for i in range(start, total):
            values = trainer.step(i)
            bar.update()
            last = i + 1 == total
            if (i + 1) % 50 == 0 or last:
                scalars = {k: float(v) for k, v in values.items()}
                if not np.isfinite(scalars['loss']):
                    raise ValueError(
                        f'loss is {scalars["loss"]} at step {i}; the checkpoint of before stays '
                        f'in {model_path}'
                    )
                bar.set_postfix({k: f'{v:.3g}' for k, v in scalars.items()})
                rate = (i + 1 - start) / (time.perf_counter() - clock)
                for name, value in (
                    scalars.items()
                    | {'steps_per_sec': rate, 'lr': float(trainer.learning_rate(i))}.items()
                ):
                    tf.summary.scalar(name, value, step=i)
            if (i + 1) % save_every == 0 or last:
                step.assign(i + 1)
                with trainer.averaged_weights():
                    if valid:
                        _, summary = evaluator.run(valid, 'valid')
                        _log_rollout(summary, i, bar)
                    checkpoints.save_weights(model_path, model.simulator)
                manager.save(checkpoint_number=i + 1)
    if start >= total:
        print(f'{model_path}: already trained to step {total}')
    print(f'trained {total} steps: {model_path}')
    return summary


def _log_rollout(summary, step, bar):
    # A rollout that blew up has no number (null in metrics.json); training goes on and says so.
    mean = {k: float('nan') if v is None else v for k, v in summary['mean']['model'].items()}
    tf.summary.scalar('rollout_error_mse', mean['soil_mse'], step=step)
    ratio = summary['soil_mse_over_best_trivial'] or float('nan')
    text = f'step {step + 1}: valid rollout soil MSE {mean["soil_mse"] * 1e4:.4g}e-4 m2'
    text += f' (x {ratio:.3g} of the best trivial)'
    if 'force_relative_l2' in mean:
        tf.summary.scalar('force_error_mse', mean['force_rmse'] ** 2, step=step)
        text += f', force rel. L2 {mean["force_relative_l2"]:.3g}'
    bar.write(text)


def load_for_evaluation(model_path, data_path, split, overrides):
    """The model, its dataset's metadata and the runs of the split.

    Raises:
      FileNotFoundError: no model, dataset or split there.
      ValueError: an override contradicts the model, or the dataset does not fit it.
    """
    model = checkpoints.load_model(model_path)
    config = model.simulator.config
    for field, value in overrides.items():
        if value != getattr(config, field):
            raise ValueError(
                f'--{field}={value} contradicts the model in {model_path}, which has '
                f'{getattr(config, field)!r}: leave the flag out'
            )
    metadata = dataset.read_metadata(data_path)
    scene = model.simulator.scene
    if metadata['mode_number'] != scene.n_modes:
        raise ValueError(
            f'{data_path} has {metadata["mode_number"]} modes, the model in {model_path} was '
            f'trained on {scene.n_modes}'
        )
    for key, wanted in (
        ('rigid_body_force_mean', scene.has_force),
        ('context_mean', bool(scene.context_names)),
    ):
        if (key in metadata) != wanted:
            has = 'has' if key in metadata else 'lacks'
            raise ValueError(
                f'{data_path}/metadata.json {has} {key}, unlike the data of {model_path}'
            )
    groups = reading_utils.read_groups(data_path, split, metadata, config.rigid_particles)
    for group in groups:
        model.layout(group.n_rigid)
    return model, metadata, groups
