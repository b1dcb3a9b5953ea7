"""One NRI training on disk: train, resume, keep the best, say how it went."""

import dataclasses
import os
import time

import numpy as np
import tensorflow as tf
import tqdm

from nri import data as nri_data
from nri.config import NriConfig
from nri.model import CONFIG_FILE, WEIGHTS_FILE, NriModel
from nri.training import Trainer
from pca_tools import files
from pca_tools.storage import folder_lock

HISTORY_FILE, METRICS_FILE = 'history.json', 'metrics.json'


def train(data_path: str, model_path: str, config: NriConfig) -> dict:
    """Trains to the last epoch, or resumes; the weights of the best validation loss are kept.

    Args:
      data_path: folder for `data.load`.
      model_path: folder of the model: config.json, weights.npz (best), history.json (a row per
        epoch), metrics.json (of the kept weights on the test split), ckpt-* and TensorBoard events.
      config: the settings.

    Returns:
      what metrics.json holds.

    Raises:
      ValueError: bad data, another model in `model_path`, a loss that is not finite.
    """
    splits = {
        split: nri_data.load(data_path, split, config.nodes, config.modes)
        for split in ('train', 'valid', 'test')
    }
    offset, scale = nri_data.normalization(splits['train'])
    model = NriModel(config, splits['train'].node_names, offset, scale, splits['train'].digest)
    for data in splits.values():  # the others are first measured after an epoch and at the end
        try:
            model.check_features(data.features)
        except ValueError as error:
            raise ValueError(f'{data.source}: {error}') from error
    trainer = Trainer(model, splits['train'])
    with folder_lock.locked(model_path):
        _open_folder(model_path, model)
        history = _run(trainer, splits['valid'], model_path)
        return _summary(model_path, trainer, splits['test'], history)


def _run(trainer, valid, model_path):
    """Trains from the newest checkpoint on; returns the history."""
    model, config = trainer.model, trainer.config
    step = tf.Variable(0, dtype=tf.int64)
    checkpoint = tf.train.Checkpoint(model=model, optimizer=trainer.optimizer, step=step)
    manager = tf.train.CheckpointManager(checkpoint, model_path, max_to_keep=2)
    history = []
    if manager.latest_checkpoint:
        checkpoint.restore(manager.latest_checkpoint).assert_consumed()
        done = int(step) // trainer.steps_per_epoch
        history = files.read_json(os.path.join(model_path, HISTORY_FILE))[:done]
        print(f'resumed {model_path} after epoch {done}')
    n_weight = sum(int(np.prod(v.shape)) for v in model.trainable_variables)
    print(
        f'{model_path}: {trainer.n_sample} windows of {len(model.node_names)} nodes, {n_weight} '
        f'weights, {config.epochs} epochs of {trainer.steps_per_epoch} steps'
    )
    shown = {'unit': 'step', 'disable': None, 'smoothing': 0.05}
    with (
        tf.summary.create_file_writer(model_path).as_default(),
        tqdm.tqdm(total=trainer.total_steps, initial=int(step), **shown) as bar,
    ):
        while len(history) < config.epochs:
            row = _epoch(trainer, valid, history, bar)
            is_best = row['loss'] <= min((r['loss'] for r in history), default=np.inf)
            history.append(row)
            if is_best:
                model.save(model_path)
            files.write_json(os.path.join(model_path, HISTORY_FILE), history)
            step.assign(len(history) * trainer.steps_per_epoch)
            manager.save(checkpoint_number=len(history))
            _log(row, bar)
    return history


