"""Errors against decoded particles and plain loops."""

import numpy as np

from learning_to_simulate import metrics


def test_soil_error_equals_the_error_of_the_particles():
    rng = np.random.default_rng(0)
    basis, _ = np.linalg.qr(rng.normal(size=(40, 3)))
    truth, position = rng.normal(size=(2, 2, 7, 5, 3))
    decoded = [np.einsum('nk,stkd->stnd', basis, x[:, :, 2:]) for x in (truth, position)]
    expected = ((decoded[0] - decoded[1]) ** 2).mean(axis=(1, 2, 3))
    got = metrics.soil_mse(position, truth, 2, len(basis))
    np.testing.assert_allclose(got, expected, rtol=1e-12)


def test_trivial_predictors():
    history = np.zeros((1, 6, 1, 3))
    history[0, :, 0, 0] = [0, 0, 0, 0, 1, 3]
    assert metrics.stay_still(history, 4)[0, :, 0, 0].tolist() == [3, 3, 3, 3]
    assert metrics.constant_velocity(history, 4)[0, :, 0, 0].tolist() == [5, 7, 9, 11]


def test_force_errors_of_a_scaled_force():
    """F̂ = 1.1 F: 10 % in L2, in the mean percentage error and at the peak, whatever F is."""
    truth = np.random.default_rng(2).normal(size=(3, 20, 3)) + 5
    errors = metrics.force_errors(1.1 * truth, truth)
    np.testing.assert_allclose(errors['force_relative_l2'], 0.1, rtol=1e-9)
    np.testing.assert_allclose(errors['force_mpe'], 10.0, rtol=1e-9)
    np.testing.assert_allclose(errors['force_rmse'], 0.1 * np.sqrt((truth**2).mean(axis=(1, 2))))
    peak = [max(np.sqrt(row @ row) for row in run) for run in truth]
    np.testing.assert_allclose(errors['force_peak'], peak)
    np.testing.assert_allclose(errors['force_peak_error'], 0.1 * np.array(peak))


def test_zero_force_gives_no_number_instead_of_a_crash():
    zero = np.zeros((1, 5, 3))
    assert not np.isfinite(metrics.force_errors(zero + 1, zero)['force_relative_l2']).any()
    weak = metrics.force_errors(zero + 1, zero + 0.1, least=5.0)  # it counts as 5 N
    np.testing.assert_allclose(weak['force_relative_l2'], 0.9 * np.sqrt(3) / 5)
    strong = metrics.force_errors(zero + 8, zero + 4, least=5.0)
    np.testing.assert_allclose(strong['force_relative_l2'], 1.0)


def test_axes_are_those_of_the_way_and_loads_have_errors_of_each():
    """A wheel that moves along z with y up, two bodies: what errs on one axis errs there alone."""
    body = np.zeros((8, 4, 3))
    body[:, :, 2] = np.linspace(0, -0.4, 8)[:, None]
    body[:, :, 0] = 0.01 * np.sin(np.arange(8))[:, None]
    body[:, :, 1] = np.linspace(0, 1, 8)[:, None]  # the height is no way
    axes = metrics.travel_axes(body, 1)
    assert axes == (2, 1, 0) and metrics.travel_axes(body[:, :0], 1) == (0, 1, 2)
    truth = np.ones((1, 8, 6)) * [1.0, 50.0, 4.0, 2.0, 60.0, 3.0]
    force = truth + [0, 0, 3, 0, 0, 4]
    torque, true_torque = np.ones((2, 1, 8, 3)) * np.array([[[1.5, 9, 9]], [[1, 0, 0]]])[:, None]
    errors = metrics.load_errors(force, truth, axes, torque, true_torque)
    np.testing.assert_allclose(errors['drawbar_rmse'], np.sqrt((9 + 16) / 2))
    np.testing.assert_allclose(errors['drawbar_relative_l2'], 1.0)
    np.testing.assert_allclose(errors['drawbar_peak_error'], np.hypot(7, 7) - 5)
    assert errors['vertical_rmse'] == 0.0 and errors['force_relative_l2'] < 0.1
    np.testing.assert_allclose(errors['pitch_relative_l2'], 0.5)
    assert errors['torque_relative_l2'] > 9
