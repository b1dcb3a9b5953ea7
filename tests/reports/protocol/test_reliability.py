"""Bounds of methods of several seeds on made-up runs whose errors are known."""

import dataclasses
import types

import numpy as np
import pytest

from learning_to_simulate import soil_truth
from reports.protocol import reliability
from reports.protocol.run_errors import RunPrediction

FRAMES, PARTICLES, SEEDS = np.arange(6, 46, 2), 40, 4


def made_up(rng, off, differ):
    """A truth and seeds that are off by `off` (m and N) together, and by `differ` each."""
    start = rng.normal(size=(PARTICLES, 3))
    moved = rng.normal(scale=0.01, size=(len(FRAMES), PARTICLES, 3))
    force = rng.normal(scale=100.0, size=(FRAMES[-1] - 5, 3))
    soil = dataclasses.replace(
        soil_truth.of_nodes(np.zeros((50, PARTICLES, 3)), PARTICLES),
        frames=FRAMES, particles=start + moved, start=start,
    )  # fmt: skip
    truth = types.SimpleNamespace(soil=soil, force=force, record=0)
    signs = np.array([1.0, -1.0] * (SEEDS // 2))

    def predict(sign):
        own = {'predicted_particles': soil.particles + off + sign * differ,
               'particle_frames': FRAMES, 'particle_indices': np.arange(PARTICLES)}  # fmt: skip
        return RunPrediction(own=own, force=force + 1e3 * (off + sign * differ))

    return truth, [predict(sign) for sign in signs], moved


def test_errors_are_those_of_the_mean_and_spreads_those_of_the_seeds():
    truth, seeds, moved = made_up(np.random.default_rng(0), 0.002, 0.0005)
    found = reliability.run_signs(seeds, truth)
    errors, spreads, sizes = found['soil']
    np.testing.assert_allclose(errors, 2.0)
    np.testing.assert_allclose(spreads, 0.5)
    np.testing.assert_allclose(sizes, 1e3 * np.sqrt(((moved + 0.002) ** 2).mean(axis=(1, 2))))
    errors, spreads, sizes = found['force']
    np.testing.assert_allclose(errors, 2.0)
    np.testing.assert_allclose(spreads, 0.5)
    chosen = truth.force[FRAMES - 6] + 2.0
    np.testing.assert_allclose(sizes, np.sqrt((chosen**2).mean(axis=1)))
    (one,) = reliability.run_signs([RunPrediction(force=truth.force)], truth)
    assert one == 'force'


def runs_of(rng, count, factor=1.0):
    """Runs whose errors are a multiple of what their seeds differ by."""
    found = []
    for _ in range(count):
        differ = rng.uniform(1e-4, 3e-3)
        truth, seeds, _ = made_up(rng, factor * 2 * differ * rng.lognormal(sigma=0.2), differ)
        found.append(reliability.run_signs(seeds, truth)['soil'])
    return found


def test_a_bound_holds_on_runs_like_those_of_valid_and_fails_on_others():
    rng = np.random.default_rng(1)
    valid = runs_of(rng, 30)
    known = reliability.judged({'valid': valid, 'test': runs_of(rng, 40)}, 'soil')
    assert known['runs_within'] >= 0.8 and known['within'] >= 0.8
    assert known['error'] < known['bound'] < 3 * known['error']
    # What the seeds say is used: the bound goes with the error.
    assert known['curve'][-1]['bound'] > 3 * known['curve'][0]['bound']
    worse = reliability.judged({'valid': valid, 'test': runs_of(rng, 40, factor=3.0)}, 'soil')
    assert worse['runs_within'] < 0.3 and worse['error'] > worse['bound']


@pytest.mark.parametrize('bad', [np.nan, np.inf])
def test_what_is_not_finite_has_no_bound(bad):
    rng = np.random.default_rng(2)
    valid, test = runs_of(rng, 3), runs_of(rng, 2)
    test[1] = (bad * test[1][0], *test[1][1:])
    assert reliability.judged({'valid': valid, 'test': test}, 'soil') is None
    assert reliability.judged({'valid': valid, 'test': []}, 'soil') is None
