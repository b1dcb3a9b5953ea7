"""Levels against their range and quadrature."""

import numpy as np
import pytest
from scipy.integrate import quad

from mpm.motions.drive import Levels

LEVELS = Levels(np.array([0.0, 0.7, 1.0, 2.5, 3.1]), np.array([0.0, 0.12, 0.12, -0.05, 0.0]))


def test_passes_its_levels_and_never_leaves_their_range():
    np.testing.assert_allclose(LEVELS(LEVELS.times), LEVELS.values, atol=1e-15)
    np.testing.assert_array_equal(LEVELS(np.array([-1.0, 4.0])), [0.0, 0.0])
    for first in range(4):
        span = np.linspace(*LEVELS.times[first : first + 2], 500)
        way = np.diff(LEVELS(span)) * np.sign(np.diff(LEVELS.values[first : first + 2]))
        assert (way >= -1e-15).all()  # monotonic


@pytest.mark.parametrize('time', [-0.5, 0.0, 0.3, 0.7, 0.9, 2.2, 3.1])
def test_integral_against_quadrature(time):
    expected = quad(lambda t: LEVELS(np.array([t]))[0], 0.0, max(time, 0.0), points=LEVELS.times)[0]
    assert LEVELS.integral(np.array([time]))[0] == pytest.approx(expected, abs=1e-10)
