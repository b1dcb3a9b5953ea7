"""Pairs of simulations, on the coarse scene."""

import numpy as np
import pytest

from mpm import scenes
from mpm.simulation import Settings
from mpm.verification import convergence


def test_pairs_tell_what_changes(coarse_excavation):
    (step,) = convergence.halved_step(coarse_excavation, 186, 25)
    assert 0.0 < abs(step.figure) < 0.01 and step.passed and '25 frames' in step.note
    for option in convergence.SHORT_CUTS:
        rows = convergence.short_cut(option, coarse_excavation, 186, 12)
        assert [row.passed for row in rows] == [True, True]


def test_steps_in_single_precision_change_a_run_by_rounding_alone(coarse_excavation):
    """Against the same kernels in float64: not equal, and not more apart than rounding explains."""
    force, simulation = convergence.drive(coarse_excavation, 186, 12, Settings())
    exact, other = convergence.drive(coarse_excavation, 186, 12, Settings(single=False))
    apart = np.abs(simulation.positions() - other.positions()).max()
    assert 0.0 < apart < 2e-6  # m; measured 1e-7
    assert np.abs(force - exact).max() < 2e-4 * np.abs(exact).max()


def test_surface_is_the_highest_soil_of_each_square(coarse_excavation, excavation_packing):
    force, simulation = convergence.drive(coarse_excavation, 186, 2, Settings())
    assert force.shape == (2, 3)
    box = coarse_excavation.bin
    height = convergence.surface(simulation.positions(), box)
    assert height.shape == (30, 22)
    assert np.median(height) == pytest.approx(box.surface, abs=0.02)
    simulation.particles[7, :3] = [scenes.CORNER + 0.79, 0.31, scenes.CORNER + 0.59]
    assert convergence.surface(simulation.positions(), box)[-1, -1] == 0.31
