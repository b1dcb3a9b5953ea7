"""`Trainer`: compiled steps over data held in memory.

A step is a function of (weights, optimiser, seed, step): a training that was killed and resumed
gives the same weights as one that was not, on a CPU.
"""

import numpy as np
import tensorflow as tf

from nri import losses
from nri.data import NriData
from nri.model import NriModel

# Independent random streams of one (seed, step).
_TRAIN_STREAM, _VALID_STREAM = 1, 2
_VALID_BATCH = 500


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
    """Holds data, optimiser and the compiled step.

    Every window of every run is a sample; an epoch is all of them once, in random order.

    Args:
      model: `NriModel`.
      train: training split; with edges if the model is supervised.

    Raises:
      ValueError: data that does not fit the model, or supervised training without edges.
    """

    def __init__(self, model: NriModel, train: NriData):
        self.model, self.config = model, model.config
        model.check_features(train.features)
        if self.config.supervised and train.edges is None:
            raise ValueError(f'{train.source}: has no true edges, so training cannot be supervised')
        n_run, n_node, n_frame, n_feature = train.features.shape
        self._n_start = n_frame - self.config.span + 1
        self.n_sample = n_run * self._n_start
        self.batch_size = min(self.config.batch_size, self.n_sample)
        self.steps_per_epoch = self.n_sample // self.batch_size
        self.learning_rate = LateDecay(self.config, self.steps_per_epoch)
        self.optimizer = tf.keras.optimizers.Adam(self.learning_rate, global_clipnorm=1.0)
        variables = list(model.trainable_variables)
        if self.config.supervised:
            variables = list(model.encode.trainable_variables)
        self.optimizer.build(variables)
        by_time = train.features.transpose(0, 2, 1, 3)
        self._frames = tf.constant(by_time.reshape(n_run * n_frame, n_node, n_feature))
        self._n_frame = n_frame
        self._edges = None if train.edges is None else tf.constant(train.edges)
        self._order: tuple = (-1, None)
        self._step = self._compile(variables)
        self._validation_losses = tf.function(model.losses, jit_compile=True, autograph=False)

    @property
    def total_steps(self) -> int:
        """Steps of all epochs."""
        return self.config.epochs * self.steps_per_epoch

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

        Args:
          data: a split.

        Returns:
          'loss' ..., 'usage', 'entropy', 'status' of `losses.edge_usage`, and 'accuracy', 'naming'
          of `losses.edge_accuracy`.
        """
        self.model.check_features(data.features)
        config = self.config
        windows = data.features[:, :, : config.span : config.stride]
        totals: dict[str, float] = {}
        count = 0
        if not (config.supervised and data.edges is None):
            for first in range(0, len(windows), _VALID_BATCH):
                batch = tf.constant(windows[first : first + _VALID_BATCH])
                edges = data.edges
                if edges is not None:
                    edges = tf.constant(edges[first : first + _VALID_BATCH])
                seed = tf.constant([config.seed * 8 + _VALID_STREAM, first], tf.int32)
                for name, value in self._validation_losses(batch, seed, edges).items():
                    totals[name] = totals.get(name, 0.0) + float(value) * len(batch)
                count += len(batch)
        result: dict = {name: total / count for name, total in totals.items()}
        probabilities = self.model.window_probabilities(windows)
        result |= losses.edge_usage(probabilities)
        if data.edges is not None:
            result['accuracy'], result['naming'] = losses.edge_accuracy(
                probabilities.argmax(axis=-1), data.edges, config.edge_types
            )
        return result
