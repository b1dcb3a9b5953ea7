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
    edge_lists,
    evaluation,
    normalization,
    reading_utils,
    training_state,
)
from learning_to_simulate.networks import make_simulator
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.stop_signals import StopSignals
from learning_to_simulate.training import Trainer
from pca_tools import dataset, files, folder_lock

LOG_EVERY = 50  # steps between looks at the losses


def data_digests(folder: str) -> dict[str, str]:
    """File -> sha256 of what a dataset folder trains on."""
    names = [
        n for n in ('metadata.json', 'train.tfrecord') if os.path.exists(os.path.join(folder, n))
    ]
    return {n: files.sha256_of_file(os.path.join(folder, n)) for n in names}


def _subspace_digest(metadata):
    """Which modes the records are scores of; None for folders that do not state it."""
    return metadata.get('pca', {}).get('digest')


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
    velocities = np.concatenate([g.velocity[:, :, g.n_rigid :] for g in groups])
    edges = edge_lists.choose(config, data_path, scene.n_modes, velocities)
    types = groups[0].particle_type
    simulator = make_simulator(scene, config, statistics, (int(types[0]), int(types[-1])))
    model = checkpoints.Model(simulator, edges.mode_mask, edges.loaded_mask, edges.source)
    for group in groups:
        model.layout(group.n_rigid)
    model.create_variables(groups[0].n_rigid)
    if config.zero_decoder:
        simulator.zero_decoder()
    return model


def open_model_path(path, model, n_rigid, data):
    """Claims a model folder: writes config.json into a new one, compares with the config of an old
    one.

    Raises:
      ValueError: a folder of something else; nothing was written.
    """
    if not os.path.exists(os.path.join(path, checkpoints.CONFIG_FILE)):
        if strangers := set(os.listdir(path)) - {folder_lock.LOCK_NAME}:
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
    if not model.simulator.config.gate_weight:  # learned edges change on the way, by themselves
        masks = {'mode_mask': model.mode_mask, 'loaded_mask': model.loaded_mask}
        for name, mask in masks.items():
            if stored[name] != (None if mask is None else mask.astype(int).tolist()):
                raise ValueError(
                    f'{path}: holds a model with other edges ({stored.get("edge_source")} there, '
                    f'{model.edge_source} now); nothing was written, give another --model_path'
                )
    if not training_state.stored_steps(path) and os.path.exists(
        os.path.join(path, checkpoints.WEIGHTS_FILE)
    ):
        raise ValueError(
            f'{path}: holds weights without training state, so training cannot resume; give '
            f'another --model_path'
        )


def _plain(value):
    return [_plain(v) for v in value] if isinstance(value, (list, tuple)) else value


def train(
    data_path, model_path, config, rigid_motion=None, save_every=None, take_over_lock=False
) -> dict:
    """Trains to the end of both stages, or resumes; returns the metrics of the last validation
    rollout.

    Ctrl-C or SIGTERM end it after the step at hand, with a checkpoint of that step.

    Args:
      data_path: dataset folder.
      model_path: model folder, made if absent; locked while the training runs.
      config: `TrainConfig`.
      rigid_motion: override of the scene's, or None.
      save_every: steps between checkpoints; None for a tenth of all.
      take_over_lock: whether a lock that a process of another machine left may be taken.

    Raises:
      ValueError: bad data, edges or config; a model folder of something else or with another
        writer; only damaged checkpoints; a loss that is not finite.
      OSError: a checkpoint could not be written.
      SystemExit: with 130 after Ctrl-C, 143 after SIGTERM.
    """
    metadata = dataset.read_metadata(data_path)
    groups = reading_utils.read_groups(data_path, 'train', metadata, **config.nodes)
    has_valid = os.path.exists(dataset.split_path(data_path, 'valid'))
    valid = (
        reading_utils.read_groups(data_path, 'valid', metadata, **config.nodes) if has_valid else []
    )
    model = make_model(data_path, metadata, groups, config, rigid_motion)
    data = {
        'path': os.path.abspath(data_path),
        'sha256': data_digests(data_path),
        'subspace': _subspace_digest(metadata),
    }
    trainer = Trainer(model, groups)
    with folder_lock.locked(model_path, take_over_lock), StopSignals() as stop:
        open_model_path(model_path, model, groups[0].n_rigid, data)
        state = training_state.TrainingState(model_path, trainer)
        state.remove_leftovers()
        start = state.restore()
        if start:
            print(f'resumed {model_path} at step {start}')
        layouts = [model.layout(g.n_rigid) for g in groups]
        print(
            f'{config.preset} on {data_path}: {sum(len(g.position) for g in groups)} runs, '
            f'{", ".join(f"{x.n_node} nodes / {x.n_edge} edges" for x in layouts)}, '
            f'{sum(int(np.prod(v.shape)) for v in model.simulator.trainable_variables)} weights, '
            f'{trainer.total_steps} steps; edges: {model.edge_source}'
        )
        evaluator = evaluation.Evaluator(model, metadata)
        close_gates = None
        if trainer.gates:

            def close_gates():
                return _close_gates(trainer, model, data_path, model_path, groups[0].n_rigid, data)

            if start > config.gate_steps:
                print(close_gates())
        return train_steps(
            model_path, trainer, state, start, evaluator, valid, save_every, stop, close_gates
        )


