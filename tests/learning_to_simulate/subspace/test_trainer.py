"""Whole training steps against a numpy twin, and nine mistakes that a training survives without a
word: each is made here on purpose, and the comparison must find it.
"""

import functools

import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate.subspace import noise_utils
from learning_to_simulate.subspace.learned_simulator import (
    LearnedSimulator,
    SimulatorState,
    initial_state,
)
from learning_to_simulate.subspace.trainer import Trainer
from learning_to_simulate.training.schedule import UNROLLED_RATE
from tests.learning_to_simulate import models
from tests.learning_to_simulate.twins.training_twin import H, TrainingTwin

SMALL = {
    'latent_size': 4, 'hidden_layers': 1, 'batch_size': 3, 'unroll_batch_size': 2, 'mode_edges': 4,
    'unroll_length': 3, 'noise_std': 0.5, 'weight_average': 0.9,
    'unroll_steps': 3,
}  # fmt: skip
SECOND_ORDER = {'mode_order': 2, 'rigid_order': 2, 'rate_scaled': False, 'velocity_inputs': 2}
CASES = {
    'single step': {'num_steps': 5},
    'single step, second order': {'num_steps': 5} | SECOND_ORDER,
    'unrolled': {'num_steps': 3},
    'unrolled, second order': {'num_steps': 3} | SECOND_ORDER,
    'single step, torque': {'num_steps': 5, 'predict_torque': True},
    'unrolled, torque': {'num_steps': 3, 'predict_torque': True},
}


class Case:
    """A small model with its runs, and what the twin says of the first training step."""

    def __init__(self, folder, overrides):
        torque = 'predict_torque' in overrides
        self.model, self.groups, _ = models.make(
            folder, overrides=SMALL | overrides, n_run=3, torque=torque
        )
        rng = np.random.default_rng(1)
        self._variables = self.model.simulator.trainable_variables
        for variable in self._variables:  # no zero hides a mistake
            variable.assign(variable + rng.normal(0, 0.2, variable.shape))
        self._start = [v.numpy() for v in self._variables]
        self.twin = twin = TrainingTwin(self.model, self.groups[0])
        unrolled = not self.model.simulator.config.single_steps
        loss = twin.unrolled_loss if unrolled else twin.single_loss
        config = self.model.simulator.config
        self.rate = UNROLLED_RATE if unrolled else config.learning_rate
        self.loss = loss(0)
        self.gradient = twin.gradient(loss, 0)

    def step(self, mutate=None):
        """The package's first training step from the same weights, eagerly; returns the loss and
        the trainer."""
        for variable, value in zip(self._variables, self._start):
            variable.assign(value)
        trainer = Trainer(self.model, self.groups)
        if mutate:
            mutate(trainer)
        tf.config.run_functions_eagerly(True)
        try:
            return float(trainer.step(0)['loss']), trainer
        finally:
            tf.config.run_functions_eagerly(False)


@pytest.fixture(scope='module')
def case(tmp_path_factory):
    """Makes a `Case` of `CASES` by its name, once."""
    return functools.cache(lambda name: Case(tmp_path_factory.mktemp('data'), CASES[name]))


def flat(variables):
    return np.concatenate([v.numpy().ravel() for v in variables]).astype(float)


def compare(case, loss, trainer):
    """Loss, gradient, weights and their averages of the package against those of the twin."""
    # float32 features of scores whose steps are a thousandth of them.
    assert loss == pytest.approx(case.loss, rel=1e-4)
    norm = np.linalg.norm(case.gradient)
    assert norm > 1.5, 'the test of the clipping needs a gradient that is clipped'
    # Adam's first moment is a tenth of the gradient that the optimiser was given.
    given = 10 * flat(trainer.optimizer._momentums)
    length = np.linalg.norm(given)
    np.testing.assert_allclose(given / length, case.gradient / norm, atol=5e-4)
    # Clipped to 1; TensorFlow takes the norm before it adds up the rows that one embedding has
    # from several particles: measured 0.2 % off.
    assert length == pytest.approx(1.0, rel=1e-2)
    weights, averages = case.twin.after_first_step(case.gradient, case.rate)
    # Where a gradient is round-off, Adam makes a step of a full rate of it: those are left out.
    clear = np.abs(case.gradient) / norm > 1e-2
    assert clear.sum() > 20
    for found, wanted in (
        (flat(trainer.simulator.trainable_variables), weights),
        (flat(trainer.averaging.variables), averages),
    ):
        np.testing.assert_allclose(found[clear], wanted[clear], atol=case.rate * 2e-2)


