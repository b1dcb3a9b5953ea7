"""Bounds on made-up errors."""

import numpy as np
import pytest
from scipy import stats

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


@pytest.mark.parametrize('count, number', [(9, 9), (22, 22), (30, 29), (60, 57), (200, 185)])
def test_so_many_of_all_further_runs_keep_it_that_eight_of_ten_bounds_do(count, number):
    scores = np.random.default_rng(2).permutation(count) / count  # of a uniform law: shares
    assert error_bound.of_runs(scores) == (number - 1) / count
    # What is to come keeps the bound with the k-th of n uniform numbers: a beta law.
    kept = stats.beta(number, count + 1 - number).sf(0.9)
    one_less = stats.beta(number - 1, count + 2 - number).sf(0.9)
    assert (kept >= 0.8 or number == count) and one_less < 0.8


def test_a_kind_with_runs_enough_has_its_bound_too():
    scores = [1.0] * 70 + [2.0 + 0.01 * i for i in range(3)]
    assert error_bound.of_runs(scores) == 1.0
    assert error_bound.of_runs([*scores, *range(3, 12)], ['a'] * 73 + ['b'] * 9) == 11.0
    assert error_bound.of_runs([*scores[:70], 3.0, 4.0], ['a'] * 70 + ['b'] * 2) == 1.0
