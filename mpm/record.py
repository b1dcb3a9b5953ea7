"""Makes the data of record: all runs that the datasets and models of this project come from.

    python -m mpm.record --output_path=raw --num_processes=2
    python -m mpm.record --list
    python -m mpm.record --output_path=raw --parts=operator --expect=digests.json
    python -m mpm.record --output_path=raw --held=datasets/excavation,datasets/wheel
    python -m mpm.record --output_path=raw --splits=valid,test

Raw runs go to OUTPUT_PATH/excavation and OUTPUT_PATH/wheel (and folders inside for other bins),
part by part in the order of `PARTS`, so that what teaches most is there first; `mpm/README.md` says
what the kinds of runs are.

Any beginning of a part holds kinds and splits in proportion. A command that was interrupted,
in whatever way, goes on where it stopped when it is given again. `digests.json` in each folder
tells the content of each run by its id: same seed, same bits (on one kind of processor with the
same Numba; another may round differently). `--expect` compares with the digests of somebody
else and names the runs that differ.
"""

import os
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from absl import flags, logging

from mpm import raw_run, scenes, splits
from mpm.generate import define_place_flags
from mpm.motions import catalogue, machine_drives, operator_paths, wheel_drives
from pca_tools import command
from pca_tools.files import read_json, write_json

# Kinds of which each is a part.
_ALONE = ('beside', 'soils', 'tools', 'trench', 'spread', 'backdrag', *operator_paths.BRIEF,
          'scoop', 'plunge', 'buckets')  # fmt: skip
# Part -> (scene, kinds that take turns; none: the cases of the grid).
PARTS = {
    'operator': (scenes.EXCAVATION, (*operator_paths.TURNS, 'halts')),
    'machine': (scenes.EXCAVATION, machine_drives.KINDS),
    **{kind: (scenes.EXCAVATION, (kind,)) for kind in _ALONE},
    'excavation_grid': (scenes.EXCAVATION, ()),
    'wheel_free': (scenes.WHEEL, wheel_drives.TURNS),
    'wheel_height': (scenes.WHEEL, ('height',)),
    **{kind: (scenes.WHEEL, (kind,)) for kind in ('wheels', 'grousers')},
    **{f'wheel_{kind}': (scenes.WHEEL, (kind,)) for kind in ('brief', 'rut', 'tow')},
    'wheel_grid': (scenes.WHEEL, ()),
}
DIGESTS = 'digests.json'


class Selection(NamedTuple):
    """Which runs of a part are meant."""

    limit: int | None = None  # runs, from the beginning of what the others leave
    held: Mapping[str, set[str]] = MappingProxyType({})  # of `held_by`; these are left out
    splits: Sequence[str] = splits.SPLITS


ALL = Selection()


def runs_of(part: str, selection: Selection = ALL) -> tuple:
    """Returns the ids of the selected runs of a part, in the order in which they are made;
    ValueError if there is no such part or split."""
    if part not in PARTS:
        raise ValueError(f'unknown part {part!r}; there are {", ".join(PARTS)}')
    if unknown := set(selection.splits) - set(splits.SPLITS):
        raise ValueError(f'unknown splits {sorted(unknown)}; there are {", ".join(splits.SPLITS)}')
    scene, kinds = PARTS[part]
    cases = splits.runs_of_kinds(scene, kinds) if kinds else splits.grid_runs(scene)
    left_out = selection.held.get(scene.name, set())
    chosen = [
        case
        for case in cases
        if str(case) not in left_out and splits.split_of(scene, case) in selection.splits
    ]
    return tuple(chosen[: selection.limit])


def held_by(datasets) -> dict[str, set[str]]:
    """Returns scene -> ids of the runs that datasets of the converter hold; FileNotFoundError,
    ValueError for a folder without `metadata.json` or one that names no scene and cases."""
    held: dict[str, set[str]] = {}
    for folder in datasets:
        path = os.path.join(folder, 'metadata.json')
        metadata = read_json(path)
        try:
            cases = {str(run['case']) for runs in metadata['cases'].values() for run in runs}
            held.setdefault(metadata['scene']['name'], set()).update(cases)
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f'{path}: names no scene and cases of runs') from error
    return held