@pytest.mark.parametrize('name', CASES)
def test_training_step_is_that_of_the_twin(case, name):
    compare(case(name), *case(name).step())


def _no_position_noise(patch, _):
    patch.setattr(noise_utils, 'position_noise', lambda noise: tf.zeros_like(noise[:, :, 0]))


def _clean_base_of_the_target(patch, _):
    """The velocity that an order-2 target is counted from, without its noise."""
    noisy, target, clean = Trainer._noisy_state, LearnedSimulator.normalized_target, []

    def remembering(self, offset, velocity, *others):
        clean.append(initial_state(offset[:, :H], velocity[:, 1:H]))
        return noisy(self, offset, velocity, *others)

    patch.setattr(Trainer, '_noisy_state', remembering)
    patch.setattr(
        LearnedSimulator,
        'normalized_target',
        lambda self, velocity, state, *others: target(self, velocity, clean[-1], *others),
    )


def _gradient_stopped_between_frames(patch, _):
    whole = LearnedSimulator.step

    def step(self, state, *others):
        return whole(self, SimulatorState(*(tf.stop_gradient(x) for x in state)), *others)

    patch.setattr(LearnedSimulator, 'step', step)


def _equal_force_weights(_, trainer):
    tensors = trainer._tensors[0]
    tensors.load_weights = [tf.ones_like(weight) for weight in tensors.load_weights]


def _force_weights_of_the_torque(_, trainer):
    tensors = trainer._tensors[0]
    tensors.load_weights = [tensors.load_weights[0]] * 2


def _no_torque_in_the_loss(_, trainer):
    tensors = trainer._tensors[0]
    tensors.load_weights[1] = tf.zeros_like(tensors.load_weights[1])


def _no_clipping(_, trainer):
    trainer.optimizer.global_clipnorm = None


def _no_averaging(patch, trainer):
    patch.setattr(trainer.averaging, 'update', lambda step: None)


def _noise_on_the_given_body(patch, trainer):
    layout = trainer._tensors[0].layout
    patch.setattr(layout, 'moving', np.ones_like(layout.moving))


@pytest.mark.parametrize(
    ('mistake', 'name'),
    [
        (_no_position_noise, 'single step, second order'),
        (_clean_base_of_the_target, 'single step, second order'),
        (_gradient_stopped_between_frames, 'unrolled, second order'),
        (_equal_force_weights, 'single step'),
        (_force_weights_of_the_torque, 'single step, torque'),
        (_no_torque_in_the_loss, 'unrolled, torque'),
        (_no_clipping, 'single step'),
        (_no_averaging, 'single step'),
        (_noise_on_the_given_body, 'single step'),
    ],
    ids=lambda value: value if isinstance(value, str) else value.__name__,
)
def test_mistake_is_found(case, monkeypatch, mistake, name):
    loss, trainer = case(name).step(functools.partial(mistake, monkeypatch))
    with pytest.raises(AssertionError, match='loss|clip|Not equal to tolerance|==') as found:
        compare(case(name), loss, trainer)
    assert 'needs a gradient' not in str(found.value)


def test_noise_is_as_large_as_the_config_says_and_never_on_the_body(case):
    """The walk itself: its last value has `noise_std` of each mode's own velocity."""
    twin = case('single step').twin
    noise = twin.noise(0, 2000)
    assert not noise[:, :, : twin.n].any()
    std = noise[:, -1, twin.n :].std(axis=0)
    np.testing.assert_allclose(std, 0.5 * twin.s.velocity_std[1:], rtol=0.1)
