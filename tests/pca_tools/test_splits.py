"""Which runs are chosen of many."""

from pca_tools import splits


def test_runs_are_spread_over_all():
    assert splits.spread_over(10, 0) == splits.spread_over(10, 12) == list(range(10))
    assert splits.spread_over(10, 5) == [1, 3, 5, 7, 9]
    assert splits.spread_over(9, 3) == [1, 4, 7]
