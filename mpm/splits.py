"""The data of record: which runs, in which order, and which split each belongs to.

The split of a run is a function of its id alone. Seeds that the data of record does not hold
belong to none: nothing has been trained or chosen on them.
"""

import numpy as np

from mpm import scenes
from mpm.motions import catalogue

SPLITS = ('train', 'valid', 'test')
# Runs of each kind of free motion; seeds count through the kinds.
RUNS_PER_KIND = {'excavation': 50, 'wheel': 40}  # of the kinds that take turns
HALTS = 24  # runs of the blade that halts within a frame
# Of the n-th run of a kind: (divisor, remainder) that put it into test and into valid.
_TEST, _VALID = {'excavation': (5, 1), 'wheel': (6, 1)}, {'excavation': (12, 3), 'wheel': (8, 4)}


def split_of(scene: scenes.Scene, case: int | str) -> str | None:
    """Returns 'train', 'valid' or 'test'; None for what the data of record does not hold.

    Args:
        scene: the scene.
        case: the number of a case of the grid, or the id of a seed, or any other id.

    Seeds: of 50 blade paths of a kind 10 are test and 4 valid, of the 24 that halt 8 and 4, of 40
    wheel drives 7 and 5.
    Grids: a linear code over the levels, so that each level of each parameter is met equally often
    in test and in valid: excavation 25 and 25 of 250 (each pair of depth and speed once), wheel 27
    and 27 of 243. The demo cases are test cases.
    """
    if isinstance(case, int):
        return _excavation_split(case) if scene.name == 'excavation' else _wheel_split(case)
    try:
        kind, seed = catalogue.parse(scene, case)
    except ValueError:
        return None
    kinds = catalogue.TURNS[scene.name]
    if kind not in kinds:
        return _split_of_halt(seed) if seed < HALTS else None
    number = seed // len(kinds)
    # The record holds each seed with one kind.
    if number >= RUNS_PER_KIND[scene.name] or kinds[seed % len(kinds)] != kind:
        return None
    for split, rule in (('test', _TEST), ('valid', _VALID)):
        divisor, remainder = rule[scene.name]
        if number % divisor == remainder:
            return split
    return 'train'


def _split_of_halt(seed: int) -> str:
    if seed % 3 == 1:
        return 'test'
    return 'valid' if seed % 6 == 3 else 'train'


def _excavation_split(case: int) -> str:
    depth, speed, angle, motion = np.unravel_index(case - 1, (5, 5, 5, 2))
    code = (depth + 2 * speed + 4 * angle) % 5
    if motion != (depth + speed) % 2 or code not in (4, 1):
        return 'train'
    return 'test' if code == 4 else 'valid'


def _wheel_split(case: int) -> str:
    gravity, slip, load, diameter, friction = np.unravel_index(case - 1, (3,) * 5)
    code = (gravity + slip + load) % 3, (gravity + diameter + friction) % 3
    return {(0, 0): 'test', (1, 2): 'valid'}.get(code, 'train')


def seed_runs(scene: scenes.Scene) -> tuple:
    """Returns the ids of the record's runs with free motions, in the order of their seeds.

    Kinds take turns and splits are spread: any beginning of the list is a set in proportion.
    """
    count = RUNS_PER_KIND[scene.name] * len(catalogue.TURNS[scene.name])
    return catalogue.select_seeds(scene, f'0-{count - 1}')


def halt_runs(scene: scenes.Scene) -> tuple:
    """Returns the ids of the record's runs of the kind `halts`, in the order of their seeds."""
    return catalogue.select_seeds(scene, f'0-{HALTS - 1}', 'halts')


def grid_runs(scene: scenes.Scene) -> tuple:
    """Returns all cases of the grid, in an order of which any beginning is a set in proportion.

    Each split is shuffled (seed 0); the splits are then merged in proportion to their size.
    """
    rng = np.random.default_rng(0)
    placed = []
    for split in SPLITS:
        cases = [c for c in range(1, scene.case_count + 1) if split_of(scene, c) == split]
        rng.shuffle(cases)
        placed += [((n + 0.5) / len(cases), case) for n, case in enumerate(cases)]
    return tuple(case for _, case in sorted(placed))
