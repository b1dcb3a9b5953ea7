"""Parts of a dataset as datasets of their own: fewer training runs, and folds of a dozen runs."""

import os

from pca_tools import dataset, files, subset
from pca_tools.metadata import SPLITS
from pca_tools.splits import spread_over

_DONE = 'folds.json'


def of_size(data_path: str, size: int, folder: str) -> str:
    """A dataset with `size` training runs, spread over all, or finds it there; returns its path.

    Subspace, valid and test stay as they are.

    Raises:
      ValueError: fewer training runs than that.
    """
    path = os.path.join(folder, f'{os.path.basename(os.path.abspath(data_path))}_{size}')
    if files.check_manifest(path) is None:
        subset.subset(data_path, path, size, overwrite=True)
    return path


def deal(n_run: int, n_fold: int, n_valid: int) -> list[dict[str, list[int]]]:
    """Deals runs to the splits of each fold.

    Args:
      n_run: how many there are. Neighbours may be alike (cases count through a grid), so a fold
        takes every `n_fold`-th.
      n_fold: folds.
      n_valid: runs of a fold's training that choose; spread over them.

    Returns:
      of each fold, split -> places of its runs; each run is once in 'test'.

    Raises:
      ValueError: fewer than two folds, or too few runs to train, choose and judge in each.
    """
    if not 2 <= n_fold <= n_run:
        raise ValueError(f'{n_fold} folds of {n_run} runs; at least 2 and at most as many as runs')
    folds = []
    for fold in range(n_fold):
        rest = [run for run in range(n_run) if run % n_fold != fold]
        if not 1 <= n_valid < len(rest):
            raise ValueError(f'{n_valid} runs of {len(rest)} that are not judged cannot be valid')
        chosen = {rest[place] for place in spread_over(len(rest), n_valid)}
        folds.append(
            {
                'train': [run for run in rest if run not in chosen],
                'valid': sorted(chosen),
                'test': list(range(fold, n_run, n_fold)),
            }
        )
    return folds


def folds(data_path: str, n_fold: int, n_valid: int, folder: str) -> list[str]:
    """Datasets of the folds, or finds them there; returns their paths.

    Args:
      data_path: a dataset of `pca_tools.convert`; the runs of all its splits are dealt.
      n_fold, n_valid: of `deal`.
      folder: for the folds.

    Raises:
      ValueError: as of `deal`, or other folds in `folder`.
    """
    paths = [dataset.split_path(data_path, split) for split in SPLITS]
    paths = [path for path in paths if os.path.exists(path)]
    n_run = sum(len(dataset.read_split(data_path, _split(path))) for path in paths)
    dealt = deal(n_run, n_fold, n_valid)
    facts = {'folds': dealt, 'digests': [files.sha256_of_file(path) for path in paths]}
    name = os.path.basename(os.path.abspath(data_path))
    found = [os.path.join(folder, f'{name}_fold_{fold}') for fold in range(n_fold)]
    os.makedirs(folder, exist_ok=True)
    marker = os.path.join(folder, _DONE)
    if os.path.exists(marker):
        if files.read_json(marker) != facts:
            raise ValueError(f'{folder}: holds folds of other runs or another number of them')
        return found
    for path, parts in zip(found, dealt, strict=True):
        if files.check_manifest(path) is None:
            subset.deal(data_path, path, parts)
    files.write_json(marker, facts)
    return found


def _split(path):
    return os.path.basename(path).removesuffix('.tfrecord')


def joined(documents: list[dict]) -> dict:
    """The protocol over all folds: every run judged once, by models that did not see it.

    Args:
      documents: of the folds, without what `tables.complete` adds; the same methods in each.

    Returns:
      one of them with the runs of all. What was fitted (`about`) differs between folds and is
      left out.
    """
    first = documents[0]
    methods = []
    for place, method in enumerate(first['methods']):
        of_folds = [document['methods'][place] for document in documents]
        seeds = [
            seed
            | {
                'runs': {
                    split: [run for m in of_folds for run in m['seeds'][number]['runs'][split]]
                    for split in seed['runs']
                }
            }
            for number, seed in enumerate(method['seeds'])
        ]
        methods.append({'name': method['name'], 'baseline': method['baseline'], 'seeds': seeds})
    runs = {split: [run for d in documents for run in d['runs'][split]] for split in first['runs']}
    keys = 'schema_version', 'scene', 'record', 'data'
    return {k: first[k] for k in keys} | {
        'folds': len(documents), 'runs': runs, 'methods': methods,
    }  # fmt: skip