def _open_folder(path, model):
    """Claims a model folder; refuses one with something else in it."""
    name = os.path.join(path, CONFIG_FILE)
    if not os.path.exists(name):
        if strangers := set(os.listdir(path)) - {folder_lock.LOCK_NAME}:
            raise ValueError(
                f'{path}: not empty and no model folder (holds {sorted(strangers)[:3]}); nothing '
                f'was written'
            )
        files.write_json(name, model.to_json())
        return
    old, new = files.read_json(name), model.to_json()
    if old.get('kind') != 'nri':
        raise ValueError(f'{name}: not the config of an NRI model; nothing was written')
    # A setting that came later had its default before.
    defaults = dataclasses.asdict(NriConfig())
    flat = [{**defaults, **v.pop('config', {}), **v} for v in (old, new)]
    both = {k: tuple(f.get(k) for f in flat) for k in sorted(flat[0] | flat[1])}
    if differing := {k: pair for k, pair in both.items() if pair[0] != pair[1]}:
        listed = ', '.join(
            f'{k}: {str(there)[:40]} there, {str(now)[:40]} now'
            for k, (there, now) in differing.items()
        )
        raise ValueError(
            f'{path}: holds another model ({listed}); nothing was written, give another '
            f'--model_path'
        )
    if not tf.train.latest_checkpoint(path) and os.path.exists(os.path.join(path, WEIGHTS_FILE)):
        raise ValueError(
            f'{path}: holds weights without training state, so training cannot resume; give '
            f'another --model_path'
        )


def _epoch(trainer, valid, history, bar):
    """Trains one epoch and evaluates; returns the row of the history."""
    started = time.perf_counter()
    first = len(history) * trainer.steps_per_epoch
    values = []
    for i in range(first, first + trainer.steps_per_epoch):
        values.append(trainer.step(i))
        bar.update()
        if (i + 1) % 50 == 0:
            bar.set_postfix({k: f'{float(v):.3g}' for k, v in values[-1].items()})
    train_loss = float(np.mean([float(v['loss']) for v in values]))
    epoch_seconds = time.perf_counter() - started
    if not np.isfinite(train_loss):
        raise ValueError(
            f'loss is {train_loss} in epoch {len(history) + 1}; the last good checkpoint stays'
        )
    measured = trainer.evaluate(valid)
    before = history[-1]['seconds'] if history else 0.0
    return {
        'epoch': len(history) + 1,
        'seconds': before + time.perf_counter() - started,
        'epoch_seconds': epoch_seconds,
        'learning_rate': float(trainer.learning_rate(first)),
        'train_loss': train_loss,
        **measured,
    }


def _log(row, bar):
    for name in ('train_loss', 'loss', 'nll', 'kl', 'entropy', 'accuracy', 'learning_rate'):
        if name in row:
            tf.summary.scalar(name, row[name], step=row['epoch'])
    text = f'epoch {row["epoch"]} ({row["seconds"]:.0f} s): loss {row["train_loss"]:.4g}, '
    text += f'valid {row["loss"]:.4g}, entropy {row["entropy"]:.3f}, edge types '
    text += '/'.join(f'{u:.1%}' for u in row['usage'])
    if 'accuracy' in row:
        text += f', accuracy {row["accuracy"]:.2%}'
    if row['status'] != 'OK':
        text += f'  {row["status"]}'
    bar.write(text)


def _summary(model_path, trainer, test, history):
    """Measures the kept weights on the test split, writes and prints the result."""
    best = min(history, key=lambda row: row['loss'])
    trainer.model.load_weights(model_path)
    measured = trainer.evaluate(test)
    result = {
        'epochs': len(history),
        'best_epoch': best['epoch'],
        'seconds': history[-1]['seconds'],
        'epoch_seconds': float(np.median([row['epoch_seconds'] for row in history])),
        'test': measured,
        'weights': trainer.model.digest,
    }
    files.write_json(os.path.join(model_path, METRICS_FILE), result)
    print(
        f'{model_path}: {len(history)} epochs, {result["epoch_seconds"]:.1f} s each; kept epoch '
        f'{best["epoch"]}; test loss {measured["loss"]:.4g}'
        + (f', edge accuracy {measured["accuracy"]:.2%}' if 'accuracy' in measured else '')
    )
    if measured['status'] != 'OK':
        print(
            f'{measured["status"]}: edge types are used by '
            + ', '.join(f'{u:.1%}' for u in measured['usage'])
            + ' of the pairs; the edges that were found mean nothing'
        )
    return result
