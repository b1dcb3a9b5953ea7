"""Pairs of simulations, on the coarse scene."""

import numpy as np

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
