"""Registers of four and of sixteen against numpy, in both types."""

import numba
import numpy as np
import pytest

from mpm import vectors

TYPES = [np.float32, np.float64]


@numba.njit
def _fours(values, others, factor, result):
    a = vectors.load(values, numba.uintp(3))
    b = vectors.load(others, numba.uintp(0))
    vectors.store(result, numba.uintp(0), vectors.muladd(factor, a, b))
    vectors.store(result, numba.uintp(4), vectors.scale(factor, a))
    vectors.store(result, numba.uintp(8), vectors.add(a, b))
    vectors.store(result, numba.uintp(12), vectors.make(result, 1.0, factor, 3.0, 4.0))
    vectors.store(result, numba.uintp(16), vectors.muladd_at(others, numba.uintp(2), a, b))
    vectors.store(result, numba.uintp(20), vectors.scale_at(others, numba.uintp(1), a))
    return vectors.parts(a)


@numba.njit
def _rows(values, four, result):
    row = vectors.load_row(values, numba.uintp(1))
    small = vectors.load(four, numba.uintp(0))
    vectors.store(result, numba.uintp(0), vectors.fold(row))
    vectors.store_row(result, numba.uintp(4), vectors.multiply(row, vectors.repeat(small)))
    vectors.store_row(result, numba.uintp(20), vectors.stretch(small))
    vectors.store_row(result, numba.uintp(36), vectors.muladd(2.0, row, row))


@pytest.mark.parametrize('special', [False, True])
@pytest.mark.parametrize('dtype', TYPES)
def test_operations_equal_those_of_numpy(dtype, special):
    rng = np.random.default_rng(0)
    values, others = rng.normal(size=8).astype(dtype), rng.normal(size=4).astype(dtype)
    factor = 0.37
    if special:
        values[3:6] = np.nan, np.inf, -np.inf
    result = np.full(25, np.nan, dtype)
    found = _fours(values, others, factor, result)
    a, near = values[3:7], np.finfo(dtype).eps  # not on a boundary of 32 bytes
    np.testing.assert_array_equal(found, a.astype(np.float64))
    # One rounding or two.
    np.testing.assert_allclose(result[:4], dtype(factor) * a + others, rtol=0, atol=near)
    np.testing.assert_array_equal(result[4:8], dtype(factor) * a)
    np.testing.assert_array_equal(result[8:12], a + others)
    np.testing.assert_array_equal(result[12:16], np.array([1.0, factor, 3.0, 4.0], dtype))
    np.testing.assert_allclose(result[16:20], others[2] * a + others, rtol=0, atol=2 * near)
    np.testing.assert_array_equal(result[20:24], others[1] * a)
    assert np.isnan(result[24])  # nothing is written beyond


@pytest.mark.parametrize('dtype', TYPES)
def test_rows_are_four_nodes(dtype):
    rng = np.random.default_rng(1)
    values, four = rng.normal(size=17).astype(dtype), rng.normal(size=4).astype(dtype)
    result = np.full(53, np.nan, dtype)
    _rows(values, four, result)
    nodes = values[1:].reshape(4, 4)
    np.testing.assert_allclose(result[:4], nodes.sum(axis=0), rtol=0, atol=4 * np.finfo(dtype).eps)
    np.testing.assert_array_equal(result[4:20], (nodes * four).ravel())
    np.testing.assert_array_equal(result[20:36], np.repeat(four, 4))
    np.testing.assert_allclose(result[36:52], 3 * values[1:], rtol=4 * np.finfo(dtype).eps)
    assert np.isnan(result[52])
