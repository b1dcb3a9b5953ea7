"""The data of record: which runs, in which order, and which split each belongs to.

The split of a run is a function of its id alone. Seeds that the data of record does not hold
belong to none: nothing has been trained or chosen on them.
"""

import functools
import itertools

import numpy as np

from mpm import scenes
from mpm.motions import catalogue

SPLITS = ('train', 'valid', 'test')
GRID_RUNS = {'excavation': 40, 'wheel': 40}
# Runs of each kind, numbered from seed 0 on: 10 of them are test, 5 valid.
RUNS = {
    'excavation': {
        **dict.fromkeys(('smooth', 'stops', 'reverse', 'lift', 'disturbed', 'halts'), 34),
        **dict.fromkeys(('press', 'free', 'actuated'), 30),
        **dict.fromkeys(('beside', 'soils', 'tools'), 60),
        'trench': 30,
        'spread': 60,
        'backdrag': 60,
        'brief': 60,
    },
    'wheel': {
        **dict.fromkeys(('slip', 'stops', 'reverse', 'load'), 30),
        'height': 60,
        'wheels': 40,
        'grousers': 30,
        'brief': 300,
        'rut': 40,
    },
}
TEST, VALID = 10, 5  # runs of each kind


def split_of(scene: scenes.Scene, case: int | str) -> str | None:
    """Returns 'train', 'valid' or 'test'; None for what the data of record does not hold.

    Seeds: of the n runs of a kind every (n // 10)th is test, every (n // 5)th valid, until there
    are 10 and 5 of them. Cases of the grid: see `grid_splits`.
    """
    if isinstance(case, int):
        return grid_splits(scene.name).get(case)
    try:
        kind, seed = catalogue.parse(scene, case)
    except ValueError:
        return None
    count = RUNS[scene.name].get(kind, 0)
    if seed >= count:
        return None
    every = count // TEST
    if seed % every == 1 and seed // every < TEST:
        return 'test'
    # Beside those of test: 3 of every 2 n, or 2 of every 4 where every second run is test.
    if seed % (2 * every) == (2 if every == 2 else 3) and seed // (2 * every) < VALID:
        return 'valid'
    return 'train'


@functools.cache
def grid_splits(name: str) -> dict[int, str]:
    """Returns case -> split of the cases of a scene's grid that the record holds.

    A path of the tool in time is in one split alone. The blade's is given by depth, speed and
    motion, the angle aside: 40 of these 50 paths, each with one angle (that of a published case
    where there is one). The wheel's is given by slip and diameter: a Latin square has three of
    these nine pairs for test, one for valid.
    """
    scene, found = scenes.SCENES[name], {}
    chosen = [*scene.published, scene.demo_case]
    if name == 'wheel':
        chosen += [case for case in scenes.mini_cases(scene, 60) if case not in chosen]
        for case in chosen[: GRID_RUNS[name]]:
            _, slip, _, diameter, _ = np.unravel_index(case - 1, (3,) * 5)
            is_valid = (slip, diameter) == (0, 1)
            found[case] = 'test' if (slip + diameter) % 3 == 0 else 'valid' if is_valid else 'train'
        return found
    for number, (depth, speed, motion) in enumerate(itertools.product(range(5), range(5), (0, 1))):
        angle = (depth + 2 * speed + 3 * motion) % 5
        if number % 5 != 4:
            chosen.append(1 + ((depth * 5 + speed) * 5 + angle) * 2 + motion)
    paths: dict[tuple, int] = {}
    for case in chosen:
        depth, speed, _, motion = np.unravel_index(case - 1, (5, 5, 5, 2))
        paths.setdefault((int(depth), int(speed), int(motion)), case)
    for number, case in enumerate(sorted(paths.values())[: GRID_RUNS[name]]):
        found[case] = 'test' if number % 4 == 1 else 'valid' if number % 8 == 3 else 'train'
    return found


def runs_of_kinds(scene: scenes.Scene, kinds: tuple) -> tuple:
    """Returns the ids of the record's runs of some kinds, which take turns."""
    counts = RUNS[scene.name]
    return tuple(
        catalogue.seed_case(kind, seed)
        for seed in range(max(counts[kind] for kind in kinds))
        for kind in kinds
        if seed < counts[kind]
    )


def grid_runs(scene: scenes.Scene) -> tuple:
    """Returns the cases of the grid that the record holds, test and valid spread among them."""
    rng = np.random.default_rng(0)
    placed = []
    for split in SPLITS:
        cases = [case for case, other in grid_splits(scene.name).items() if other == split]
        rng.shuffle(cases)
        placed += [((n + 0.5) / len(cases), case) for n, case in enumerate(cases)]
    return tuple(case for _, case in sorted(placed))
