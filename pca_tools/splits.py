"""Which run goes to which split."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pca_tools.metadata import SPLITS


def split_cases(
    cases: Sequence[int | str],
    fractions: Sequence[float],
    seed: int,
    hold_out: Sequence[int | str] = (),
) -> dict[str, list[int]]:
    """Deals cases to the splits by a seeded shuffle, without replacement.

    Args:
        cases: case ids.
        fractions: shares of train, valid and test; sum 1. Every share above 0 gets at least one
            case.
        seed: of the shuffle.
        hold_out: ids that go to test whatever the shuffle says; they count towards its share.

    Returns:
        split -> indices into `cases`, ascending.

    Raises:
        ValueError: shares that do not sum to 1, unknown ids, or too few cases.
    """
    if len(fractions) != len(SPLITS) or min(fractions) < 0 or abs(sum(fractions) - 1.0) > 1e-6:
        raise ValueError(f'split {list(fractions)} must be {len(SPLITS)} shares that sum to 1')
    held = {str(case) for case in hold_out}
    unknown = held - {str(case) for case in cases}
    if unknown:
        raise ValueError(f'hold_out names {sorted(unknown)}, which are not among the cases')
    shuffled = np.random.default_rng(seed).permutation(len(cases)).tolist()
    forced = [index for index in shuffled if str(cases[index]) in held]
    free = [index for index in shuffled if str(cases[index]) not in held]
    sizes = {
        split: max(round(share * len(cases)), 1) if share > 0 else 0
        for split, share in zip(SPLITS, fractions)
    }
    take = max(sizes['test'] - len(forced), 0)
    test, valid, train = (
        forced + free[:take],
        free[take : take + sizes['valid']],
        free[take + sizes['valid'] :],
    )
    if not train or (fractions[1] > 0 and not valid):
        raise ValueError(
            f'{len(cases)} cases with {len(forced)} held out do not fill the shares '
            f'{list(fractions)}; let the solver make more, or use --like to put them into '
            'an existing subspace'
        )
    return {'train': sorted(train), 'valid': sorted(valid), 'test': sorted(test)}
