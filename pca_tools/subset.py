"""Makes a smaller dataset: fewer training runs, all of valid and test as they are or some kinds.

For learning curves, and to see what a kind of path teaches; `deal` writes all runs to other splits,
for cross-validation. Subspace, statistics and sampled particles stay those of the larger dataset,
so errors of both are of one truth.

Examples:
    python -m pca_tools.subset --data_path=datasets/excavation --train_runs=28 --output_path=few
    python -m pca_tools.subset --data_path=datasets/excavation --kinds=grid --output_path=grid
"""

from collections.abc import Mapping, Sequence
from typing import Any

from absl import flags

from pca_tools import command, convert, encode
from pca_tools.encode import EncodedRun
from pca_tools.metadata import SPLITS


def subset(
    data_path: str,
    output_path: str,
    train_runs: int = 0,
    kinds: Sequence[str] = (),
    overwrite: bool = False,
    every_split: bool = False,
) -> dict[str, Any]:
    """Writes a dataset with fewer training runs: `train_runs` of them (0: all) of some kinds (none:
    all), spread over all; valid and test, too, hold these kinds alone with `every_split`.

    Returns its metadata. FileNotFoundError: a file is missing. ValueError: a dataset without a
    particle sample or training runs, a kind or a number of runs that it does not have; a split
    without any, or no kinds, with `every_split`; an output that is occupied."""
    if every_split and not kinds:
        raise ValueError('every_split keeps some kinds of runs alone, but no kinds were named')
    encode.refuse_occupied_output(output_path, overwrite)
    whole = encode.load(data_path)
    train = whole.parts.get('train')
    if not train:
        raise ValueError(f'{data_path}: has no training runs to choose from, only {[*whole.parts]}')
    found = {_kind(run) for run in train}
    if unknown := set(kinds) - found:
        raise ValueError(f'{data_path}: trains on no {sorted(unknown)}, only {sorted(found)}')
    chosen = [run for run in train if not kinds or _kind(run) in kinds]
    if train_runs > len(chosen):
        raise ValueError(f'{data_path}: has {len(chosen)} such training runs, not {train_runs}')
    if train_runs:  # spread over all: files are often sorted by kind
        places = ((2 * n + 1) * len(chosen) // (2 * train_runs) for n in range(train_runs))
        chosen = [chosen[place] for place in places]
    parts = {**whole.parts, 'train': chosen}
    if every_split:
        others = [split for split in parts if split != 'train']
        parts |= {split: [r for r in parts[split] if _kind(r) in kinds] for split in others}
        if empty := [split for split in others if not parts[split]]:
            raise ValueError(f'{data_path}: {", ".join(empty)} without a run of {sorted(kinds)}')
    few = whole.with_parts(parts)
    encode.write(output_path, few, overwrite)
    return few.metadata


def deal(data_path: str, output_path: str, places: Mapping[str, Sequence[int]]) -> dict[str, Any]:
    """Writes a dataset of the same runs in other splits, for cross-validation, and returns its
    metadata; raises as `subset`. `places` is split -> its runs, counted through train, valid and
    test of the old dataset, whose subspace and statistics stay."""
    encode.refuse_occupied_output(output_path, False)
    whole = encode.load(data_path)
    runs = [run for split in SPLITS for run in whole.parts.get(split, [])]
    dealt = whole.with_parts(
        {split: [runs[place] for place in of_split] for split, of_split in places.items()}
    )
    encode.write(output_path, dealt, overwrite=False)
    return dealt.metadata


def _kind(run: EncodedRun) -> str:
    return run.parameters.get('kind') or 'run'


def define_flags() -> None:
    flags.DEFINE_string('data_path', None, 'Dataset folder.', required=True)
    flags.DEFINE_string('output_path', None, 'Folder of the smaller dataset.', required=True)
    flags.DEFINE_integer('train_runs', 0, 'Training runs, spread over all; 0: all.', lower_bound=0)
    flags.DEFINE_list('kinds', [], 'Kinds of training runs; default: all.')
    flags.DEFINE_bool('overwrite', False, 'Replace a finished dataset.')


def main(values) -> None:
    metadata = subset(
        values.data_path, values.output_path, values.train_runs, values.kinds, values.overwrite
    )
    print(convert.summary(metadata, values.output_path))


if __name__ == '__main__':
    define_flags()
    command.start_quietly(main)
