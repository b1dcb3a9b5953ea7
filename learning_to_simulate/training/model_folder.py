"""What the model folders of all methods have in common: where the data came from, and whether a
folder holds this very model or something else."""

import os
from collections.abc import Iterable

from learning_to_simulate import checkpoints
from learning_to_simulate.live import resting_start
from pca_tools import dataset, files
from pca_tools.storage import folder_lock

# May lie in a folder that has no config.json yet: the lock, and what a training leaves that was
# killed while it wrote the folder's first files.
_FIRST = (folder_lock.LOCK_NAME, resting_start.START_FILE, resting_start.SUBSPACE_FILE)


def data_digests(folder: str) -> dict[str, str]:
    """File -> sha256 of what a dataset folder trains on."""
    paths = {'metadata.json': os.path.join(folder, 'metadata.json')}
    paths['train.tfrecord'] = dataset.split_path(folder, 'train')
    return {n: files.sha256_of_file(path) for n, path in paths.items() if os.path.exists(path)}


def data_record(data_path: str, metadata: dict) -> dict:
    """Where training data came from, for `config.json`: the path as it was given, and digests."""
    return {
        'path': data_path,
        'sha256': data_digests(data_path),
        'subspace': checkpoints.subspace_digest(metadata),
    }


def holds_model(
    path: str,
    parts: dict[str, dict],
    own_files: Iterable[str] = (),
    defaults: dict | None = None,
) -> bool:
    """Whether a folder holds a model already, which must then be one of these parts.

    Args:
      path: model folder; it exists.
      parts: entry of `config.json` -> what it says now, `path` aside; more may be in the file.
      own_files: further names that a killed training may leave before its `config.json`.
      defaults: what fields of `config` mean that the folder of an older version does not have.

    Raises:
      ValueError: a folder of something else, or of another model; nothing was written.
    """
    if not os.path.exists(os.path.join(path, checkpoints.CONFIG_FILE)):
        ours = {*_FIRST, *own_files}
        strangers = {n for n in os.listdir(path) if n not in ours and not n.endswith('.tmp')}
        if strangers:
            raise ValueError(
                f'{path}: not empty and not a model folder (holds {sorted(strangers)[:3]}); '
                f'nothing was written'
            )
        return False
    stored = checkpoints.read_config(path)
    for part, values in parts.items():
        old = stored.get(part)
        old = old if isinstance(old, dict) else {}
        if part == 'config':
            old = (defaults or {}) | old
        differing = [
            k for k, v in values.items() if k != 'path' and _plain(old.get(k)) != _plain(v)
        ]
        if differing:
            listed = ', '.join(
                f'{k}: {old.get(k)!r} there, {values[k]!r} now' for k in sorted(differing)
            )
            raise ValueError(
                f'{path}: holds a model of another {part} ({listed}); nothing was written, give '
                f'another --model_path'
            )
    return True


def _plain(value):
    return [_plain(v) for v in value] if isinstance(value, (list, tuple)) else value
