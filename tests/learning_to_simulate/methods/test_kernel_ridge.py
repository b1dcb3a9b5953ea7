"""Kernel ridge: its closed form, and errors on runs that are left out against fits without them."""

import numpy as np
import pytest
from sklearn.gaussian_process.kernels import RBF, Matern
from sklearn.kernel_ridge import KernelRidge
from sklearn.model_selection import LeaveOneGroupOut, cross_val_predict

from learning_to_simulate.methods.kernel_ridge import Regression, errors_left_out, gram_matrix


def test_a_regression_is_the_closed_form():
    """dual = (K + alpha I)^-1 y on inputs of mean 0 and deviation 1."""
    rng = np.random.default_rng(0)
    x, y = rng.normal(3.0, [1.0, 50.0, 0.0], (40, 3)), rng.normal(size=(40, 2))
    regression = Regression.fit('path', x, y, gamma=0.6, alphas=[1.0, 0.03])[1]
    scaled = (x - x.mean(axis=0)) / np.where(x.std(axis=0) > 1e-9, x.std(axis=0), 1.0)

    def kernel(a, b):
        return np.exp(-0.2 * ((a[:, None] - b[None]) ** 2).sum(axis=-1))

    dual = np.linalg.solve(kernel(scaled, scaled) + 0.03 * np.eye(40), y)
    np.testing.assert_allclose(regression.dual, dual, rtol=1e-8, atol=1e-10)
    new = rng.normal(3.0, [1.0, 50.0, 0.0], (2, 5, 3))
    at = ((new - x.mean(axis=0)) / np.where(x.std(axis=0) > 1e-9, x.std(axis=0), 1.0)).reshape(
        10, 3
    )
    np.testing.assert_allclose(
        regression(new).reshape(10, 2), kernel(at, scaled) @ dual, rtol=1e-8, atol=1e-9
    )


def test_errors_on_runs_left_out_are_those_of_fits_without_them():
    """scikit-learn leaves each run out and fits again; the scaling is that of all samples."""
    rng = np.random.default_rng(1)
    x, run = rng.normal(2.0, [1.0, 30.0], (45, 2)), np.repeat([0, 1, 2, 5], [10, 15, 12, 8])
    y = np.stack([np.sin(x[:, 0]), np.cos(x[:, 1] / 30) + x[:, 0]], axis=1)
    alphas = [1e-6, 1e-3, 1.0]
    found = errors_left_out(x, y, run, 0.7, alphas)
    scaled = (x - x.mean(axis=0)) / x.std(axis=0)
    for alpha, errors in zip(alphas, found, strict=True):
        ridge = KernelRidge(alpha=alpha, kernel='rbf', gamma=0.35)
        predicted = cross_val_predict(ridge, scaled, y, groups=run, cv=LeaveOneGroupOut())
        np.testing.assert_allclose(
            errors, y - predicted, rtol=1e-5, atol=1e-6 * np.abs(errors).max()
        )


@pytest.mark.parametrize(
    ('name', 'theirs'),
    [
        ('gaussian', RBF),
        ('matern', lambda length: Matern(length, nu=1.5)),
        ('exponential', lambda length: Matern(length, nu=0.5)),
    ],
)
def test_kernels_are_those_of_scikit_learn(name, theirs):
    rng = np.random.default_rng(3)
    a, b, gamma = rng.normal(size=(7, 3)), rng.normal(size=(5, 3)), 0.3
    expected = theirs(1 / np.sqrt(2 * gamma))(a, b)
    np.testing.assert_allclose(gram_matrix(a, b, gamma, name), expected, rtol=1e-12)


def test_arrays_that_do_not_fit_each_other_are_refused():
    rng = np.random.default_rng(2)
    (fitted,) = Regression.fit('path', rng.normal(size=(9, 3)), rng.normal(size=(9, 2)), 1.0, [0.1])
    fitted.check()
    wrong = {'dual': fitted.dual[1:], 'shift': fitted.shift[1:], 'scale': np.zeros(3),
             'offset': np.zeros(3), 'kernel': 'box'}  # fmt: skip
    for name, value in wrong.items():
        broken = Regression(**(vars(fitted) | {name: value}))
        with pytest.raises(ValueError, match='do not fit'):
            broken.check()
