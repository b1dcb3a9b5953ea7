"""Errors against decoded particles and plain loops."""

import numpy as np

from learning_to_simulate import metrics


def make(seed=0, n_soil=40, n_modes=3, n_rigid=2):
    rng = np.random.default_rng(seed)
    basis, _ = np.linalg.qr(rng.normal(size=(n_soil, n_modes)))
    truth, position = rng.normal(size=(2, 2, 7, n_rigid + n_modes, 3))
    return basis, truth, position, n_rigid


def test_soil_error_equals_the_error_of_the_particles():
    basis, truth, position, n_rigid = make()
    decoded = [np.einsum('nk,stkd->stnd', basis, x[:, :, n_rigid:]) for x in (truth, position)]
    expected = ((decoded[0] - decoded[1]) ** 2).mean(axis=(1, 2, 3))
    got = metrics.soil_mse(position, truth, n_rigid, len(basis))
    np.testing.assert_allclose(got, expected, rtol=1e-12)


def test_full_space_error_is_the_error_of_the_particles():
    """Truth with a part outside the subspace: prediction inside it, error of real particles."""
    basis, truth, position, n_rigid = make()
    rng = np.random.default_rng(1)
    outside = rng.normal(size=(*truth.shape[:2], len(basis), 3))
    outside -= np.einsum('nk,mk,stmd->stnd', basis, basis, outside)
    particles = np.einsum('nk,stkd->stnd', basis, truth[:, :, n_rigid:]) + outside
    predicted = np.einsum('nk,stkd->stnd', basis, position[:, :, n_rigid:])
    floor = (outside**2).mean(axis=(1, 2, 3))
    errors = metrics.run_errors(position, truth, None, None, n_rigid, len(basis), floor)
    np.testing.assert_allclose(
        errors['soil_mse_full'], ((particles - predicted) ** 2).mean(axis=(1, 2, 3)), rtol=1e-12
    )
    np.testing.assert_allclose(errors['soil_rms_mm_full'], 1e3 * errors['soil_mse_full'] ** 0.5)


def test_trivial_predictors():
    history = np.zeros((1, 6, 1, 3))
    history[0, :, 0, 0] = [0, 0, 0, 0, 1, 3]
    assert metrics.stay_still(history, 4)[0, :, 0, 0].tolist() == [3, 3, 3, 3]
    assert metrics.constant_velocity(history, 4)[0, :, 0, 0].tolist() == [5, 7, 9, 11]


def test_force_errors_of_a_scaled_force():
    """F̂ = 1.1 F: 10 % in L2 and in the mean percentage error, whatever F is."""
    truth = np.random.default_rng(2).normal(size=(3, 20, 3)) + 5
    errors = metrics.force_errors(1.1 * truth, truth)
    np.testing.assert_allclose(errors['force_relative_l2'], 0.1, rtol=1e-9)
    np.testing.assert_allclose(errors['force_mpe'], 10.0, rtol=1e-9)
    np.testing.assert_allclose(errors['force_rmse'], 0.1 * np.sqrt((truth**2).mean(axis=(1, 2))))


def test_zero_force_gives_no_number_instead_of_a_crash():
    zero = np.zeros((1, 5, 3))
    assert not np.isfinite(metrics.force_errors(zero + 1, zero)['force_relative_l2']).any()


def test_skill():
    assert metrics.skill(0.0, [2.0, 1.0]) == 1.0
    assert metrics.skill(1.0, [2.0, 1.0]) == 0.0
    assert np.isnan(metrics.skill(1.0, [0.0, 1.0]))
