"""Optimiser, learning rate and averages of the weights over the steps of a training."""

import contextlib

import numpy as np
import tensorflow as tf

from learning_to_simulate import command
from learning_to_simulate.config import TrainConfig

command.import_keras()

UNROLLED_RATE = 3e-4  # the unrolled stage starts from it


class TwoStageSchedule(tf.keras.optimizers.schedules.LearningRateSchedule):
    """Exponential decay by 0.1 per `decay_steps` to the floor (SG 2020); the unrolled stage starts
    again from `UNROLLED_RATE` and decays to the floor by a cosine."""

    def __init__(self, config: TrainConfig):
        self._config = config

    def __call__(self, step):
        c = self._config
        step = tf.cast(step, tf.float32)
        # First stage: floor + (rate - floor) 0.1^(step / decay_steps).
        single = (c.learning_rate - c.learning_rate_floor) * 0.1 ** (
            step / c.decay_steps
        ) + c.learning_rate_floor
        # Second: floor + (UNROLLED_RATE - floor) (1 + cos(pi progress)) / 2.
        first = c.single_steps
        progress = tf.clip_by_value((step - first) / max(c.num_steps - first, 1), 0.0, 1.0)
        unrolled = c.learning_rate_floor + (UNROLLED_RATE - c.learning_rate_floor) * 0.5 * (
            1.0 + tf.cos(np.pi * progress)
        )
        return tf.where(step < first, single, unrolled)


class WeightAverages:
    """Moving averages of the trained variables, which are what is evaluated and saved; a decay of 0
    is for none."""

    def __init__(self, variables, decay: float):
        self._trained, self._decay = variables, decay
        self.variables = [tf.Variable(v, name='average') for v in variables]

    def update(self, step) -> None:
        """Takes in the weights after training step `step` (counted from 0)."""
        count = tf.cast(step, tf.float32)
        keep = tf.minimum(self._decay, (1.0 + count) / (10.0 + count))  # forgets the start sooner
        for average, variable in zip(self.variables, self._trained, strict=True):
            average.assign_sub((1.0 - keep) * (average - variable))

    @contextlib.contextmanager
    def in_place(self):
        """Puts the averages in place of the weights, and the trained ones back after."""
        if not self._decay:
            yield
            return
        trained = [v.numpy() for v in self._trained]
        for variable, average in zip(self._trained, self.variables, strict=True):
            variable.assign(average)
        try:
            yield
        finally:
            for variable, value in zip(self._trained, trained, strict=True):
                variable.assign(value)


def check_window(groups, frames: int) -> None:
    """Raises ValueError if a run of a list of `RunGroup` is shorter than a training window."""
    shortest = min(group.position.shape[1] for group in groups)
    if shortest < frames:
        raise ValueError(
            f'runs of {shortest} frames are shorter than the training window of {frames} frames'
        )


class GradientTraining:
    """What the trainers of all networks share, of a simulator whose variables exist, with its
    config; `clip_norm` is the largest norm of the gradient of all weights, or None, `gates` are
    `EdgeGates` while the edges are learned."""

    gates = None

    def __init__(self, simulator, clip_norm: float | None):
        self.simulator, self.config = simulator, simulator.config
        variables = simulator.trainable_variables
        self.learning_rate = TwoStageSchedule(self.config)
        self.optimizer = tf.keras.optimizers.Adam(self.learning_rate, global_clipnorm=clip_norm)
        self.optimizer.build(variables)
        self.averaging = WeightAverages(variables, self.config.weight_average)

    def apply(self, gradients, step) -> None:
        """Changes the variables by the gradients of training step `step`, and their averages."""
        variables = self.simulator.trainable_variables
        self.optimizer.apply_gradients(zip(gradients, variables, strict=True))
        self.averaging.update(step)

    def generator(self, stream: int, step: int) -> np.random.Generator:
        """Random numbers of a (seed, stream, step)."""
        counter = [0, 0, stream, step]
        return np.random.Generator(np.random.Philox(key=self.config.seed, counter=counter))


def mean_of(rows) -> dict[str, float]:
    """Mean of each value over dicts of scalars."""
    return {k: float(np.mean([float(row[k]) for row in rows])) for k in rows[0]}
