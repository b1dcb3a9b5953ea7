"""Which soil sleeps, and that it makes little difference."""

import numpy as np
import pytest

from mpm import bodies, sleeping
from mpm.distance import signed_distances
from mpm.grid import make_grid
from mpm.scenes import CORNER, Bin
from tests.mpm import small

GRID = make_grid(Bin((0.4, 0.2, 0.4), 0.02, 0.04, (0, 0, 0), 1, 0.4, ()))
BLADE = bodies.make_blade(0.2)
MIDDLE = CORNER + 0.2


def test_nodes_asleep_are_those_with_a_weight():
    """Against all nodes and all particles; the order of the kernels is y, x, z."""
    positions = CORNER + np.random.default_rng(1).uniform(0.0, 0.4, (60, 3))
    asleep = sleeping.Sleep(GRID, True).nodes_asleep(positions)
    nx, ny, nz = GRID.shape
    axes = [GRID.origin[a] + np.arange(GRID.shape[a]) * GRID.cell[a] for a in range(3)]
    expected = np.zeros((ny, nx, nz), dtype=bool)
    for x in positions:
        near = [np.abs(axis - v) < 1.5 * side for axis, v, side in zip(axes, x, GRID.cell)]
        expected |= near[1][:, None, None] & near[0][None, :, None] & near[2][None, None, :]
    np.testing.assert_array_equal(asleep.reshape(ny, nx, nz), expected)


def test_soil_that_moved_and_soil_near_the_body_is_awake():
    rng = np.random.default_rng(2)
    positions = CORNER + rng.uniform(0.0, 0.38, (4000, 3)) * [1.0, 0.4, 1.0]
    sleep, period = sleeping.Sleep(GRID, True), 0.1
    # A blade at 0.1 m/s in the far corner, upright and above the soil.
    path = np.array([[CORNER + 0.39, CORNER + 0.15, 0.0, MIDDLE]])
    path = path - [[0.01], [0.0]] * np.array([1.0, 0, 0, 0])
    for _ in range(sleeping.MEMORY):
        assert sleep.awake(positions, BLADE, path, period).all()  # all of it at first
    before = sleep.awake(positions, BLADE, path, period)
    # Near the body, against a distance from bodies alone.
    distance = np.min([signed_distances(BLADE, pose, positions) for pose in path], axis=0)
    reach = sleeping.BODY_REACH
    assert before[distance < reach - 1e-9].all() and not before[distance > 1.5 * reach].any()
    # One grain moves faster than a three thousandths of the blade's 0.1 m/s, another one slower.
    far = np.flatnonzero(distance > 2.0 * reach)
    fast, slow = far[np.argmin(positions[far, 2])], far[np.argmax(positions[far, 2])]
    positions[fast, 1] += 3.3e-4 * period
    positions[slow, 1] += 2.7e-4 * period
    for _ in range(sleeping.MEMORY + 1):
        awake = sleep.awake(positions, BLADE, path, period)
        cell = np.floor((positions - GRID.origin) / GRID.cell)
        around = (np.abs(cell - cell[fast]) * GRID.cell <= sleeping.SOIL_REACH + 1e-9).all(axis=1)
        np.testing.assert_array_equal(awake, before | around)
        assert awake[fast] and not awake[slow]
    np.testing.assert_array_equal(sleep.awake(positions, BLADE, path, period), before)


def made(**settings):
    return small.simulation(small.BLADE, 186, **settings)


def test_soil_that_never_sleeps_gives_the_bits_of_soil_that_may_not(monkeypatch):
    off, on = made(sleep=False), made(sleep=True)
    monkeypatch.setattr(sleeping, 'MEMORY', 1000)  # what moved once stays awake
    np.testing.assert_array_equal(small.frames(off, 14), small.frames(on, 14))
    assert len(off._awake) == len(on._awake) == len(off._particles)
    np.testing.assert_array_equal(off.positions(), on.positions())


def test_sleeping_changes_little():
    off, on = made(sleep=False), made(sleep=True)
    force, expected = small.frames(on, 40), small.frames(off, 40)
    assert len(on._awake) < 0.9 * len(on._particles)
    # Measured 1.1 % on cells of 40 mm, on which a layer of soil is four cells deep, and 0.27 mm.
    assert force[20:, 0].mean() == pytest.approx(expected[20:, 0].mean(), rel=0.02)
    assert np.sqrt(((on.positions() - off.positions()) ** 2).sum(axis=1).mean()) < 5e-4


def test_sleeping_soil_keeps_its_stress_and_its_place():
    simulation = made()
    small.frames(simulation, 9)  # it looked before the ninth and will before the thirteenth
    asleep = np.ones(len(simulation.positions()), dtype=bool)
    asleep[simulation._awake] = False
    assert asleep.any()
    before = simulation.particles.copy()
    small.frames(simulation, 2)
    after = simulation.particles
    np.testing.assert_array_equal(after[asleep], before[asleep])
    assert not after[asleep, 3:6].any() and after[asleep, 15:21].any()