def train_steps(
    model_path, trainer, state, start, evaluator, valid, save_every, stop, close_gates=None
) -> dict:
    """Steps from `start` to the end, with logs, validation rollouts and checkpoints."""
    summary = {}
    total = trainer.total_steps
    save_every = save_every or max(total // 10, 1)
    losses = []  # since the last look at them
    with (
        tqdm.tqdm(total=total, initial=start, unit='step', disable=None, smoothing=0.05) as bar,
        tf.summary.create_file_writer(model_path).as_default(),
    ):
        clock = time.perf_counter()
        for i in range(start, total):
            if close_gates and i == trainer.config.gate_steps:
                bar.write(close_gates())
            values = trainer.step(i)
            losses.append(values['loss'])
            bar.update()
            last = i + 1 == total
            save = (i + 1) % save_every == 0 or last
            if (i + 1) % LOG_EVERY == 0 or save or stop.number:
                _refuse_non_finite(losses, i + 1, trainer, model_path)
                losses = []
            if (i + 1) % LOG_EVERY == 0 or last:
                scalars = {k: float(v) for k, v in values.items()}
                bar.set_postfix({k: f'{v:.3g}' for k, v in scalars.items()})
                rate = (i + 1 - start) / (time.perf_counter() - clock)
                for name, value in (
                    scalars.items()
                    | {'steps_per_sec': rate, 'lr': float(trainer.learning_rate(i))}.items()
                ):
                    tf.summary.scalar(name, value, step=i)
            # While the edges are being learned there is no graph yet that weights belong to.
            learns_edges = close_gates and i < trainer.config.gate_steps
            if save and (last or not stop.number) and not learns_edges:
                with trainer.averaged_weights():
                    if valid:
                        _, summary = evaluator.run(valid, 'valid')
                        _log_rollout(summary, i, bar)
                    checkpoints.save_weights(model_path, trainer.simulator)
            if save or stop.number:
                state.save(i + 1)
            if stop.number and not last:
                bar.write(f'stopped; step {i + 1} is saved in {model_path}, go on by the same call')
                raise SystemExit(stop.exit_code)
    if start >= total:
        print(f'{model_path}: already trained to step {total}')
    print(f'trained {total} steps: {model_path}')
    return summary


def _refuse_non_finite(losses, end, trainer, model_path):
    """Raises if one of the losses of the steps before step `end` is NaN or infinite."""
    finite = np.isfinite([float(loss) for loss in losses])
    if finite.all():
        return
    at = int(np.argmin(finite))
    step = end - len(losses) + at
    raise ValueError(
        f'loss is {float(losses[at])} at step {step}, batch of (record, first frame) '
        f'{trainer.batch_of(step)}; training stopped, the checkpoint of before stays in '
        f'{model_path}'
    )


def _close_gates(trainer, model, data_path, model_path, n_rigid, data):
    """Fixes the learned edges, writes them beside the model, and says what they are."""
    config = model.simulator.config
    edges = trainer.gates.edge_list(config, data_path)
    trainer.fix_edges(edges.mask)
    edge_lists.write(os.path.join(model_path, edge_lists.FILE_NAME), edges)
    checkpoints.save_config(model_path, model, n_rigid, data)
    text = f'step {config.gate_steps}: {edges.n_edge} of {edges.mask.size} mode edges stay'
    return text + (f'; the graph is {edges.degenerate}' if edges.degenerate else '')


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


def refuse_contradictions(model_path, config, overrides):
    """Raises ValueError if an override {field: value} is not what the model's config says."""
    for field, value in overrides.items():
        if value != getattr(config, field):
            raise ValueError(
                f'--{field}={value} contradicts the model in {model_path}, which has '
                f'{getattr(config, field)!r}: leave the flag out'
            )


def check_dataset(model_path, model, data_path, metadata):
    """Refuses a dataset that a model does not fit.

    Raises:
      ValueError: other modes, another subspace, or a force or context that one of them lacks.
    """
    scene = model.simulator.scene
    found, first = metadata['mode_number'], model.simulator.config.modes
    if found < scene.n_modes or not first and found != scene.n_modes:
        raise ValueError(
            f'{data_path} has {found} modes, the model in {model_path} was trained on '
            f'{"the first " if first else ""}{scene.n_modes}'
        )
    digests = (
        checkpoints.read_config(model_path)['data'].get('subspace'),
        _subspace_digest(metadata),
    )
    if None not in digests and digests[0] != digests[1]:
        raise ValueError(
            f'{data_path} is in the subspace {digests[1][:12]}..., the model in {model_path} was '
            f'trained on the modes of {digests[0][:12]}...: convert the runs with --like, or train '
            f'again'
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


def load_for_evaluation(model_path, data_path, split, overrides):
    """The model, its dataset's metadata and the runs of the split.

    Raises:
      FileNotFoundError: no model, dataset or split there.
      ValueError: an override contradicts the model, or the dataset does not fit it.
    """
    model = checkpoints.load_model(model_path)
    config = model.simulator.config
    refuse_contradictions(model_path, config, overrides)
    metadata = dataset.read_metadata(data_path)
    check_dataset(model_path, model, data_path, metadata)
    groups = reading_utils.read_groups(data_path, split, metadata, **config.nodes)
    for group in groups:
        model.layout(group.n_rigid)
    return model, metadata, groups
