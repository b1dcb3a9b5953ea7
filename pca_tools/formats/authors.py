"""Subspace-Graph-Physics, the authors' folders: records in the subspace, pickled PCA beside them.

They are read as they are; importing makes a dataset that states its scene, counts its keys, and has
a manifest, and `subspace.npz` where the eigenvectors are there (in the published folders they are
git-lfs pointers).
"""

from __future__ import annotations

import dataclasses
import os
import statistics
from typing import Any

import numpy as np

from pca_tools import dataset, files, legacy_pickles
from pca_tools.metadata import METADATA_NAME, SCHEMA_VERSION, SPLITS


def import_dataset(
    folder: str, output_path: str, name: str, rigid_motion: str | None, up_axis: int = 1
) -> tuple[dict[str, Any], list[str]]:
    """Writes the dataset.

    Args:
        folder: of the authors.
        output_path: absent or empty.
        name: of the scene.
        rigid_motion: of the body; default as its particle type says (3: prescribed, else
            predicted).
        up_axis: axis against gravity.

    Returns:
        The metadata, and notes for the person who imports.

    Raises:
        ValueError: damaged records, or an output that is not empty.
    """
    metadata = dataset.read_metadata(folder)
    splits = {
        split: dataset.read_split(folder, split)
        for split in SPLITS
        if os.path.exists(dataset.split_path(folder, split))
    }
    runs = [run for part in splits.values() for run in part]
    if not runs:
        raise ValueError(f'{folder}: holds no records')
    prescribed = runs[0].particle_type[0] == dataset.KINEMATIC_PARTICLE_ID
    rigid_motion = rigid_motion or ('prescribed' if prescribed else 'predicted')
    scene = {
        'name': name,
        'rigid_motion': rigid_motion,
        'rigid_edges': [],
        'context_names': [f'context_{i}' for i in range(len(metadata.get('context_mean', [])))],
        'force': 'rigid_body_force_mean' in metadata,
        'up_axis': up_axis,
    }
    metadata = {
        **metadata,
        'schema_version': SCHEMA_VERSION,
        'scene': scene,
        'particles_rigid': statistics.mode(run.n_rigid for run in runs),
        'frames_stored': runs[0].n_frames,
    }
    # Their ids repeat and are not as many as the records.
    metadata['source_split'] = metadata.pop('dataset_split', {})
    metadata['dataset_split'] = {
        split: [f'{split}_{index}' for index in range(len(part))] for split, part in splits.items()
    }
    published, notes = {}, []
    try:
        path = os.path.join(folder, legacy_pickles.EIGENVECTORS_NAME)
        vectors = legacy_pickles.read_array(path)
        mean = legacy_pickles.read_array(os.path.join(folder, legacy_pickles.MEAN_NAME))
        published = {'components': vectors[:, : metadata['mode_number']].real, 'mean': mean}
        metadata['n_soil'] = len(vectors)
    except (ValueError, OSError) as error:
        notes.append(f'without eigenvectors scores cannot be decoded to particles ({error})')

    def fill(temporary: str) -> None:
        listed: dict[str, dict[str, Any]] = {METADATA_NAME: {}}
        files.write_json(os.path.join(temporary, METADATA_NAME), metadata)
        for split, part in splits.items():
            path = dataset.split_path(temporary, split)
            kept = [_renumbered(run, key, rigid_motion) for key, run in enumerate(part)]
            listed[os.path.basename(path)] = {'records': dataset.write_split(path, kept)}
        if published:
            files.write_npz(os.path.join(temporary, 'published_subspace.npz'), **published)
            listed['published_subspace.npz'] = {}
        files.write_manifest(temporary, listed)

    files.write_folder_atomically(output_path, fill, replace=False)
    return metadata, notes


def _renumbered(run: dataset.Trajectory, key: int, rigid_motion: str) -> dataset.Trajectory:
    is_mode = run.particle_type == dataset.MODE_PARTICLE_ID
    types = np.where(is_mode, dataset.MODE_PARTICLE_ID, dataset.rigid_type(rigid_motion))
    return dataclasses.replace(run, key=key, particle_type=types.astype(np.int64))
