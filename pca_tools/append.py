"""Adds raw runs to a dataset that is there: in its subspace, each to the split that it names.

Subspace, statistics and sampled particles stay those of the dataset, so every model that was
trained on it fits the larger one, too. Long data can so be made part by part, on machines that do
not keep the raw runs. A run that the dataset holds already is skipped; if both are of one solver
version they must be equal.
The larger dataset takes the place of the smaller one at the very end, as a whole; until then the
smaller one is locked, so that of two commands at a time the second is refused.

Examples:
    lts append --raw_path=raw/excavation --data_path=datasets/excavation
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from absl import flags

from pca_tools import command, compression, convert, dataset, encode, files
from pca_tools.encode import EncodedRun
from pca_tools.heights import Heights
from pca_tools.metadata import SPLITS
from pca_tools.particles import ParticleSample
from pca_tools.raw_runs import RawRuns
from pca_tools.storage import folder_lock


def append(
    raw_path: str, data_path: str, check_units: bool = True, match_particles: bool = False
) -> dict[str, Any]:
    """Adds the runs of a raw folder, of the same scene and packing, all of which name a split, to a
    dataset of `convert` with a particle sample. Returns the metadata of the larger dataset:
    truncation errors are kept for those numbers of modes that the subspace has; the bounds hold
    both.

    FileNotFoundError: a folder or file is missing. ValueError: bad raw runs, another scene or
    packing, runs without a split, nothing new, a run that the dataset holds with other content, or
    a dataset with foreign files or another writer. OSError: the dataset cannot be written."""
    dataset.read_metadata(data_path)  # the lock would make a folder that is absent
    with folder_lock.locked(data_path):
        encode.refuse_occupied_output(data_path, overwrite=True)
        listed = files.check_manifest(data_path, ())
        held = encode.load(data_path)
        runs = RawRuns(raw_path)
        runs.check(check_units, held.space, match_particles)
        convert.refuse_other_scene(data_path, held.metadata, runs)
        new, old = (grid or 'none' for grid in (runs[0].grid, held.grid))
        if new != old:
            raise ValueError(f'{raw_path}: its height map is {new}, that of {data_path} {old}')
        added = _encode_new(runs, held, data_path)
        together = held.with_parts(
            {split: [*held.parts.get(split, []), *added[split]] for split in SPLITS}, runs.world
        )
        if files.check_manifest(data_path, ()) != listed:  # by `--overwrite`, which takes no lock
            raise ValueError(f'{data_path}: was replaced while runs were added; call again')
        encode.write(data_path, together, overwrite=True)
        return together.metadata


def _encode_new(
    runs: RawRuns, held: encode.Contents, data_path: str
) -> dict[str, list[EncodedRun]]:
    """Returns split -> the runs that the dataset does not hold; ValueError if there is none, one is
    held with other content, or they name no split."""
    records = {convert.run_key(run.parameters): run for part in held.parts.values() for run in part}
    new, twice = [], {}
    for index in range(len(runs)):
        parameters = runs.parameters(index)
        record = records.get(convert.run_key(parameters))
        if record is None:
            new.append(index)
        # Of another solver version the record stays; `refuse_other_scene` has warned of it.
        elif parameters.get('solver_version') == record.parameters.get('solver_version'):
            twice[index] = record

    def encoded(indices: Sequence[int]) -> list[EncodedRun]:
        return encode.encode_runs(runs, indices, held.space, held.space.n_modes, held.sampled)

    for made, record in zip(encoded([*twice]), twice.values()):
        if not _are_equal(made, record, held):
            held_case = f'holds case {made.parameters["case"]} with other content'
            raise ValueError(f'{data_path}: {held_case}; a new run needs a case id of its own')
    if not new:
        raise ValueError(f'{data_path}: holds all {len(runs)} runs already; nothing was changed')
    dealt = convert.given_splits(runs, new, need_train=False)
    if dealt is None:
        raise ValueError(f'{runs.folder}: its runs name no split of {SPLITS} in their parameters')
    return {split: encoded(part) for split, part in dealt.items()}


def _are_equal(made: EncodedRun, held: EncodedRun, whole: encode.Contents) -> bool:
    """Whether two records are of one run. Packed records hold scores in whole steps and rigid
    particles as the pose puts them; everything else is kept bit for bit."""
    ours, theirs = made.trajectory, held.trajectory
    if ours.position.shape != theirs.position.shape:
        return False

    def unpacked(run: EncodedRun) -> list[np.ndarray]:
        rest = whole.space.initial[whole.sampled]
        found = [compression.unpack_steps(*run.sample, rest, ParticleSample.RESOLUTION)]
        if whole.grid and run.heights:
            flat = np.zeros(whole.grid.shape)
            found.append(compression.unpack_steps(*run.heights, flat, Heights.RESOLUTION))
        return found

    return (
        all(map(np.array_equal, unpacked(made), unpacked(held)))
        and np.abs(ours.position - theirs.position).max() < dataset.POSE_TOLERANCE
        and all(
            np.array_equal(getattr(ours, name), getattr(theirs, name))
            for name in ('particle_type', *dataset.FRAME_SERIES)
        )
    )


def define_flags() -> None:
    flags.DEFINE_string('raw_path', None, 'Folder of raw solver runs.', required=True)
    flags.DEFINE_string('data_path', None, 'Dataset that grows.', required=True)
    convert.define_check_flags()


def main(values) -> None:
    metadata = append(values.raw_path, values.data_path, values.check_units, values.match_particles)
    print(convert.summary(metadata, values.data_path))


if __name__ == '__main__':
    define_flags()
    command.start_quietly(main)
