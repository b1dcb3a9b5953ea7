"""Adds raw runs to a dataset that is there: in its subspace, each to the split that it names.

Subspace, statistics and sampled particles stay those of the dataset, so every model that was
trained on it fits the larger one, too. Long data can so be made part by part, on machines that do
not keep the raw runs. A run that the dataset holds already is skipped; if both are of one solver
version they must be equal.
The larger dataset takes the place of the smaller one at the very end, as a whole; until then the
smaller one is locked, so that of two commands at a time the second is refused.

Examples:
    python -m pca_tools.append --raw_path=raw/excavation --data_path=datasets/Excavation
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from absl import flags

from pca_tools import command, convert, dataset, files, packing, particles
from pca_tools.encode import EncodedRun, encode_runs, make_metadata, make_trajectory
from pca_tools.metadata import PROJECTION_KEYS, SPLITS
from pca_tools.raw_runs import RawRun, RawRuns
from pca_tools.splits import given_splits
from pca_tools.storage import folder_lock


def append(
    raw_path: str,
    data_path: str,
    check_units: bool = True,
    match_particles: bool = False,
    take_over_lock: bool = False,
) -> dict[str, Any]:
    """Adds the runs of a raw folder to a dataset.

    Args:
        raw_path: raw runs of the same scene and packing; all of them name a split.
        data_path: a dataset of `convert` with a particle sample; replaced as a whole.
        check_units: of `convert`.
        match_particles: of `convert`.
        take_over_lock: whether a lock that a process of another machine left may be taken.

    Returns:
        The metadata of the larger dataset. Truncation errors are kept for those numbers of modes
        that the subspace has. Scene and statistics are those of the smaller one, the bounds hold
        both.

    Raises:
        FileNotFoundError: a folder or file is missing.
        ValueError: bad raw runs, another scene or packing, runs without a split, nothing new, a
            run that the dataset holds with other content, a dataset with files of somebody else, or
            one that another process writes or has replaced meanwhile.
        OSError: the dataset cannot be written.
    """
    dataset.read_metadata(data_path)  # the lock would make a folder that is absent
    with folder_lock.locked(data_path, take_over_lock):
        convert.refuse_occupied_output(data_path, overwrite=True)
        return _append(raw_path, data_path, check_units, match_particles)


def _append(
    raw_path: str, data_path: str, check_units: bool, match_particles: bool
) -> dict[str, Any]:
    listed = files.check_manifest(data_path, ())
    base, space = convert.load_base(data_path)
    held = read_encoded(data_path, base)
    runs = RawRuns(raw_path)
    if match_particles:
        runs.match_particles(space.initial)
    runs.check(check_units, convert.progress_bar)
    convert.refuse_other_scene(data_path, base, runs)
    sample = particles.read_sample(data_path, next(iter(held)))
    new = _not_held(held, runs, sample, data_path)
    named = [runs.parameters(index).get('split') for index in new]
    dealt = given_splits([runs.cases[index] for index in new], named, need_train=False)
    if dealt is None:
        raise ValueError(f'{raw_path}: its runs name no split of {SPLITS} in their parameters')
    parts = {split: [new[place] for place in part] for split, part in dealt.items() if part}
    added = encode_runs(runs, parts, space, space.n_modes, sample.indices, convert.progress_bar)
    together = {split: held.get(split, []) + added.get(split, []) for split in SPLITS}
    together = {split: numbered(part) for split, part in together.items() if part}
    metadata = make_metadata(runs.world, together, space, 1, base, base.get('packed', False))
    if files.check_manifest(data_path, ()) != listed:  # by `--overwrite`, which takes no lock
        raise ValueError(
            f'{data_path}: was replaced while runs were added; what is there now is kept, call '
            'again'
        )
    convert.write_dataset(data_path, together, space, sample.indices, metadata, overwrite=True)
    return metadata


def read_encoded(data_path: str, metadata: dict[str, Any]) -> dict[str, list[EncodedRun]]:
    """Returns split -> the runs of a dataset as the converter had them when it wrote it.

    The truncation error by number of modes is kept for a split, not for a run: each has its mean.
    """
    encoded = {}
    for split, cases in metadata['cases'].items():
        trajectories = dataset.read_split(data_path, split)
        sample = particles.read_sample(data_path, split)
        floors = metadata['projection_floors']
        floors = dict(zip(floors['modes'], floors[split]))
        floors = {count: floors[count] for count in floors if count <= metadata['mode_number']}
        encoded[split] = [
            EncodedRun(
                trajectory,
                cases[index],
                {key: metadata[key][split][index] for key in PROJECTION_KEYS},
                floors,
                sample.packed(index),
            )
            for index, trajectory in enumerate(trajectories)
        ]
    return encoded


def _not_held(
    held: dict[str, list[EncodedRun]],
    runs: RawRuns,
    sample: particles.ParticleSample,
    data_path: str,
) -> list[int]:
    """Returns the indices of the runs that the dataset does not hold.

    Raises:
        ValueError: there is none, or one is held with other content.
    """
    keys = convert.keys_of(runs)
    records = {convert.kind_and_case(run.parameters): run for part in held.values() for run in part}
    new = []
    for index, key in enumerate(keys):
        if key not in records:
            new.append(index)
            continue
        version = runs.parameters(index).get('solver_version')
        if version != records[key].parameters.get('solver_version'):
            continue  # the record stays; `refuse_other_scene` has warned of the versions
        if not _is_record_of(runs[index], records[key], sample, runs.scene):
            raise ValueError(
                f'{data_path}: holds case {runs.cases[index]} with other content (path, force, '
                'context or particles) than the raw run; nothing was changed. A new run needs a '
                'case id of its own'
            )
    if not new:
        raise ValueError(f'{data_path}: holds all {len(keys)} runs already; nothing was changed')
    return new


def _is_record_of(
    run: RawRun, record: EncodedRun, sample: particles.ParticleSample, scene: dict[str, Any]
) -> bool:
    """Whether a record was made of a raw run: equal series, and particles as near as the sample."""
    held = record.trajectory
    if len(run.positions) != held.n_frames:
        return False
    made = make_trajectory(held.key, run, held.position[:, held.n_rigid :], scene)
    soil = packing.unpack_steps(*record.sample, sample.rest, sample.resolution)
    apart = np.abs(run.positions[:: sample.frame_stride, sample.indices] - soil)
    # Stored to half a step; the other half is for float32.
    # Packed records hold rigid particles as the pose puts them.
    return (
        np.max(apart) < sample.resolution
        and made.position.shape == held.position.shape
        and np.abs(made.position - held.position).max() < dataset.POSE_TOLERANCE
        and all(
            np.array_equal(getattr(made, field.name), getattr(held, field.name))
            for field in dataclasses.fields(held)
            if field.name != 'position'
        )
    )


def numbered(part: list[EncodedRun]) -> list[EncodedRun]:
    """The runs with their places in the split as the keys of their records."""
    return [
        dataclasses.replace(run, trajectory=dataclasses.replace(run.trajectory, key=place))
        for place, run in enumerate(part)
    ]


def define_flags() -> None:
    """Defines the flags; not at import, so that several commands can be imported together."""
    flags.DEFINE_string('raw_path', None, 'Folder of raw solver runs.', required=True)
    flags.DEFINE_string('data_path', None, 'Dataset that grows.', required=True)
    convert.define_check_flags()
    flags.DEFINE_bool(
        'take_over_lock', False, 'Also take the lock that a process of another machine left.'
    )


def main(values) -> None:
    """Runs the command."""
    metadata = append(
        values.raw_path, values.data_path, values.check_units, values.match_particles,
        values.take_over_lock,
    )  # fmt: skip
    print(convert.summary(metadata, values.data_path))


if __name__ == '__main__':
    define_flags()
    command.start_quietly(main)
