"""The map of heights against volumes that are moved by hand."""

import numpy as np
import pytest

from mpm.height_map import HeightMap, shape_of
from mpm.scenes import CORNER
from tests.mpm import small

BOX = small.BLADE.bin
LENGTH, _, WIDTH = BOX.size


@pytest.fixture
def packed():
    return small.packed(small.BLADE)[0][:, :3]


def cells():
    nx, nz = shape_of(BOX)
    return LENGTH / nx, WIDTH / nz


def test_flat_bed_is_flat_to_the_last_bit(packed):
    heights = HeightMap(BOX, packed)(packed)
    assert heights.shape == shape_of(BOX)
    assert (heights == BOX.surface).all()


def test_volume_is_kept_wherever_soil_goes(packed):
    """Into the corners too: the sum over the map is the soil's packed volume."""
    rng = np.random.default_rng(0)
    moved = packed.copy()
    moved[:, [0, 2]] = CORNER + rng.uniform(0.0, 1.0, (len(moved), 2)) * (LENGTH, WIDTH)
    moved[:9, [0, 2]] = CORNER  # on the edge itself
    heights = HeightMap(BOX, packed)(moved)
    assert np.ptp(heights) > 0.01
    volume = (heights - CORNER).sum() * np.prod(cells())
    assert volume == pytest.approx(np.prod(BOX.size), rel=1e-12)


def test_soil_that_is_carried_over_shifts_its_heights(packed):
    """All soil within a strip goes a whole number of cells along: its column goes with it, which a
    direct sum of splines over the cells tells as well."""
    length, width = cells()
    moved = packed.copy()
    strip = np.abs(packed[:, 0] - CORNER - 0.4 * LENGTH) < 2.5 * length
    moved[strip, 0] += 3 * length
    heights = HeightMap(BOX, packed)(moved)

    nx, nz = shape_of(BOX)
    i, k = nx // 3, nz // 2
    middle = CORNER + np.array([(i + 0.5) * length, (k + 0.5) * width])
    volume = np.prod(BOX.size) / len(packed)

    def column(x):
        away = (x[:, [0, 2]] - middle) / (length, width)
        return small.spline(away).prod(axis=1).sum() * volume / (length * width)

    expected = BOX.surface + column(moved) - column(packed)
    assert heights[i, k] == pytest.approx(expected, rel=1e-12)
    assert heights.min() < CORNER + 0.02 < BOX.surface + 0.1 < heights.max()
