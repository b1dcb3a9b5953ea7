"""One NRI training on disk: train, resume, keep the best, say how it went.

A step is a function of (weights, optimiser, seed, step): a training that was killed and resumed
gives the same weights as one that was not, on a CPU.
"""

import collections
import os
import time

import numpy as np
import tensorflow as tf
import tqdm

from learning_to_simulate import checkpoints
from learning_to_simulate.checkpoints import CONFIG_FILE, WEIGHTS_FILE
from nri import data as nri_data
from nri import losses
from nri.config import NriConfig
from nri.data import NriData
from nri.model import NriModel
from pca_tools import files
from pca_tools.storage import folder_lock

HISTORY_FILE, METRICS_FILE = 'history.json', 'metrics.json'
# Independent random streams of one (seed, step).
_TRAIN_STREAM, _VALID_STREAM = 1, 2


class LateDecay(tf.keras.optimizers.schedules.LearningRateSchedule):
    """Constant, then x `decay` every `decay_epochs` from epoch `decay_start` on."""

    def __init__(self, config, steps_per_epoch):
        self._config, self._steps_per_epoch = config, steps_per_epoch

    def __call__(self, step):
        c = self._config
        epoch = tf.cast(step, tf.float32) / self._steps_per_epoch
        count = tf.floor((epoch - c.decay_start) / c.decay_epochs) + 1.0
        return c.learning_rate * c.decay ** tf.maximum(count, 0.0)

    def get_config(self):
        """Keras asks for it; the config is stored beside the checkpoint instead."""
        return {}


class Trainer:
    """Data held in memory, optimiser and the compiled step. Every window of every run is a sample;
    an epoch is all of them once, in random order. ValueError: supervised training without edges, or
    modes for central forces."""

    def __init__(self, model: NriModel, train: NriData):
        self.model, self.config = model, model.config
        if self.config.supervised and train.edges is None:
            raise ValueError(f'{train.source}: has no true edges, so training cannot be supervised')
        if self.config.central and not train.same_scale:
            raise ValueError(f'{train.source}: modes have no directions; leave out --central')
        n_run, n_node, n_frame, n_feature = train.features.shape
        self._n_start = n_frame - self.config.span + 1
        self.n_sample = n_run * self._n_start
        self.batch_size = min(self.config.batch_size, self.n_sample)
        self.steps_per_epoch = self.n_sample // self.batch_size
        self.learning_rate = LateDecay(self.config, self.steps_per_epoch)
        self.optimizer = tf.keras.optimizers.Adam(self.learning_rate, global_clipnorm=1.0)
        trained = model.encode if self.config.supervised else model
        variables = list(trained.trainable_variables)
        self.optimizer.build(variables)
        by_time = train.features.transpose(0, 2, 1, 3)
        self._frames = tf.constant(by_time.reshape(n_run * n_frame, n_node, n_feature))
        self._n_frame = n_frame
        self._edges = None if train.edges is None else tf.constant(train.edges)
        self._order: tuple = (-1, None)
        self._step = self._compile(variables)
        self._validation_losses = tf.function(model.losses, jit_compile=True, autograph=False)

    def step(self, step: int) -> dict[str, tf.Tensor]:
        """Runs training step `step`, counted from 0, and returns its scalar losses."""
        epoch, place = divmod(step, self.steps_per_epoch)
        if self._order[0] != epoch:
            seed = np.random.SeedSequence([self.config.seed, epoch])
            order = np.random.Generator(np.random.Philox(seed)).permutation(self.n_sample)
            self._order = (epoch, order.astype(np.int32))
        first = place * self.batch_size
        samples = self._order[1][first : first + self.batch_size]
        return self._step(tf.constant(samples), tf.constant(step, tf.int32))

    def _compile(self, variables):
        config, model = self.config, self.model
        offsets = tf.range(config.window) * config.stride

        @tf.function(jit_compile=True, autograph=False)
        def train_step(samples, step):
            run, start = samples // self._n_start, samples % self._n_start
            frames = tf.gather(self._frames, (run * self._n_frame + start)[:, None] + offsets)
            features = tf.transpose(frames, [0, 2, 1, 3])
            edges = None if self._edges is None else tf.gather(self._edges, run)
            with tf.GradientTape() as tape:
                values = model.losses(
                    features, tf.stack([config.seed * 8 + _TRAIN_STREAM, step]), edges, True
                )
            gradients = tape.gradient(values['loss'], variables)
            self.optimizer.apply_gradients(zip(gradients, variables, strict=True))
            return values

        return train_step

    def evaluate(self, data: NriData) -> dict:
        """Losses, edge usage and, where the truth is known, edge accuracy on the first window.

        The same losses with the same prior as in training; edges are sampled with a fixed seed.
        Returns 'loss' ..., 'usage', 'entropy', 'status' of `losses.edge_usage`, and 'accuracy',
        'naming' of `losses.edge_accuracy`."""
        config = self.config
        windows = data.features[:, :, : config.span : config.stride]
        totals: dict[str, float] = collections.defaultdict(float)
        for first in range(0, len(windows), self.model.chunk):
            batch = tf.constant(windows[first : first + self.model.chunk])
            edges = None if data.edges is None else data.edges[first : first + self.model.chunk]
            seed = tf.constant([config.seed * 8 + _VALID_STREAM, first], tf.int32)
            for name, value in self._validation_losses(batch, seed, edges).items():
                totals[name] += float(value) * len(batch)
        result: dict = {name: total / len(windows) for name, total in totals.items()}
        probabilities = self.model.window_probabilities(windows)
        result |= losses.edge_usage(probabilities)
        if data.edges is not None:
            result['accuracy'], result['naming'] = losses.edge_accuracy(
                probabilities.argmax(axis=-1), data.edges, config.edge_types
            )
        return result


def train(data_path: str, model_path: str, config: NriConfig) -> dict:
    """Trains on a folder of `data.load` to the last epoch, or resumes; the weights of the best
    validation loss are kept.

    A model folder holds config.json, weights.npz (best), history.json (a row per epoch),
    metrics.json (of the kept weights on the test split; returned), ckpt-* and TensorBoard events.
    ValueError: bad data, another model in `model_path`, a loss that is not finite."""
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
    total = config.epochs * trainer.steps_per_epoch
    with (
        tf.summary.create_file_writer(model_path).as_default(),
        tqdm.tqdm(total=total, initial=int(step), unit='step', disable=None, smoothing=0.05) as bar,
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
    fresh = model.to_json()
    if not checkpoints.holds_model(path, {'config': fresh['config']}):
        files.write_json(os.path.join(path, CONFIG_FILE), fresh)
        return
    stored = checkpoints.read_config(path)
    if other := [key for key in fresh if stored.get(key) != fresh[key]]:
        raise ValueError(
            f'{path}: holds a model of another {", ".join(other)}; nothing was written, give '
            f'another --model_path'
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
