"""Trains and evaluates a simulator of soil modes.

Examples:
  # train the default model on a dataset folder, resume by giving the same command again
  python -m learning_to_simulate.train --data_path=datasets/excavation --model_path=/tmp/pcg

  # roll out the test split: rollout_test_*.npz and metrics.json
  python -m learning_to_simulate.train --mode=eval_rollout --eval_split=test \\
      --data_path=datasets/excavation --model_path=/tmp/pcg --output_path=/tmp/pcg/rollouts

  # one-step errors on the validation split
  python -m learning_to_simulate.train --mode=eval --eval_split=valid \\
      --data_path=... --model_path=...

  # published baselines, a loaded edge list, the authors' wheel with its measured motion
  python -m learning_to_simulate.train --preset=fcg_original --data_path=... --model_path=...
  python -m learning_to_simulate.train --adjacency=edges.json --data_path=... --model_path=...
  python -m learning_to_simulate.train --rigid_motion=driven --data_path=Wheel_PCA --model_path=...

Model flags that are not given take the preset's value; in the other modes they are read from the
model and a flag that contradicts them is refused.
"""

import dataclasses
import os
import sys
import time

import numpy as np
import tensorflow as tf
import tqdm
from absl import app, flags, logging

from learning_to_simulate import (
    checkpoints,
    connectivity_utils,
    evaluation,
    normalization,
    presets,
    reading_utils,
)
from learning_to_simulate.learned_simulator import LearnedSimulator
from learning_to_simulate.training import Trainer
from pca_tools import dataset, files

_MODE = flags.DEFINE_enum(
    'mode', 'train', ['train', 'eval', 'eval_rollout'], 'Train, or evaluate a trained model.'
)
_EVAL_SPLIT = flags.DEFINE_enum(
    'eval_split', 'test', ['train', 'valid', 'test'], 'Split to evaluate on.'
)
_DATA_PATH = flags.DEFINE_string(
    'data_path', None, 'Dataset folder (metadata.json, *.tfrecord).', required=True
)
_MODEL_PATH = flags.DEFINE_string(
    'model_path', None, 'Model folder; training resumes from it.', required=True
)
_OUTPUT_PATH = flags.DEFINE_string(
    'output_path', None, 'Folder for rollouts and metrics.json (eval_rollout).'
)
_PRESET = flags.DEFINE_string('preset', 'pcg', f'One of {", ".join(presets.PRESETS)}.')
_ADJACENCY = flags.DEFINE_string(
    'adjacency', None, 'edges.json, mask.npy, fully_connected or algorithm2.'
)
_RIGID_MOTION = flags.DEFINE_string(
    'rigid_motion',
    None,
    "Overrides the scene's: prescribed, driven (height predicted) or predicted.",
)
_RIGID_CORRECTION = flags.DEFINE_bool(
    'rigid_correction', True, 'Keep predicted bodies rigid in rollouts.'
)
_SAVE_EVERY = flags.DEFINE_integer(
    'save_every', None, 'Steps between checkpoints; default: a tenth of all steps.', 1
)
_NUM_THREADS = flags.DEFINE_integer(
    'num_threads', None, 'CPU threads of TensorFlow; default: its own choice.', 1
)

# Flags that override single fields of the preset's config; DeepMind's spelling where it has one.
_FIELD_FLAGS = {'mssg': 'message_passing_steps'}
for _field in dataclasses.fields(presets.TrainConfig):
    if _field.name in ('preset', 'adjacency', 'message_passing_steps'):
        continue
    _define = {int: flags.DEFINE_integer, float: flags.DEFINE_float, bool: flags.DEFINE_bool}[
        _field.type
    ]
    _define(_field.name, None, f"Overrides the preset's {_field.name}; see TrainConfig.")
    _FIELD_FLAGS[_field.name] = _field.name
flags.DEFINE_integer('mssg', None, "Message-passing steps M; overrides the preset's.")


def _overrides() -> dict:
    """Config fields that the command line gives."""
    given = {field: flags.FLAGS[flag].value for flag, field in _FIELD_FLAGS.items()}
    given['adjacency'] = _ADJACENCY.value
    return {k: v for k, v in given.items() if v is not None}


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
    mean = summary['mean']['model']
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


def _evaluate_one_step(overrides):
    model, _, groups = load_for_evaluation(
        _MODEL_PATH.value, _DATA_PATH.value, _EVAL_SPLIT.value, overrides
    )
    print(f'one-step errors on {_EVAL_SPLIT.value} of {_DATA_PATH.value}')
    for name, value in Trainer(model, groups).one_step_errors().items():
        print(f'  {name:24s} {value:.6g}')


def _evaluate_rollouts(overrides):
    if not _OUTPUT_PATH.value:
        raise ValueError('--mode=eval_rollout needs --output_path')
    split = _EVAL_SPLIT.value
    model, metadata, groups = load_for_evaluation(
        _MODEL_PATH.value, _DATA_PATH.value, split, overrides
    )
    evaluator = evaluation.Evaluator(model, metadata, _RIGID_CORRECTION.value)
    results, summary = evaluator.run(
        groups, split, lambda runs: tqdm.tqdm(runs, unit='run', disable=None)
    )
    written = evaluation.save_rollouts(_OUTPUT_PATH.value, split, results, summary, metadata)
    print(evaluation.table(summary))
    print(f'wrote {len(written)} files to {_OUTPUT_PATH.value}')


def main(_):
    """Runs the chosen mode; bad input ends with its message and exit code 2."""
    if _NUM_THREADS.value:
        tf.config.threading.set_intra_op_parallelism_threads(_NUM_THREADS.value)
        tf.config.threading.set_inter_op_parallelism_threads(1)
    overrides = _overrides()
    try:
        if _MODE.value == 'train':
            config = presets.make_config(_PRESET.value, **overrides)
            train(
                _DATA_PATH.value, _MODEL_PATH.value, config, _RIGID_MOTION.value, _SAVE_EVERY.value
            )
        elif _MODE.value == 'eval':
            _evaluate_one_step(overrides)
        else:
            _evaluate_rollouts(overrides)
    except (ValueError, FileNotFoundError) as error:
        logging.debug('stack', exc_info=True)
        sys.exit(f'error: {error}')


if __name__ == '__main__':
    app.run(main)
