"""Gravity that leans; two bodies in one bin, each of them as if it were the first."""

import numpy as np
import pytest

from mpm import bodies, columns, experiments, packing
from mpm.grid import make_grid
from mpm.motions.drive import poses
from mpm.scenes import CORNER, EARTH_GRAVITY, Bin
from mpm.solver import EXCHANGE, Solver
from tests.mpm import small

BOX = Bin((1.2, 0.12, 0.24), 0.04, 0.04, (30, 3, 6), 1, 0.4, ())


def moving(body, start, height, speed=0.4):
    def path(times):
        return poses(
            times, CORNER + start - speed * times, CORNER + 0.12 + height, 0.1 - times, 0.22
        )

    return body, path


BLADE = moving(bodies.make_blade(0.12), 0.4, -0.01)
WHEEL, ABOVE, NEAR = (
    moving(bodies.make_wheel(0.15), *place) for place in ((0.9, 0.06), (0.9, 0.3), (0.45, 0.06))
)


def pushed(*moved, intervals=27):
    """Particles after a push, and the mean force on each body."""
    solver = Solver(make_grid(BOX), small.SOIL, packing.particle_volume(BOX))
    rows = packing.at_rest(packing.lattice(BOX, 0), small.SOIL, BOX.surface, EARTH_GRAVITY)
    block = solver.block(rows)
    times = solver.dt * np.arange(intervals * solver.steps + 1)
    given = tuple((body, path(times), None, None) for body, path in moved)
    loads = solver.advance(block, intervals, EARTH_GRAVITY, bodies=given)
    return block.particles, np.array([load[:, :3].mean(axis=0) for load in loads])


def test_each_is_treated_as_the_first_is():
    """Order changes nothing but the order of sums."""
    here, forces = pushed(BLADE, WHEEL)
    there, swapped = pushed(WHEEL, BLADE)
    assert np.abs(forces).max(axis=1).min() > 1.0  # both push
    np.testing.assert_allclose(here, there, rtol=0, atol=1e-9 * np.abs(here).max())
    np.testing.assert_allclose(forces, swapped[::-1], rtol=0, atol=1e-6 * np.abs(forces).max())


def test_a_second_one_in_the_air_changes_no_bit():
    (alone, force), (both, forces) = pushed(BLADE), pushed(BLADE, ABOVE)
    np.testing.assert_array_equal(both, alone)
    np.testing.assert_array_equal(forces[0], force[0])
    assert not forces[1].any()


def test_bodies_that_touch_the_same_soil_are_refused():
    with pytest.raises(ValueError, match='so close that both may touch'):
        pushed(BLADE, NEAR)


@pytest.mark.parametrize('slope', [0.0, 0.3, -0.2])
def test_soil_in_the_air_falls_where_gravity_leans(slope):
    soil = experiments.weightless_soil()
    block = soil.solver.block(soil.particles)
    soil.solver.advance(block, 12, EARTH_GRAVITY, slope=slope)
    fallen = block.particles[:, columns.V : columns.V + 3]
    speed = 12 * EXCHANGE * EARTH_GRAVITY
    wanted = speed * np.array([np.sin(slope), -np.cos(slope), 0.0])
    np.testing.assert_allclose(fallen, np.tile(wanted, (len(fallen), 1)), atol=1e-4 * speed)
