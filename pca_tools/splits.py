"""Which run goes to which split."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pca_tools.metadata import SPLITS


def given_splits(
    cases: Sequence[int | str],
    given: Sequence[object],
    hold_out: Sequence[int | str] = (),
    need_train: bool = True,
) -> dict[str, list[int]] | None:
    """Deals cases to the splits that they themselves name.

    Args:
        cases: case ids.
        given: what each names as its split (`parameters['split']` of a raw run), None if nothing.
        hold_out: ids that go to test whatever they name.
        need_train: whether there must be one in train.

    Returns:
        split -> indices into `cases`, ascending; None if no case names one.

    Raises:
        ValueError: unknown names or ids, some that name none, or none in train.
    """
    if all(split is None for split in given):
        return None
    held = _known_ids(hold_out, cases)
    parts: dict[str, list[int]] = {split: [] for split in SPLITS}
    faults = []
    for index, (case, split) in enumerate(zip(cases, given)):
        if str(case) in held:
            parts['test'].append(index)
        elif split in SPLITS:
            parts[split].append(index)
        else:
            faults.append(f'{case}: {split!r}')
    if faults:
        raise ValueError(
            f'{len(faults)} of {len(cases)} cases name no split of {SPLITS} in their parameters '
            f'({", ".join(faults[:5])}), the others do; give --split to deal all of them anew'
        )
    if need_train and not parts['train']:
        raise ValueError('no case names train as its split: there is nothing to fit a subspace to')
    return parts


def _known_ids(hold_out: Sequence[int | str], cases: Sequence[int | str]) -> set[str]:
    held = {str(case) for case in hold_out}
    unknown = held - {str(case) for case in cases}
    if unknown:
        raise ValueError(f'hold_out names {sorted(unknown)}, which are not among the cases')
    return held


def split_cases(
    cases: Sequence[int | str],
    fractions: Sequence[float],
    seed: int,
    hold_out: Sequence[int | str] = (),
) -> dict[str, list[int]]:
    """Deals cases to the splits by seed, without replacement.

    Args:
        cases: case ids.
        fractions: shares of train, valid and test, sum 1; each above 0 gets at least one case.
        seed: of the draw.
        hold_out: ids that go to test whatever the draw says; they count towards its share.

    Returns:
        split -> indices into `cases`, ascending.

    Raises:
        ValueError: shares that do not sum to 1, unknown ids, or too few cases.
    """
    if len(fractions) != len(SPLITS) or min(fractions) < 0 or abs(sum(fractions) - 1.0) > 1e-6:
        raise ValueError(f'split {list(fractions)} must be {len(SPLITS)} shares that sum to 1')
    held = _known_ids(hold_out, cases)
    shuffled = np.random.default_rng(seed).permutation(len(cases)).tolist()
    forced = [index for index in shuffled if str(cases[index]) in held]
    free = [index for index in shuffled if str(cases[index]) not in held]
    sizes = {
        split: max(round(share * len(cases)), 1) if share > 0 else 0
        for split, share in zip(SPLITS, fractions)
    }
    n_test, n_valid = max(sizes['test'] - len(forced), 0), sizes['valid']
    if n_test + n_valid >= len(free):
        raise ValueError(
            f'{len(cases)} cases with {len(forced)} held out do not fill the shares '
            f'{list(fractions)}; let the solver make more, or use --like to put them into '
            'an existing subspace'
        )
    return {
        'train': sorted(free[n_test + n_valid :]),
        'valid': sorted(free[n_test : n_test + n_valid]),
        'test': sorted(forced + free[:n_test]),
    }
