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


def test_more_particles_are_compared_with_those_of_the_data(bed, monkeypatch):
    class Run:
        """Soil that lies 2 mm higher where there is more of it."""

        def __init__(self, box):
            self.rise = 2e-3 if box != BOX else 0.0

        def positions(self):
            return bed + [0.0, self.rise, 0.0]

    def driven(scene, case, frames, dilation=0.0):
        box = scene.bin
        more = np.prod(box.lattice) / np.prod(BOX.lattice)
        assert box.dx == BOX.dx and (case, frames) == (186, 9)
        assert dilation in ((0.0,) if more > 1 else (0.0, 6.0))  # the many keep their volume
        return 100.0 * more, Run(box), (1.0 if dilation else 1.1) / more, 7

    monkeypatch.setattr(density, '_driven', driven)
    force, packed, surface = density.more_particles(186, 9)
    assert (force.figure, packed.figure) == (8.0, pytest.approx(1.1 / 8))
    assert surface.figure == pytest.approx(2.0, rel=0.01)
    assert '1.100 before' in packed.note and '100.0 N before' in force.note
    _, packed, _ = density.more_particles(186, 9, 6.0)
    assert '1.000 before' in packed.note and 'dilating' in packed.name


def test_dilating_soil_is_compared_with_soil_that_is_not(bed, monkeypatch):
    class Run:
        """Soil of which the dilating one lies 3 mm higher."""

        def __init__(self, dilation):
            self.rise = 3e-3 if dilation else 0.0

        def positions(self):
            return bed + [0.0, self.rise, 0.0]

    def driven(scene, case, frames, dilation=0.0):
        assert scene.bin == BOX and (case, frames) == (123, 5)
        return (110.0, Run(dilation), 1.02, 7) if dilation else (100.0, Run(dilation), 1.16, 7)

    monkeypatch.setattr(density, '_driven', driven)
    packed, force, surface = density.dilating_soil(123, 5)
    assert packed.figure == 1.02 and packed.passed and '1.160 without' in packed.note
    assert force.figure == pytest.approx(1.1)
    assert surface.figure == pytest.approx(3.0, rel=0.01)
