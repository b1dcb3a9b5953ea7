"""The limits as numbers, and what happens on both sides of them."""

import math

import numpy as np
import pytest

from mpm import columns, experiments, packing, stability
from mpm.constitutive import make_soil
from mpm.solver import EXCHANGE
from tests.mpm import small
from tests.mpm.small import SOIL


def test_too_long_a_step_is_refused_with_its_numbers():
    limit = stability.max_time_step(SOIL, 0.01)
    steps = stability.steps_in(1 / 60, SOIL, 0.01)
    assert limit * (steps - 1) < 1 / 60 <= limit * steps
    stability.check_time_step(limit, SOIL, 0.01)
    words = rf'time step {1.01 * limit:.4g} s is .* {limit:.4g}\] s: CFL number 0.808'
    with pytest.raises(ValueError, match=words):
        stability.check_time_step(1.01 * limit, SOIL, 0.01)
    motion = small.run.prepared(small.BLADE, 1, small.Settings())
    with pytest.raises(ValueError, match='CFL'):
        small.simulation(small.BLADE, motion, steps=1)


BOX = small.BLADE.bin


def disturbance(soil, particles, factor):
    """Largest speed (m/s) of soil at rest after 0.15 s in steps of `factor` times the CFL limit."""
    experiment = experiments.Experiment(BOX, BOX, soil)
    experiment.particles = particles.copy()
    # The step that was asked for, then the whole number of them in an interval; no check.
    solver = experiment.solver
    dt = factor * stability.max_time_step(soil, BOX.dx)
    solver.steps = max(1, round(EXCHANGE / dt))
    solver.dt = dt
    try:
        experiment.advance(0.15)
    except ValueError:
        return math.inf
    return float(np.abs(experiment.particles[:, columns.V : columns.V + 3]).max())


def test_soil_diverges_above_the_limit():
    """At ten times the stiffness: 0.02 mm/s up to 1.4 times the limit, 0.7 at 1.6, 13 at 1.8.

    With two steps between exchanges, as at 1.5 MPa on these cells, the exchange damps that.
    """
    soil = make_soil(1.5e7, 0.76)
    particles, _ = packing.settle(BOX, 1.5e7, 0)
    calm = disturbance(soil, particles, 1.0)
    assert calm < 0.02
    assert disturbance(soil, particles, 1.8) > 100 * calm
    assert disturbance(soil, particles, 4.0) == math.inf


@pytest.mark.parametrize(
    ('grains', 'cells', 'refused'),
    [(1, 1.9, False), (1, 2.1, True), (2, 0.6, False), (9, 0.6, True)],
)
def test_soil_too_fast_for_the_exchange_is_an_error(grains, cells, refused):
    """A single grain may fly 2 cells between exchanges; more than one in a thousand half a cell."""
    exchange = 1.0 / 180.0
    simulation = small.simulation(small.BLADE, 1, exchange=exchange)
    # Side by side above the bed, away from blade and walls; three exchanges a frame, to stay so.
    middle = [0.6, BOX.surface, BOX.z_middle]
    places = middle + 0.05 * np.array([[0.0, 0.0, n - (grains - 1) / 2] for n in range(grains)])
    particles = simulation.particles
    for place in places:
        grain = np.argmin(np.linalg.norm(particles[:, :3] - place, axis=1))
        particles[grain, 1] += 0.16
        particles[grain, columns.V] = -cells * simulation.grid.dx / exchange
    if not refused:
        simulation.frame()
        return
    with pytest.raises(ValueError, match='cells between two exchanges'):
        simulation.frame()
