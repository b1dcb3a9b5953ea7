"""Formats of other projects, both ways, through one thing: `full_space.FullSpaceData`.

One module per format. `detect` says what kind of data a folder holds, told by its files.
"""

import os
from types import ModuleType

from pca_tools import files
from pca_tools.formats import deepmind, geoelements, lagrangebench, mpm_ngf, plain_npz, vtp_files
from pca_tools.metadata import METADATA_NAME, SPLITS

# Every module has a TITLE, `read(folder, dt)` and `write(folder, data)`.
FORMATS: dict[str, ModuleType] = {
    'deepmind': deepmind, 'geoelements': geoelements, 'lagrangebench': lagrangebench,
    'mpm_ngf': mpm_ngf, 'vtp': vtp_files, 'npz': plain_npz,
}  # fmt: skip
# Folders that need no import: what they are and what to do with them.
RAW, DATASET, AUTHORS = 'raw', 'dataset', 'authors'
NO_IMPORT = {
    RAW: '{folder}: these are raw runs already: lts convert --raw_path={folder} '
    '--output_path=DATASET',
    DATASET: '{folder}: this is a dataset of this project already: lts inspect {folder}',
    AUTHORS: '{folder}: this is a dataset of Subspace-Graph-Physics: it is read as it is '
    '(learning_to_simulate.train --data_path={folder}); importing it adds scene, keys and manifest',
}


def detect(folder: str) -> str:
    """Returns the name of a folder's format: one of `FORMATS`, or `raw`, `dataset`, `authors`.
    FileNotFoundError: there is no such folder. ValueError: nothing known; what was found and what
    is known."""
    if not os.path.isdir(folder):
        raise FileNotFoundError(f'{folder}: no such folder')
    names = sorted(os.listdir(folder))
    metadata = _json(folder, METADATA_NAME)
    endings = [
        ending
        for ending in ('tfrecord', 'h5', 'npz')
        if any(f'{split}.{ending}' in names for split in SPLITS)
    ]
    if endings and metadata is not None:
        if endings[0] != 'tfrecord':
            return 'lagrangebench' if endings[0] == 'h5' else 'geoelements'
        if 'mode_number' not in metadata:
            return 'deepmind'
        return DATASET if 'scene' in metadata else AUTHORS
    if 'runs' in (_json(folder, files.MANIFEST_NAME) or {}):
        return RAW
    for name, is_one in (
        ('mpm_ngf', mpm_ngf.cases), ('vtp', vtp_files.series_of), ('npz', plain_npz.run_files),
    ):  # fmt: skip
        if is_one(folder):
            return name
    if endings:
        raise ValueError(f'{folder}: holds {names[:5]} but no {METADATA_NAME}')
    raise ValueError(
        f'{folder}: holds {names[:8] or "nothing"}, which is none of the known formats '
        f'({", ".join(sorted(FORMATS))}); write one npz per run with `positions` [T, N, D]'
    )


def _json(folder: str, name: str) -> dict | None:
    path = os.path.join(folder, name)
    held = files.read_json(path) if os.path.exists(path) else None
    return held if isinstance(held, dict) else None
