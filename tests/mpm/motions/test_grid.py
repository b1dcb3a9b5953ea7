"""The published motions against their records."""

import numpy as np
import pytest

from mpm.motions import grid


def test_published_blade_motion():
    """Travel between stored frames of published records (float32 files, four decimals)."""
    # Case 213, motion 1 at 4 cm/s: from frame 80 to 160 of the record, 0.0333 m down and forward.
    path = grid.blade_displacement(1, 0.10, 0.04, np.array([80.0, 160.0]) / 60)
    np.testing.assert_allclose(path[1] - path[0], [-0.0333, -0.0333], atol=1e-4)
    # Case 186, motion 2 at 10 cm/s, frames 80 and 160 (record: 0.7005 and 0.5672).
    path = grid.blade_displacement(2, 0.08, 0.10, np.array([80.0, 160.0]) / 60)
    assert path[1, 0] - path[0, 0] == pytest.approx(0.5672 - 0.7005, abs=1e-4)
