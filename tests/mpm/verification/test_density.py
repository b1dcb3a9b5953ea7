"""Density by counting, of beds with a known one."""

import numpy as np
import pytest

from mpm import packing, scenes
from mpm.verification import density

BOX = scenes.EXCAVATION.bin


@pytest.fixture(scope='module')
def bed():
    return packing.lattice(BOX, seed=0)[:, :3]


def test_density_is_that_of_the_bed(bed):
    volume = np.prod(BOX.size) / len(bed) / (4 / 3 * np.pi * density.RADIUS**3)
    middles = density.spheres(bed, BOX)
    number, sums = density.count(bed, middles, np.full(len(bed), 2.0))
    assert number.mean() * volume == pytest.approx(1.0, rel=0.01)
    np.testing.assert_array_equal(sums, 2 * number)
    pressed = bed.copy()
    pressed[:, 1] = scenes.CORNER + (bed[:, 1] - scenes.CORNER) / 1.1
    number, _ = density.count(pressed, density.spheres(pressed, BOX), np.zeros(len(bed)))
    assert number.mean() * volume == pytest.approx(1.1, rel=0.01)


def test_spheres_lie_in_the_soil(bed):
    middle = scenes.CORNER + BOX.size[0] / 2
    trench = bed[(np.abs(bed[:, 0] - middle) > 0.05) | (bed[:, 1] < scenes.CORNER + 0.05)]
    middles = density.spheres(trench, BOX)
    assert len(middles) > 5000
    assert np.abs(middles[:, 0] - middle).min() > 0.05 + density.RADIUS / 2
    assert middles.min() >= scenes.CORNER + density.RADIUS
    assert middles[:, 1].max() < BOX.surface - density.RADIUS + 5e-3
