"""Whole training steps against a numpy twin.

The comparison was tried against mistakes that a training survives without a word, and finds each:
no noise of the positions; the base of an order-2 target without its noise; noise on the given body;
gradients stopped between frames; equal weights of the forces; no clipping; no averaging.
"""

import numpy as np
import pytest

from learning_to_simulate.subspace.trainer import Trainer
from learning_to_simulate.training.schedule import UNROLLED_RATE
from tests.learning_to_simulate import models
from tests.learning_to_simulate.twins.training_twin import TrainingTwin

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
}


def make(folder, overrides):
    """A small model whose weights no zero hides a mistake in, and its runs."""
    model, groups, _ = models.make(folder, overrides=SMALL | overrides, n_run=3)
    rng = np.random.default_rng(1)
    for variable in model.simulator.trainable_variables:
        variable.assign(variable + rng.normal(0, 0.2, variable.shape))
    return model, groups


def flat(variables):
    return np.concatenate([v.numpy().ravel() for v in variables]).astype(float)


@pytest.mark.parametrize('overrides', CASES.values(), ids=CASES)
def test_training_step_is_that_of_the_twin(tmp_path, overrides):
    """Loss, gradient, weights and their averages after the first step of a training."""
    model, groups = make(tmp_path, overrides)
    twin, config = TrainingTwin(model, groups[0]), model.simulator.config
    loss, rate = twin.single_loss, config.learning_rate
    if not config.single_steps:
        loss, rate = twin.unrolled_loss, UNROLLED_RATE
    expected_loss, gradient = loss(0), twin.gradient(loss, 0)
    trainer = Trainer(model, groups)
    with models.eagerly():
        found_loss = float(trainer.step(0)['loss'])
    # float32 features of scores whose steps are a thousandth of them.
    assert found_loss == pytest.approx(expected_loss, rel=1e-4)
    norm = np.linalg.norm(gradient)
    assert norm > 1.5, 'the test of the clipping needs a gradient that is clipped'
    # Adam's first moment is a tenth of the gradient that the optimiser was given.
    given = 10 * flat(trainer.optimizer._momentums)
    length = np.linalg.norm(given)
    np.testing.assert_allclose(given / length, gradient / norm, atol=5e-4)
    # Clipped to 1; TensorFlow takes the norm before it adds up the rows that one embedding has
    # from several particles: measured 0.2 % off.
    assert length == pytest.approx(1.0, rel=1e-2)
    weights, averages = twin.after_first_step(gradient, rate)
    # Where a gradient is round-off, Adam makes a step of a full rate of it: those are left out.
    clear = np.abs(gradient) / norm > 1e-2
    assert clear.sum() > 20
    for found, wanted in (
        (flat(trainer.simulator.trainable_variables), weights),
        (flat(trainer.averaging.variables), averages),
    ):
        np.testing.assert_allclose(found[clear], wanted[clear], atol=rate * 2e-2)
