"""What is read from a bed of soil: known heights, densities and stresses, and no jumps."""

import numpy as np
import pytest

from mpm import columns, packing, scenes
from mpm.experiments import Experiment
from mpm.verification import bed
from mpm.verification.bed import surface
from tests.mpm import small

# A quarter of the scene's bin, of its cells.
BOX = scenes.sampled((0.4, 0.15, 0.3), 0.8 / 120, 0.02, 1, 0.5, ())
LATTICE = packing.lattice(BOX, seed=0)[:, :3]


def test_known_heights():
    """A flat block with one on top of it that fills every second place, and no soil at all."""
    size, lattice = np.array(BOX.size), np.array([60, 24, 45])
    grid = np.stack(np.meshgrid(*map(np.arange, lattice), indexing='ij'), axis=-1).reshape(-1, 3)
    block = scenes.CORNER + (grid + 0.5) / lattice * size
    flat = surface(block, BOX)
    assert flat.shape == (15, 11)
    np.testing.assert_allclose(flat, BOX.surface, atol=2e-4)
    # What lies left of the middle is heaped onto the right.
    block[block[:, 0] < scenes.CORNER + 0.5 * size[0]] += [0.5 * size[0], size[1], 0.0]
    height = surface(block, BOX)
    np.testing.assert_allclose(height[10:], BOX.surface + size[1], atol=2e-4)
    np.testing.assert_array_equal(height[:5], scenes.CORNER)


def test_a_surface_follows_its_bed_without_jumps():
    before = surface(LATTICE, BOX)
    np.testing.assert_allclose(surface(LATTICE - [0, 1e-3, 0], BOX) - before, -1e-3, rtol=0.01)
    # A column crosses the border of a square: the highest particle of each would jump by a layer.
    border = scenes.CORNER + BOX.size[0] / 2
    column = np.abs(LATTICE[:, 0] - border) < 0.005
    here, there = LATTICE.copy(), LATTICE.copy()
    here[column, 0], there[column, 0] = border - 5e-7, border + 5e-7
    assert column.sum() > 100
    assert 0.0 < np.abs(surface(there, BOX) - surface(here, BOX)).max() < 1e-6
    # The highest particle of all, raised by a layer.
    raised = LATTICE.copy()
    raised[np.argmax(LATTICE[:, 1]), 1] += 0.0141
    change = surface(raised, BOX) - before
    assert 1e-4 < change.max() < 2e-3 and change.min() == 0.0


@pytest.mark.parametrize('pressed', [1.0, 1.1])
def test_density_is_that_of_the_bed(pressed):
    soil = LATTICE.copy()
    soil[:, 1] = scenes.CORNER + (soil[:, 1] - scenes.CORNER) / pressed
    volume = np.prod(BOX.size) / len(soil) / (4 / 3 * np.pi * bed.RADIUS**3)
    number, sums = bed.count(soil, bed.spheres(soil, BOX), np.full(len(soil), 2.0))
    assert number.mean() * volume == pytest.approx(pressed, rel=0.01)
    np.testing.assert_array_equal(sums, 2 * number)


def test_spheres_lie_in_the_soil():
    middle, soil = scenes.CORNER + BOX.size[0] / 2, LATTICE
    trench = soil[(np.abs(soil[:, 0] - middle) > 0.05) | (soil[:, 1] < scenes.CORNER + 0.05)]
    middles = bed.spheres(trench, BOX)
    assert len(middles) > 500
    assert np.abs(middles[:, 0] - middle).min() > 0.05 + bed.RADIUS / 2
    assert middles.min() >= scenes.CORNER + bed.RADIUS
    assert middles[:, 1].max() < BOX.surface - bed.RADIUS + 5e-3


def test_settled_soil_carries_its_weight():
    """On half of the wheel's own bin: measured 0.9999 and 0.9982; damping without gravity has
    0.980."""
    size, dx, dz = scenes.WHEEL.bin.size, scenes.WHEEL.bin.dx, scenes.WHEEL.bin.dz
    box = scenes.sampled((size[0] / 2, *size[1:]), dx, dz, 1, 0.2, ())
    figures = bed.settled_soil(box, packing.settle(box, 1.5e6, 0)[0], small.SOIL)
    assert figures['reaction_over_weight'] == pytest.approx(1.0, abs=2e-3)
    assert figures['stress_over_rho_g_h'] == pytest.approx(1.0, abs=5e-3)


def test_settled_soil_rests_at_another_gravity():
    """The stress scales with gravity, so that one packing serves all of them."""
    box, rows = small.WHEEL.bin, small.packed(small.WHEEL)[0]
    experiment = Experiment(box, box, small.SOIL)
    experiment.particles = packing.for_soil(rows, small.SOIL, 1.62)
    scaled, usual = (
        bed.settled_soil(box, particles, small.SOIL)['stress_over_rho_g_h']
        for particles in (experiment.particles, rows)
    )
    assert scaled / usual == pytest.approx(1.62 / 9.81, rel=1e-6)
    time = experiment.advance(0.15, gravity=1.62)
    speed = np.abs(experiment.particles[:, columns.V : columns.V + 3]).max()
    assert speed < 0.01 * 1.62 * time


@pytest.mark.parametrize('more', [0.0, 0.1])
def test_stress_of_soil_is_read_above_the_lowest_cell_and_within_it(more):
    """Soil at the exact stress, and more of it within a cell of the floor."""
    box, soil = small.BLADE.bin, small.SOIL
    particles = packing.lattice(box, seed=0)
    weight = soil.bulk_density * scenes.EARTH_GRAVITY * (box.surface - particles[:, 1])
    particles[:, columns.VOLUME_RATIO] = 1.0 / (1.0 + weight / soil.bulk_modulus)
    low = particles[:, 1] < scenes.CORNER + box.dx
    particles[low, columns.S + 1] = -more * weight[low]
    figures = bed.settled_soil(box, particles, soil)
    assert figures['stress_over_rho_g_h'] == pytest.approx(1.0, rel=1e-9)
    assert figures['stress_at_floor_over_rho_g_h'] == pytest.approx(1.0 + more, rel=1e-9)
