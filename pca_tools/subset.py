"""Makes a smaller dataset: fewer training runs, all of valid and test as they are.

For learning curves, and to see what a kind of path teaches. Subspace, statistics and sampled
particles stay those of the larger dataset, so errors of both are of one truth.

Examples:
    python -m pca_tools.subset --data_path=datasets/excavation_v2 --train_runs=28 --output_path=few
    python -m pca_tools.subset --data_path=datasets/excavation_v2 --kinds=grid --output_path=grid
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

from absl import app, flags

from pca_tools import convert, files, particles
from pca_tools.append import numbered, read_encoded
from pca_tools.encode import make_metadata
from pca_tools.splits import spread_over


def subset(
    data_path: str,
    output_path: str,
    train_runs: int = 0,
    kinds: Sequence[str] = (),
    overwrite: bool = False,
) -> dict[str, Any]:
    """Writes a dataset with fewer training runs.

    Args:
        data_path: a dataset of `convert` with a particle sample.
        output_path: the smaller one.
        train_runs: so many, spread over those of the kinds; 0: all of them.
        kinds: of training runs; none: all.
        overwrite: replace a finished dataset.

    Returns:
        Its metadata.

    Raises:
        FileNotFoundError: a file is missing.
        ValueError: a kind that the dataset does not have, or fewer runs than are asked for.
    """
    convert.refuse_occupied_output(output_path, overwrite)
    base, space = convert.load_base(data_path)
    held = read_encoded(data_path, base)
    found = [run.parameters.get('kind') or 'run' for run in held['train']]
    if unknown := set(kinds) - set(found):
        raise ValueError(f'{data_path}: trains on no {sorted(unknown)}, only {sorted(set(found))}')
    chosen = [run for run, kind in zip(held['train'], found) if not kinds or kind in kinds]
    if not 0 <= train_runs <= len(chosen):
        raise ValueError(
            f'{data_path}: has {len(chosen)} such training runs, {train_runs} were asked for'
        )
    places = spread_over(len(chosen), train_runs)
    parts = held | {'train': numbered([chosen[place] for place in places])}
    world = {key: base[key] for key in ('scene', 'bounds', 'dt')}
    metadata = make_metadata(world, parts, space, 1, base)
    indices = particles.read_sample(data_path, 'train').indices
    convert.write_dataset(output_path, parts, space, indices, metadata, overwrite)
    return metadata


def define_flags() -> None:
    """Defines the flags; not at import, so that several commands can be imported together."""
    flags.DEFINE_string('data_path', None, 'Dataset folder.', required=True)
    flags.DEFINE_string('output_path', None, 'Folder of the smaller dataset.', required=True)
    flags.DEFINE_integer('train_runs', 0, 'Training runs, spread over all; 0: all.', lower_bound=0)
    flags.DEFINE_list('kinds', [], 'Kinds of training runs; default: all.')
    flags.DEFINE_bool('overwrite', False, 'Replace a finished dataset.')


def main(argv: Sequence[str]) -> None:
    """Runs the command."""
    if len(argv) > 1:
        raise app.UsageError(f'unknown arguments: {argv[1:]}')
    values = flags.FLAGS
    try:
        metadata = subset(
            values.data_path, values.output_path, values.train_runs, values.kinds, values.overwrite
        )
    except (ValueError, OSError) as error:
        sys.exit(f'error: {files.printable(error)}')
    print(convert.summary(metadata, values.output_path))


if __name__ == '__main__':
    define_flags()
    app.run(main)
