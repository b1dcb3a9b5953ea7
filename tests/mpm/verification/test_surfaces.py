"""The surface of soil: known heights, and no jumps."""

import numpy as np
import pytest

from mpm import packing, scenes
from mpm.verification.surfaces import surface

BOX = scenes.EXCAVATION.bin


@pytest.fixture(scope='module')
def bed():
    return packing.lattice(BOX, seed=0)[:, :3]


def test_known_heights():
    """A flat block with one on top of it that fills every second place, and no soil at all."""
    size = np.array(BOX.size)
    lattice = np.array([120, 24, 90])
    grid = np.stack(np.meshgrid(*map(np.arange, lattice), indexing='ij'), axis=-1).reshape(-1, 3)
    block = scenes.CORNER + (grid + 0.5) / lattice * size
    flat = surface(block, BOX)
    assert flat.shape == (30, 22)
    np.testing.assert_allclose(flat, BOX.surface, atol=2e-4)
    # What lies left of the middle is heaped onto the right.
    left = block[:, 0] < scenes.CORNER + 0.5 * size[0]
    heaped = block.copy()
    heaped[left] += [0.5 * size[0], size[1], 0.0]
    height = surface(heaped, BOX)
    np.testing.assert_allclose(height[17:], BOX.surface + size[1], atol=2e-4)
    np.testing.assert_array_equal(height[:13], scenes.CORNER)


def test_a_lowered_bed_reads_what_it_was_lowered_by(bed):
    lower = surface(bed - [0.0, 1e-3, 0.0], BOX) - surface(bed, BOX)
    np.testing.assert_allclose(lower, -1e-3, rtol=0.01)


def test_a_micrometre_over_the_border_of_a_square_changes_no_more_than_that(bed):
    """By the highest particle of each square this changed some by a layer, 14 mm."""
    border = scenes.CORNER + BOX.size[0] / 2
    column = np.abs(bed[:, 0] - border) < 0.005
    before, after = bed.copy(), bed.copy()
    before[column, 0], after[column, 0] = border - 5e-7, border + 5e-7
    assert column.sum() > 100
    change = np.abs(surface(after, BOX) - surface(before, BOX)).max()
    assert 0.0 < change < 1e-6


def test_one_particle_is_a_small_part_of_a_surface(bed):
    """The highest one, raised by a whole layer."""
    raised = bed.copy()
    raised[np.argmax(bed[:, 1]), 1] += 0.0141
    change = surface(raised, BOX) - surface(bed, BOX)
    assert 1e-4 < change.max() < 2e-3 and change.min() == 0.0
