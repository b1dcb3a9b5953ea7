"""Soil that is stepped by hand."""

import numpy as np
import pytest

from mpm import columns, packing
from mpm.experiments import Experiment
from mpm.verification import bed
from tests.mpm import small


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
