"""Which run goes to which split, and which are chosen of many."""

import pytest

from pca_tools import splits
from pca_tools.metadata import SPLITS

SHARES = (0.8, 0.1, 0.1)


@pytest.mark.parametrize('count, sizes', [(200, (160, 20, 20)), (40, (32, 4, 4)), (5, (3, 1, 1))])
def test_split_deals_every_case_once(count, sizes):
    cases = [f'case {index}' for index in range(count)]
    parts = splits.split_cases(cases, SHARES, seed=3)
    assert tuple(len(parts[name]) for name in SPLITS) == sizes
    assert sorted(sum(parts.values(), [])) == list(range(count))
    assert splits.split_cases(cases, SHARES, seed=3) == parts
    assert count < 10 or splits.split_cases(cases, SHARES, seed=4) != parts


def test_held_out_cases_are_tested():
    cases = list(range(100, 140))
    parts = splits.split_cases(cases, SHARES, 0, ['101', '139'])
    assert {1, 39} <= set(parts['test']) and len(parts['test']) == 4
    many = splits.split_cases(cases, SHARES, 0, cases[:7])
    assert many['test'] == list(range(7)) and len(many['valid']) == 4
    whole = splits.split_cases(cases, (1.0, 0.0, 0.0), 0)
    assert whole == {'train': list(range(40)), 'valid': [], 'test': []}


@pytest.mark.parametrize(
    'fractions, hold_out, text',
    [
        ((0.8, 0.1), (), 'must be 3 shares that sum to 1'),
        ((0.8, 0.1, 0.2), (), 'must be 3 shares that sum to 1'),
        (SHARES, (7,), r"hold_out names \['7'\]"),
        (SHARES, (0, 1), 'do not fill the shares'),
    ],
)
def test_impossible_splits(fractions, hold_out, text):
    with pytest.raises(ValueError, match=text):
        splits.split_cases([0, 1, 2], fractions, 0, hold_out)
