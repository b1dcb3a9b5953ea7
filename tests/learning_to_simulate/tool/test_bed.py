"""Heights of beds that are read from particles."""

import numpy as np
import pytest

from learning_to_simulate.tool import bed
from learning_to_simulate.tool.axes import Axes
from tests.learning_to_simulate.swept_field import small_world as world


def test_the_surface_of_a_bed_is_read_from_some_of_its_particles():
    """A jittered lattice, a fifth of it kept, with a hill across the way."""
    rng, spacing, axes = np.random.default_rng(0), 0.0136, Axes(0, -1, 1)
    grid = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in (56, 11, 42)), indexing='ij'), -1)
    points = (grid.reshape(-1, 3) + rng.uniform(-0.05, 0.05, (grid.size // 3, 3))) * spacing
    kept = points[::5]
    flat = bed.flat_surface(kept, axes, bed.kept_spacing(kept), spacing)
    assert flat == pytest.approx(11 * spacing, abs=0.2 * spacing)
    points[:, 1] += 0.05 * np.exp(-(((points[:, 0] - 0.4) / 0.1) ** 2))
    places = -np.array([0.1, 0.4, 0.7])
    profile = bed.surface_profile(points[::5], places, axes, 0.02, spacing)
    assert profile - flat == pytest.approx([0.0, 0.05, 0.0], abs=0.006)


def test_a_bed_that_is_not_flat_is_read_where_the_tool_passes():
    """A step half-way: the surface follows it, the level is the median, and a particle beside the
    tool's strip counts for nothing."""
    points = world.bed_points()
    points[points[:, 0] < 0.5, 1] -= 0.04
    points = np.concatenate([points, [[0.3, 0.6, world.MIDDLE + 0.27]]])
    read = bed.ground(
        points, -0.75, [0.3], 0.3, world.AXES, world.GRID, world.SPACING, world.SPACING
    )
    x, surface = 0.75 - world.GRID.offsets, read.bed.surface[0]
    for low, high, height in ((0.12, 0.43, -0.04), (0.57, 0.88, 0.0)):
        np.testing.assert_allclose(
            surface[(x > low) & (x < high)], world.SURFACE + height, atol=1e-3
        )
    assert read.bed.level == pytest.approx(np.median(surface[(x > 0.1) & (x < 0.9)]), abs=0.02)
    assert read.bed.end == pytest.approx(-0.1, abs=0.03)
