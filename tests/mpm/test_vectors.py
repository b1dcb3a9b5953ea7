"""Vectors of four against numpy."""

import numba
import numpy as np

from mpm import vectors


@numba.njit
def _all(values, others, factor, result):
    a = vectors.load(values, numba.uintp(3))
    b = vectors.load(others, numba.uintp(0))
    vectors.store(result, numba.uintp(0), vectors.muladd(factor, a, b))
    vectors.store(result, numba.uintp(4), vectors.scale(factor, a))
    vectors.store(result, numba.uintp(8), vectors.add(a, b))
    vectors.store(result, numba.uintp(12), vectors.make(1.0, factor, 3.0, 4.0))
    return vectors.parts(a)


def test_operations_equal_those_of_numpy():
    rng = np.random.default_rng(0)
    values, others, factor = rng.normal(size=8), rng.normal(size=4), 0.37
    result = np.full(17, np.nan)
    found = _all(values, others, factor, result)
    a = values[3:7]  # not on a boundary of 32 bytes
    np.testing.assert_array_equal(found, a)
    # One rounding or two.
    np.testing.assert_allclose(result[:4], factor * a + others, rtol=0, atol=1e-16)
    np.testing.assert_array_equal(result[4:8], factor * a)
    np.testing.assert_array_equal(result[8:12], a + others)
    np.testing.assert_array_equal(result[12:16], [1.0, factor, 3.0, 4.0])
    assert np.isnan(result[16])  # nothing is written beyond


def test_nan_and_infinity_pass_through():
    values = np.array([0.0, 0.0, 0.0, np.nan, np.inf, -np.inf, -0.0])
    result = np.zeros(16)
    _all(values, np.zeros(4), 2.0, result)
    np.testing.assert_array_equal(result[4:7], [np.nan, np.inf, -np.inf])
    assert np.isnan(result[0]) and np.isnan(result[8])
