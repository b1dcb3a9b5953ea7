"""The data of record: which runs, in which order, and which split each belongs to.

The split of a run is a function of its id alone. Seeds that the data of record does not hold
belong to none: nothing has been trained or chosen on them.
"""

from mpm import scenes
from mpm.motions import catalogue

SPLITS = ('train', 'valid', 'test')
# Scene -> split -> cases of the grid, in the order in which they are made. A path of the tool in
# time is in one split alone. The blade's is given by depth, speed and motion, the angle aside: 40
# of these 50 paths, each with one angle (that of a published case where there is one). The wheel's
# is given by slip and diameter: a Latin square has three of these nine pairs for test, one for
# valid.
GRID = {
    'excavation': {
        'train': (186, 47, 102, 118, 231, 22, 224, 64, 154, 213, 40, 206, 85, 1, 189, 123, 172,
                  134, 78, 53, 161, 137, 99, 12, 141),
        'valid': (157, 119, 15, 67, 209),
        'test': (168, 146, 105, 216, 60, 82, 130, 8, 33, 193),
    },
    'wheel': {
        'train': (112, 27, 56, 111, 154, 63, 9, 151, 122, 107, 129, 123, 7, 37, 203, 79, 25, 137,
                  119),
        'valid': (103, 15, 5, 23, 13),
        'test': (3, 11, 21, 19, 134, 1, 149, 140, 117, 125, 58, 44, 78, 83, 91, 141),
    },
}  # fmt: skip
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
        'gravity': 40,
        'scoop': 30,
        'plunge': 40,
        'buckets': 60,
    },
    'wheel': {
        **dict.fromkeys(('slip', 'stops', 'reverse', 'load'), 30),
        'height': 60,
        'wheels': 40,
        'grousers': 30,
        'brief': 300,
        'rut': 40,
        'tow': 60,
    },
}
# Further runs, all of `train`, whose seeds follow those of `RUNS`: short ones, each with a tool and
# a soil of its own, because what differs between runs is what a model must learn; and blades that
# are set down: of the first 15 for training two are heavy and fall.
MORE = {
    'excavation': {'brief': 180, 'gravity': 60, 'scoop': 30, 'free': 120, 'buckets': 34},
    'wheel': {},
}
TEST, VALID = 10, 5  # runs of each kind


def split_of(scene: scenes.Scene, case: int | str) -> str | None:
    """Returns 'train', 'valid' or 'test'; None for what the data of record does not hold.

    Seeds: of the n runs of a kind every (n // 10)th is test, every (n // 5)th valid, until there
    are 10 and 5 of them; those of `MORE` are for training. Cases of the grid: see `GRID`.
    """
    if isinstance(case, int):
        return next((split for split, cases in GRID[scene.name].items() if case in cases), None)
    try:
        kind, seed = catalogue.parse(scene, case)
    except ValueError:
        return None
    count = RUNS[scene.name].get(kind, 0)
    if seed >= count:
        return 'train' if seed < count + MORE[scene.name].get(kind, 0) else None
    every = count // TEST
    if seed % every == 1 and seed // every < TEST:
        return 'test'
    # Seed 3 of every 2 n, or 2 of every 4 where every second run (n = 2) is test.
    if seed % (2 * every) == (2 if every == 2 else 3) and seed // (2 * every) < VALID:
        return 'valid'
    return 'train'


def runs_of_kinds(scene: scenes.Scene, kinds: tuple) -> tuple:
    """Returns the ids of the record's runs of some kinds, which take turns."""
    more = MORE[scene.name]
    counts = {kind: RUNS[scene.name][kind] + more.get(kind, 0) for kind in kinds}
    return tuple(
        catalogue.seed_case(kind, seed)
        for seed in range(max(counts.values()))
        for kind in kinds
        if seed < counts[kind]
    )


def grid_runs(scene: scenes.Scene) -> tuple:
    """Returns the cases of the grid that the record holds, test and valid spread among them."""
    placed = [
        ((n + 0.5) / len(cases), case)
        for cases in GRID[scene.name].values()
        for n, case in enumerate(cases)
    ]
    return tuple(case for _, case in sorted(placed))
