"""The equation of earthmoving against closed forms."""

import numpy as np
import pytest

from mpm.earthmoving import draft_force


@pytest.mark.parametrize('phi', np.radians([25.0, 37.0, 50.0]))
def test_draft_of_an_upright_smooth_wide_blade_is_rankine(phi):
    """No wall friction, no sides: half rho g h2 Kp per width."""
    width = 1e6
    draft = draft_force(0.1, width, np.pi / 2, phi, 0.0, 17000.0)
    passive = (1 + np.sin(phi)) / (1 - np.sin(phi))
    # The plane is searched in steps of a quarter of a degree.
    assert draft == pytest.approx(0.5 * 17000.0 * 0.1**2 * width * passive, rel=1e-3)


def test_heap_and_depth_raise_the_draft():
    def draft(depth, rake=1.5, heap=None):
        return draft_force(depth, 0.457, rake, 0.7, 0.3, 17000.0, heap)

    assert draft(0.1) > 3.9 * draft(0.05)
    assert draft(0.1, heap=lambda reach: 10.0) > draft(0.1)
