"""Bounds on made-up errors."""

import numpy as np
import pytest

from learning_to_simulate import error_bound


def made_up_runs(rng, count):
    """Errors that grow with spread and size, each run with a luck of its own."""
    runs = []
    for _ in range(count):
        spreads, sizes = rng.uniform(0, 2, (2, 60))
        luck = rng.lognormal(sigma=0.3)
        errors = luck * (0.2 + spreads + 0.5 * sizes) * rng.lognormal(sigma=0.2, size=60)
        runs.append((errors, spreads, sizes))
    return runs


def kept(runs, weights):
    """Share [n] of the frames of each run within their bound."""
    return np.array([(e <= error_bound.bound(s, z, weights)).mean() for e, s, z in runs])


@pytest.mark.parametrize('count', [11, 30])
def test_nine_of_ten_new_runs_have_95_percent_of_their_frames_within(count):
    rng = np.random.default_rng(0)
    held, ratio = [], []
    for _ in range(150):
        weights = error_bound.calibrate(made_up_runs(rng, count))
        fresh = made_up_runs(rng, 20)
        held.append((kept(fresh, weights) >= 0.95).mean())
        ratio.append([error_bound.bound(s, z, weights).mean() / e.mean() for e, s, z in fresh])
    assert 0.88 < np.mean(held) < 0.96
    assert np.median(ratio) < 3  # no bound that says nothing


def test_few_runs_give_the_bound_of_the_worst_of_them():
    runs = made_up_runs(np.random.default_rng(1), 5)
    weights = error_bound.calibrate(runs)
    shares = kept(runs, weights)
    assert shares.min() >= 0.95 and (shares < 1.0).any()
