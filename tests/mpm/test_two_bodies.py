"""Two bodies in one bin: each as if it were the first, and nothing changes for one alone."""

import numpy as np
import pytest

from mpm import bodies
from mpm.constitutive import make_soil
from mpm.scenes import CORNER, Bin
from tests.mpm.box import Box, Moving

BLADE = bodies.make_blade(CORNER + 0.12, 0.12)
WHEEL = bodies.make_wheel(0.15, CORNER + 0.12)


def _box():
    room = Bin((1.2, 0.12, 0.24), 0.04, (0, 0, 0), 1, 0.4, ())
    return Box(room, Bin((1.2, 0.12, 0.24), 0.04, (30, 3, 6), 1, 0.4, ()), make_soil(1.5e6, 0.7))


def _moving(body, start, height, speed=0.4):
    lowest = CORNER + 0.12 + height
    return Moving(body, lambda t: np.stack([start - speed * t, lowest + 0 * t, 0.1 - t], axis=1))


def _pushed(moving, seconds=0.05):
    box = _box()
    forces = [box.frame(seconds / 2, moving) for _ in range(2)]
    return box.particles, np.array(forces)


def test_each_is_treated_as_the_first_is():
    """Order changes nothing but the order of sums; grips last over frames for both."""
    blade, wheel = _moving(BLADE, CORNER + 0.4, -0.01), _moving(WHEEL, CORNER + 0.9, 0.06)
    here, forces = _pushed([blade, wheel])
    there, swapped = _pushed([wheel, blade])
    assert np.abs(forces).max(axis=(0, 2)).min() > 1.0  # both push
    np.testing.assert_allclose(here, there, rtol=0, atol=1e-9 * np.abs(here).max())
    np.testing.assert_allclose(forces, swapped[:, ::-1], rtol=0, atol=1e-6 * np.abs(forces).max())


def test_a_second_one_in_the_air_changes_no_bit():
    blade, above = _moving(BLADE, CORNER + 0.4, -0.01), _moving(WHEEL, CORNER + 0.9, 0.3)
    alone, force = _pushed([blade])
    both, forces = _pushed([blade, above])
    np.testing.assert_array_equal(both, alone)
    np.testing.assert_array_equal(forces[:, 0], force[:, 0])
    assert not forces[:, 1].any()


def test_bodies_that_touch_the_same_soil_are_refused():
    near = _moving(WHEEL, CORNER + 0.45, 0.06)
    with pytest.raises(ValueError, match='so close that both may touch'):
        _pushed([_moving(BLADE, CORNER + 0.4, -0.01), near])
    load = Moving(WHEEL, near.pose, lambda t: 10.0)
    with pytest.raises(ValueError, match='two bodies at most'):
        _pushed([_moving(BLADE, CORNER + 0.4, -0.01), load])
