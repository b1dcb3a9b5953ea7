"""What kind of data a folder holds, told by its files."""

from __future__ import annotations

import os
from types import ModuleType

from pca_tools import files
from pca_tools.formats import (
    deepmind,
    geoelements,
    lagrangebench,
    mpm_ngf,
    plain_npz,
    vtp_series,
)
from pca_tools.metadata import METADATA_NAME, SPLITS

FORMATS: dict[str, ModuleType] = {
    module.NAME: module
    for module in (deepmind, geoelements, lagrangebench, mpm_ngf, vtp_series, plain_npz)
}
# Folders that need no import: what they are and what to do with them.
RAW, DATASET, AUTHORS = 'raw', 'dataset', 'authors'


def detect(folder: str) -> str:
    """Returns the name of a folder's format: one of `FORMATS`, or `raw`, `dataset`, `authors`.

    Raises:
        FileNotFoundError: there is no such folder.
        ValueError: nothing that is known; the message says what was found and what is known.
    """
    if not os.path.isdir(folder):
        raise FileNotFoundError(f'{folder}: no such folder')
    names = sorted(os.listdir(folder))
    metadata = _json(folder, METADATA_NAME)
    endings = {
        ending
        for ending in ('tfrecord', 'npz', 'h5')
        if any(f'{split}.{ending}' in names for split in SPLITS)
    }
    if 'tfrecord' in endings and metadata is not None:
        if 'mode_number' not in metadata:
            return deepmind.NAME
        return DATASET if 'scene' in metadata else AUTHORS
    if 'h5' in endings and metadata is not None:
        return lagrangebench.NAME
    if 'npz' in endings and metadata is not None:
        return geoelements.NAME
    manifest = _json(folder, files.MANIFEST_NAME)
    if manifest is not None and 'runs' in manifest:
        return RAW
    if mpm_ngf.cases(folder):
        return mpm_ngf.NAME
    if vtp_series.series_of(folder):
        return vtp_series.NAME
    if plain_npz.run_files(folder):
        return plain_npz.NAME
    raise ValueError(f'{folder}: {_unknown(names, endings)}')


def _json(folder: str, name: str) -> dict | None:
    path = os.path.join(folder, name)
    if not os.path.exists(path):
        return None
    held = files.read_json(path)
    return held if isinstance(held, dict) else None


def _unknown(names: list[str], endings: set[str]) -> str:
    """Says what was found, with advice where it is known what it is."""
    known = ', '.join(sorted(FORMATS))
    if 'meta.json' in names:
        return (
            'this looks like a MeshGraphNets dataset (meta.json): meshes, not particles; it cannot '
            'be imported'
        )
    if any(name.startswith('loc_') and name.endswith('.npy') for name in names):
        return (
            'these are NRI trajectories (loc_*.npy): nri/ makes and reads such systems; they hold '
            'no soil to import'
        )
    if endings:
        return f'holds {names[:5]} but no {METADATA_NAME}, which these formats need'
    inside = [name for name in names if name in ('train', 'valid', 'test')]
    if inside:
        return (
            f'holds the folders {inside}, as NeuralMPM does; it is not known here: write its '
            'particles as one npz per run with `positions` [T, N, D]'
        )
    return f'holds {names[:8] or "nothing"}, which is none of the known formats ({known})'


def explain(kind: str, folder: str) -> str:
    """Returns what a folder of a kind is and what to do with it, in one sentence."""
    if kind == RAW:
        return (
            f'{folder}: these are raw runs already: python -m pca_tools.convert '
            f'--raw_path={folder} --output_path=DATASET'
        )
    if kind == DATASET:
        return (
            f'{folder}: this is a dataset of this project already: python -m pca_tools.inspect '
            f'{folder}'
        )
    if kind == AUTHORS:
        return (
            f'{folder}: this is a dataset of Subspace-Graph-Physics: it is read as it is '
            f'(learning_to_simulate.train --data_path={folder}); importing it adds scene, keys and '
            'manifest'
        )
    return (
        f'{folder}: this is {FORMATS[kind].TITLE}; to use it: python -m pca_tools.import_data '
        f'{folder} --output_path=RAW'
    )
