"""Gravity that leans."""

import numpy as np
import pytest

from mpm import columns, experiments
from mpm.scenes import EARTH_GRAVITY
from mpm.solver import EXCHANGE


@pytest.mark.parametrize('slope', [0.3, -0.2])
def test_soil_in_the_air_falls_where_gravity_leans(slope):
    soil = experiments.weightless_soil()
    block = soil.solver.block(soil.particles)
    soil.solver.advance(block, 12, EARTH_GRAVITY, slope=slope)
    fallen = block.particles[:, columns.V : columns.V + 3]
    speed = 12 * EXCHANGE * EARTH_GRAVITY
    wanted = speed * np.array([np.sin(slope), -np.cos(slope), 0.0])
    np.testing.assert_allclose(fallen, np.tile(wanted, (len(fallen), 1)), atol=1e-4 * speed)
