"""Heights of beds that are read from particles."""

import numpy as np
import pytest

from learning_to_simulate import bed
from learning_to_simulate.axes import Axes


def test_the_surface_of_a_bed_is_read_from_some_of_its_particles():
    """A jittered lattice, a fifth of it kept, with a hill across the way."""
    rng, spacing, axes = np.random.default_rng(0), 0.0136, Axes(0, -1, 1)
    grid = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in (56, 11, 42)), indexing='ij'), -1)
    points = (grid.reshape(-1, 3) + rng.uniform(-0.05, 0.05, (grid.size // 3, 3))) * spacing
    kept = points[::5]
    close = (np.prod(np.ptp(kept, axis=0)) / len(kept)) ** (1 / 3)
    flat = np.median(bed.surface_profile(kept, -np.linspace(0.05, 0.7, 12), axes, close, spacing))
    assert flat == pytest.approx(11 * spacing, abs=0.2 * spacing)
    points[:, 1] += 0.05 * np.exp(-(((points[:, 0] - 0.4) / 0.1) ** 2))
    places = -np.array([0.1, 0.4, 0.7])
    profile = bed.surface_profile(points[::5], places, axes, 0.02, spacing)
    assert profile - flat == pytest.approx([0.0, 0.05, 0.0], abs=0.006)