def table(parts, selection: Selection = ALL) -> str:
    """Returns what the selected runs of the parts are, by kind and split, as text."""
    counted = {part: runs_of(part, selection) for part in parts}
    lines = [f'{"part":<16}{"kind":<11}{"runs":>5}' + ''.join(f'{s:>7}' for s in splits.SPLITS)]
    for part, cases in counted.items():
        scene, _ = PARTS[part]
        counts: dict[str, Counter] = {}
        for case in cases:
            kind = 'grid' if isinstance(case, int) else catalogue.parse(scene, case)[0]
            counts.setdefault(kind, Counter())[splits.split_of(scene, case)] += 1
        for kind, by_split in counts.items():
            cells = ''.join(f'{by_split[split]:>7}' for split in splits.SPLITS)
            lines.append(f'{part:<16}{kind:<11}{by_split.total():>5}{cells}')
    return '\n'.join(lines)


def digests_of(folder: str) -> dict[str, str]:
    """Returns the id of each run of a folder and of those inside, and the digest of its content."""
    found = {}
    for inside in (folder, *(entry.path for entry in os.scandir(folder) if entry.is_dir())):
        manifest = raw_run.read_manifest(inside)
        found |= {str(run['case']): run['content'] for run in (manifest or {'runs': []})['runs']}
    return dict(sorted(found.items()))


def make(
    parts, output_path: str, num_processes: int, selection: Selection = ALL, where: str = ''
) -> dict[str, dict]:
    """Makes the selected runs of the parts that are not there yet; returns scene -> run -> digest.

    A part whose runs fail does not keep the next from being made; in the end they are a ValueError,
    as an unknown part or split is. Others as `batch.generate`.
    """
    from mpm.batch import generate  # help does not wait for Numba
    from mpm.simulation import Settings

    failures = []
    for part, cases in {part: runs_of(part, selection) for part in parts}.items():
        scene, _ = PARTS[part]
        folder = os.path.join(output_path, scene.name)
        started = time.time()
        try:
            new = generate(scene, cases, folder, Settings(), num_processes, where=where)
        except ValueError as error:
            failures.append(f'{part}: {error}')
            continue
        print(f'{part}: {len(new)} new runs in {folder}; {time.time() - started:.0f} s', flush=True)
    found = {}
    for name in dict.fromkeys(PARTS[part][0].name for part in parts):
        folder = os.path.join(output_path, name)
        if os.path.isdir(folder):
            found[name] = digests_of(folder)
            write_json(os.path.join(folder, DIGESTS), {name: found[name]}, indent=0)
    if failures:
        raise ValueError('\n'.join(failures))
    return found


def define_flags() -> None:
    define_place_flags()
    flags.DEFINE_list('parts', list(PARTS), f'Which parts, in their order: {",".join(PARTS)}.')
    flags.DEFINE_integer(
        'limit', None, 'Only this many runs from the beginning of each part.', lower_bound=1
    )
    flags.DEFINE_string('expect', None, 'Digests to compare with, a JSON file.')
    flags.DEFINE_list('held', [], 'Datasets whose runs are not made again.')
    names = ','.join(splits.SPLITS)
    flags.DEFINE_list('splits', list(splits.SPLITS), f'Only runs of these splits: {names}.')
    flags.DEFINE_bool('list', False, 'Only say what would be made.')


def main(values) -> int:
    """Returns 1 if runs differ from those that are expected."""
    selection = Selection(values.limit, held_by(values.held), values.splits)
    if values.list:
        print(table(values.parts, selection))
        return 0
    if values.output_path is None:
        raise ValueError('give --output_path, or --list to see what would be made')
    expected = read_json(values.expect) if values.expect else {}
    if not isinstance(expected, dict) or not all(isinstance(v, dict) for v in expected.values()):
        raise ValueError(f'{values.expect}: holds no digests (scene -> run -> digest)')
    where = values.output_path, values.num_processes, selection, values.cluster
    found, code = make(values.parts, *where), 0
    for name, digests in found.items():
        both = digests.keys() & expected.get(name, {}).keys()
        other = sorted(case for case in both if digests[case] != expected[name][case])
        same = f', {len(both) - len(other)} as expected' if expected else ''
        print(f'{name}: {len(digests)} runs{same}')
        if other:
            logging.error('%s: %d runs differ: %s', name, len(other), ', '.join(other[:20]))
            code = 1
    return code


if __name__ == '__main__':
    define_flags()
    command.start(main)
