"""Whole training steps against a numpy twin: each of seven mistakes that a training survives, and
that make its model worse without a word, is found here.

Position noise left out; a clean velocity under the target of order 2; gradients stopped between
unrolled frames; equal weights of all forces; gradients that are not clipped; weights that are not
averaged; noise on the body whose motion is given.
"""

import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate import training
from tests.learning_to_simulate import models
from tests.learning_to_simulate.training_twin import TrainingTwin

SMALL = {
    'latent_size': 4, 'hidden_layers': 1, 'batch_size': 3, 'unroll_batch_size': 2, 'mode_edges': 4,
    'unroll_length': 3, 'noise_std': 0.5, 'unroll_noise': 0.5, 'weight_average': 0.9,
}  # fmt: skip
SECOND_ORDER = {'mode_order': 2, 'rigid_order': 2, 'rate_scaled': False, 'velocity_inputs': 2}
CASES = {
    'single step': {'num_steps': 5},
    'single step, second order': {'num_steps': 5} | SECOND_ORDER,
    'unrolled': {'num_steps': 0},
    'unrolled, second order': {'num_steps': 0} | SECOND_ORDER,
}


@pytest.fixture(params=CASES, scope='module')
def step(request, tmp_path_factory):
    """Twin, the loss of the package and its trainer after one step; eagerly, without a
    compilation."""
    overrides = SMALL | CASES[request.param] | {'unroll_steps': 3}
    model, groups, _ = models.make(tmp_path_factory.mktemp('data'), overrides=overrides, n_run=3)
    rng = np.random.default_rng(1)
    for variable in model.simulator.trainable_variables:  # no zero hides a mistake
        variable.assign(variable + rng.normal(0, 0.2, variable.shape))
    twin = TrainingTwin(model, groups[0])
    trainer = training.Trainer(model, groups)
    tf.config.run_functions_eagerly(True)
    try:
        loss = float(trainer.step(0)['loss'])
    finally:
        tf.config.run_functions_eagerly(False)
    unrolled = not overrides['num_steps']
    expected = twin.unrolled_loss if unrolled else twin.single_loss
    rate = model.simulator.config.unroll_learning_rate if unrolled else 1e-3
    return twin, expected, rate, trainer, loss


def flat(variables):
    return np.concatenate([v.numpy().ravel() for v in variables]).astype(float)


def test_loss_gradient_weights_and_averages_are_those_of_the_twin(step):
    twin, expected, rate, trainer, loss = step
    # float32 features of scores whose steps are a thousandth of them; measured 2e-6.
    assert loss == pytest.approx(expected(twin.named(twin.weights), 0), rel=1e-4)
    gradient = twin.gradient(expected, 0)
    norm = np.linalg.norm(gradient)
    assert norm > 1.5, 'the test of the clipping needs a gradient that is clipped'
    # Adam's first moment is a tenth of the gradient that the optimiser was given.
    given = 10 * flat(trainer.optimizer._momentums)
    np.testing.assert_allclose(given, gradient / norm, atol=2e-4)
    assert np.linalg.norm(given) == pytest.approx(1.0, rel=1e-4)
    weights, averages = twin.after_first_step(gradient, rate)
    # Where a gradient is round-off, Adam makes a step of a full rate of it: those are left out.
    clear = np.abs(gradient) / norm > 1e-3
    assert clear.mean() > 0.3
    for found, wanted in (
        (flat(trainer.simulator.trainable_variables), weights),
        (flat(trainer.averaging.variables), averages),
    ):
        np.testing.assert_allclose(found[clear], wanted[clear], atol=rate * 1e-2)


def test_noise_moves_positions_as_far_as_velocities_and_never_the_body(step):
    """The walk itself, with the sizes that the numbers of the config mean."""
    twin, *_ = step
    noise = twin.noise(0, 4000, 1.0)
    assert not noise[:, :, : twin.n].any()
    std = noise[:, -1, twin.n :].std(axis=0)
    np.testing.assert_allclose(std, 0.5 * twin.s.velocity_std[1:], rtol=0.1)
