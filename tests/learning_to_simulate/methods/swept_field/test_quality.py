"""Bounds on made-up errors, and the status of single frames."""

import numpy as np

from learning_to_simulate.methods.swept_field import quality, tool_path
from learning_to_simulate.rollout_status import RolloutStatus


def made_up_runs(rng, count):
    """Errors that grow with spread and size, each run with a luck of its own."""
    runs = []
    for _ in range(count):
        spreads, sizes = rng.uniform(0, 2, (2, 60))
        luck = rng.lognormal(sigma=0.3)
        errors = luck * (0.2 + spreads + 0.5 * sizes) * rng.lognormal(sigma=0.2, size=60)
        runs.append((errors, spreads, sizes))
    return runs


def test_bounds_hold_for_95_percent_of_the_frames_of_new_runs():
    rng = np.random.default_rng(0)
    within, ratio = [], []
    for _ in range(40):
        weights = quality.calibrate(made_up_runs(rng, 25), 'soil')
        fresh = made_up_runs(rng, 20)
        within.append([(e <= quality.bound(s, z, weights)).mean() for e, s, z in fresh])
        ratio.append([quality.bound(s, z, weights).mean() / e.mean() for e, s, z in fresh])
    assert 0.95 <= np.mean(within) < 0.985
    assert np.median(ratio) < 3  # no bound that says nothing


def test_the_bound_of_few_runs_holds_for_all_their_frames():
    runs = made_up_runs(np.random.default_rng(1), 5)
    weights = quality.calibrate(runs, 'soil')
    ratio = np.concatenate([e / quality.bound(s, z, weights) for e, s, z in runs])
    np.testing.assert_allclose(ratio.max(), 1.0)
    groups = quality.reliability(runs, weights)
    assert len(groups) == 5 and all(g['within'] == 1.0 for g in groups)
    bounds = [g['bound'] for g in groups]
    assert bounds == sorted(bounds)


def test_each_frame_has_a_status():
    ranges = {name: [-1.0, 1.0] for name in tool_path.SCALARS}
    scalars = np.zeros((3, len(tool_path.SCALARS)))
    scalars[1, 2] = 1.2
    found = quality.statuses(scalars, ranges, np.array([True, True, False]))
    assert found == [RolloutStatus.OK, RolloutStatus.EXTRAPOLATING, RolloutStatus.NON_FINITE]
    judged = quality.judge(scalars, ranges, 5)
    assert judged.status == RolloutStatus.EXTRAPOLATING and judged.frame == 6
    assert 'lean 1.2 is outside' in judged.reason
