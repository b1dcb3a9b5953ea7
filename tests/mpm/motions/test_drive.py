"""Levels against numerical derivatives and quadrature."""

import numpy as np
import pytest
from scipy.integrate import quad

from mpm.motions.drive import Levels, Track

LEVELS = Levels(np.array([0.0, 0.7, 1.0, 2.5, 3.1]), np.array([0.0, 0.12, 0.12, -0.05, 0.0]))


def test_passes_its_levels_and_never_leaves_their_range():
    np.testing.assert_allclose(LEVELS(LEVELS.times), LEVELS.values, atol=1e-15)
    np.testing.assert_array_equal(LEVELS(np.array([-1.0, 4.0])), [0.0, 0.0])
    for first in range(4):
        span = np.linspace(*LEVELS.times[first : first + 2], 500)
        way = np.diff(LEVELS(span)) * np.sign(np.diff(LEVELS.values[first : first + 2]))
        assert (way >= -1e-15).all()  # monotonic


def test_two_derivatives_are_continuous_and_the_third_is_finite():
    h = 1e-5
    for knot in LEVELS.times:
        before, after = (LEVELS(knot + side * h * np.arange(4)) for side in (-1.0, 1.0))
        for order, bound in ((1, 1e-5), (2, 1e-1)):
            slopes = [np.diff(x, order)[0] / h**order for x in (before, after)]
            # Zero at every level; the next derivative times the step is what remains.
            assert np.abs(slopes).max() < bound, (knot, order, slopes)


@pytest.mark.parametrize('time', [-0.5, 0.0, 0.3, 0.7, 0.9, 2.2, 3.1])
def test_integral_against_quadrature(time):
    expected = quad(lambda t: LEVELS(np.array([t]))[0], 0.0, max(time, 0.0), points=LEVELS.times)[0]
    assert LEVELS.integral(np.array([time]))[0] == pytest.approx(expected, abs=1e-10)


def test_a_track_keeps_what_is_not_named():
    track = Track(x=1.0, y=2.0)
    track.add(0.5, x=3.0)
    track.add(0.25, y=-1.0)
    assert (track.times, track.time, track.last('x')) == ([0.0, 0.5, 0.75], 0.75, 3.0)
    assert track.values == {'x': [1.0, 3.0, 3.0], 'y': [2.0, 2.0, -1.0]}
    np.testing.assert_array_equal(track.levels('y')(np.array([0.0, 0.75])), [2.0, -1.0])
