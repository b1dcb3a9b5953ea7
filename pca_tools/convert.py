"""Converts raw solver runs to a dataset.

A dataset is `{train,valid,test}.tfrecord`, metadata, subspace, a sample of the particles of each
split (`particles_<split>.npz`) and a manifest. The subspace is fitted on the training runs only,
with one run in memory at a time. Runs whose parameters name a split go there. All files are made in
a folder beside the output, which takes its name at the very end: it is there whole or not at all.

Examples:
    python -m pca_tools.convert --raw_path=raw/excavation --output_path=datasets/Excavation

    # 24 modes of hundreds of runs: the subspace from every fourth frame
    python -m pca_tools.convert --raw_path=raw/driving --output_path=datasets/Driving \\
        --num_modes=24 --frame_stride=4

    # the published centering, two cases kept for the test split
    python -m pca_tools.convert --raw_path=raw/wheel --output_path=datasets/Wheel \\
        --centering=scalar --hold_out=12,47

    # files of the raw folder were changed on purpose: let the manifest follow
    python -m pca_tools.convert --raw_path=raw/own --rehash

    # new runs, all in the test split, in the subspace of the dataset that a model was trained on
    python -m pca_tools.convert --raw_path=raw/new --output_path=datasets/New \\
        --like=datasets/Excavation

`pca_tools.append` adds runs to a dataset that is there.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from absl import flags
from tqdm import tqdm

from pca_tools import command, dataset, files, particles, raw_writer, subspace, workers
from pca_tools.encode import FLOOR_MODES, SUBSPACE_NAME, EncodedRun, encode_runs, make_metadata
from pca_tools.metadata import METADATA_NAME, metadata_problems
from pca_tools.raw_runs import RawRuns, SoilPositions
from pca_tools.splits import given_splits, split_cases
from pca_tools.statistics import mean_share
from pca_tools.storage.folder_lock import LOCK_NAME

DEFAULT_SPLIT = (0.8, 0.1, 0.1)
# What must agree between raw runs and the dataset they are to fit; a scene may say more.
_SCENE_KEYS = (
    'name', 'rigid_motion', 'rigid_edges', 'context_names', 'force', 'up_axis', 'bodies', 'dim',
)  # fmt: skip
# Flags that say how a subspace is made and its runs dealt: with --like both are there.
_FLAGS_WITHOUT_LIKE = (
    'num_modes', 'centering', 'split', 'seed', 'hold_out', 'frame_stride',
)  # fmt: skip


def convert(
    raw_path: str,
    output_path: str,
    *,
    modes: int = 8,
    centering: str = 'configuration',
    split: Sequence[float] | None = None,
    seed: int = 0,
    hold_out: Sequence[int | str] = (),
    frame_stride: int = 1,
    max_memory_mb: float = 1024.0,
    like: str | None = None,
    overwrite: bool = False,
    check_units: bool = True,
    match_particles: bool = False,
    cluster: str | None = None,
    packed: bool = True,
) -> dict[str, Any]:
    """Converts a folder of raw runs; arguments as the flags of the same names.

    Returns:
        The metadata of the new dataset.

    Raises:
        FileNotFoundError: a folder or file is missing.
        ValueError: bad raw runs, bad arguments, or an output folder that is not empty.
    """
    if frame_stride < 1:
        raise ValueError(f'frame_stride is {frame_stride}, at least 1 was expected')
    refuse_occupied_output(output_path, overwrite)
    runs = RawRuns(raw_path)
    base, space = (None, None) if like is None else load_base(like)
    if match_particles:
        runs.match_particles(None if space is None else space.initial)
    runs.check(check_units, progress_bar)
    without_pose = runs[0].rigid_pose is None and runs[0].body_pose is None
    if without_pose and runs.scene['rigid_motion'] != 'none':
        warnings.warn(
            f'{raw_path}: its runs have no `pose` [T, 7] of the body: models of modes can be '
            'trained on them, the swept field cannot',
            stacklevel=2,
        )
    if base is not None:
        refuse_other_scene(like, base, runs)
        _refuse_trained_on(like, base, runs)
    if space is None:
        parts = _deal(runs, split, seed, hold_out)
        with contextlib.nullcontext() if cluster is None else workers.start(cluster) as crew:
            wide = subspace.fit(
                SoilPositions(runs, parts['train'], frame_stride), modes, centering, max_memory_mb,
                names=[str(runs.cases[index]) for index in parts['train']], progress=progress_bar,
                spare_modes=max(max(FLOOR_MODES) - modes, 0), crew=crew,
            )  # fmt: skip
        space = wide.truncated(modes)
    else:
        parts, wide = {'test': list(range(len(runs)))}, space
    parts = {name: part for name, part in parts.items() if part}
    sampled = particles.choose_particles(space.initial)
    encoded = encode_runs(runs, parts, wide, space.n_modes, sampled, progress_bar)
    metadata = make_metadata(runs.world, encoded, space, frame_stride, base, packed)
    problems = metadata_problems(metadata)
    if problems:
        raise ValueError(f'{raw_path}: gives impossible metadata: ' + '; '.join(problems))
    write_dataset(output_path, encoded, space, sampled, metadata, overwrite)
    return metadata


def _deal(
    runs: RawRuns,
    split: Sequence[float] | None,
    seed: int,
    hold_out: Sequence[int | str],
) -> dict[str, list[int]]:
    """Returns split -> indices of runs: as asked for, as the runs say, or by the default shares."""
    if split is None:
        given = [runs.parameters(index).get('split') for index in range(len(runs))]
        parts = given_splits(runs.cases, given, hold_out)
        if parts is not None:
            return parts
    return split_cases(runs.cases, split or DEFAULT_SPLIT, seed, hold_out)


def refuse_occupied_output(output_path: str, overwrite: bool) -> None:
    """Raises unless the output is absent, empty, or a finished dataset that may be replaced.

    Raises:
        ValueError: the folder holds something; the message says what to do.
        OSError: nothing can be written beside it.
    """
    above = os.path.realpath(output_path)
    if not os.path.ismount(above):  # which is filled from inside
        above = os.path.dirname(above)
    while not os.path.lexists(above):
        above = os.path.dirname(above)
    try:
        tempfile.TemporaryDirectory(dir=above).cleanup()
    except OSError as error:
        raise OSError(error.errno, f'cannot write {output_path}: {error.strerror}') from error
    if not os.path.exists(output_path):
        return
    if not os.path.isdir(output_path):
        raise ValueError(f'{output_path}: is a file, a folder was expected')
    held = set(os.listdir(output_path)) - {LOCK_NAME}  # of `append`
    if not held:
        return
    if files.MANIFEST_NAME not in held or METADATA_NAME not in held:
        raise ValueError(
            f'{output_path}: is not empty and not a finished dataset; nothing was changed, name '
            'another folder'
        )
    foreign = held - set(files.check_manifest(output_path) or ()) - {files.MANIFEST_NAME}
    if foreign:
        raise ValueError(
            f'{output_path}: holds files that are not of the dataset ({sorted(foreign)[:5]}); '
            'nothing was changed; move them away, or name another folder'
        )
    if not overwrite:
        raise ValueError(f'{output_path}: holds a finished dataset; use --overwrite to replace it')


def load_base(like: str) -> tuple[dict[str, Any], subspace.Subspace]:
    """Returns metadata and subspace of the dataset that new runs are to fit.

    Raises:
        FileNotFoundError, ValueError: there is none, or its files do not fit each other.
    """
    base = dataset.read_metadata(like)
    space = subspace.Subspace.load(os.path.join(like, SUBSPACE_NAME))
    if base.get('pca', {}).get('digest') != space.digest:
        raise ValueError(f'{like}: {SUBSPACE_NAME} is not the one that the metadata names')
    return base, space


def refuse_other_scene(like: str, base: dict[str, Any], runs: RawRuns) -> None:
    """Raises ValueError if the runs are of another scene than the dataset; warns of versions."""
    scene = base.get('scene', {})
    for key in _SCENE_KEYS:
        if scene.get(key) != runs.scene.get(key):
            raise ValueError(
                f'{like}: is of another scene: its {key} is {scene.get(key)!r}, that of the '
                f'raw runs {runs.scene.get(key)!r}'
            )
    if base['dt'] != runs.dt:
        raise ValueError(f'{like}: has dt {base["dt"]}, the raw runs have {runs.dt}')
    versions = {_solver_version(case) for case in base.get('cases', {}).get('train', [])}
    new = {_solver_version(runs.parameters(index)) for index in range(len(runs.cases))}
    if versions and not new <= versions:
        warnings.warn(
            f'{like}: its runs are of solver version {sorted(versions)}, the raw runs of '
            f'{sorted(new)}: errors of its models will include what changed between them',
            stacklevel=2,
        )


def _refuse_trained_on(like: str, base: dict[str, Any], runs: RawRuns) -> None:
    trained = {kind_and_case(case) for case in base.get('cases', {}).get('train', [])}
    known = [case for case, key in zip(runs.cases, keys_of(runs)) if key in trained]
    if known:
        raise ValueError(f'{like}: was trained on the cases {known}; they are no test of it')


def keys_of(runs: RawRuns) -> list[tuple[Any, str]]:
    """Returns what tells each run from all others, see `kind_and_case`."""
    return [
        (runs.parameters(index).get('kind'), str(case)) for index, case in enumerate(runs.cases)
    ]


def _solver_version(parameters: dict[str, Any]) -> str:
    return str(parameters.get('solver_version', 'not stated'))


def kind_and_case(parameters: dict[str, Any]) -> tuple[Any, str]:
    """Returns the key of a run: case numbers count anew in every kind (grid, driven paths)."""
    return parameters.get('kind'), str(parameters.get('case'))


def write_dataset(
    output_path: str,
    encoded: dict[str, list[EncodedRun]],
    space: subspace.Subspace,
    sampled: np.ndarray,
    metadata: dict[str, Any],
    overwrite: bool,
) -> None:
    """Writes all files beside the output, the manifest last, and then gives the folder its name."""

    def fill(folder: str) -> None:
        listed: dict[str, dict[str, Any]] = {METADATA_NAME: {}, SUBSPACE_NAME: {}}
        files.write_json(os.path.join(folder, METADATA_NAME), metadata)
        space.save(os.path.join(folder, SUBSPACE_NAME))
        for name, part in encoded.items():
            path = dataset.split_path(folder, name)
            runs = [run.trajectory for run in part]
            records = dataset.write_split(path, runs, metadata.get('packed', False))
            listed[os.path.basename(path)] = {'records': records}
            path = particles.sample_path(folder, name)
            particles.write_sample(
                path, [run.sample for run in part], sampled, space.initial[sampled]
            )
            listed[os.path.basename(path)] = {}
        files.write_manifest(folder, listed)

    files.write_folder_atomically(output_path, fill, replace=overwrite)


def progress_bar(sequence, label: str):
    """Wraps a pass over runs in a progress bar."""
    return tqdm(sequence, desc=label, unit='run')


def summary(metadata: dict[str, Any], output_path: str) -> str:
    """Returns the closing lines: counts, truncation error and motion kept by split."""
    lines = [
        f'{output_path}: scene {metadata["scene"]["name"]}, N = {metadata["n_soil"]}, '
        f'R = {metadata["particles_rigid"]}, r = {metadata["mode_number"]}, '
        f'T = {metadata["frames_stored"]}, centering {metadata["pca"]["centering"]}',
        'split    runs   truncated MSE [m^2]   RMS [mm]  farthest [mm]   motion kept',
    ]
    floors = metadata['projection_floors']
    for name, values in metadata['projection_mse'].items():
        mse = float(np.mean(values))
        kept = mean_share(metadata['motion_kept'][name], metadata['motion_mse'][name])
        lines.append(
            f'{name:<8}{len(values):>5}{mse:>22.3e}{1e3 * mse**0.5:>11.3f}'
            f'{max(metadata["projection_max_mm"][name]):>15.2f}{100 * kept:>13.2f}%'
        )
    for name in metadata['projection_mse']:
        cells = ', '.join(
            f'{1e3 * mse**0.5:.3f} with {count}'
            for count, mse in zip(floors['modes'], floors[name])
        )
        lines.append(f'RMS [mm] that modes leave, {name}: {cells}')
    entries = files.read_json(os.path.join(output_path, files.MANIFEST_NAME))['files'].values()
    n_bytes = sum(entry['bytes'] for entry in entries)
    n_runs = sum(map(len, metadata['projection_mse'].values()))
    return '\n'.join([*lines, f'{n_runs} runs in {1e-6 * n_bytes:.1f} MB'])


def define_flags() -> None:
    """Defines the flags; not at import, so that several commands can be imported together."""
    flags.DEFINE_string('raw_path', None, 'Folder of raw solver runs.', required=True)
    flags.DEFINE_string('output_path', None, 'Folder of the new dataset.')
    flags.DEFINE_integer('num_modes', 8, 'Number of modes r to keep.')
    flags.DEFINE_enum(
        'centering', 'configuration', subspace.CENTERINGS,
        'Subtracted before the PCA: the mean position of each particle, or one number.',
    )  # fmt: skip
    flags.DEFINE_list(
        'split', None, 'Shares of train, valid, test; default: as the runs say, else 0.8,0.1,0.1.'
    )
    flags.DEFINE_integer('seed', 0, 'Seed of the split.')
    flags.DEFINE_list('hold_out', [], 'Case ids that go to the test split.')
    flags.DEFINE_integer(
        'frame_stride', 1, 'Fit the subspace to every so many frames of a training run.'
    )
    flags.DEFINE_float('max_memory_mb', 1024.0, 'Memory of the fit in MiB, beside one run.')
    flags.DEFINE_string(
        'like', None, 'Dataset whose subspace and statistics are used; all runs go to test.'
    )
    flags.DEFINE_bool('overwrite', False, 'Replace a finished dataset at --output_path.')
    flags.DEFINE_string(
        'cluster', None, 'Sum up the covariance on workers: local:4, slurm:64, tcp://host:port.'
    )
    flags.DEFINE_bool(
        'packed', True, "Records in a fifth of the bytes; --nopacked: for DeepMind's own reader."
    )
    flags.DEFINE_bool('rehash', False, 'First let the raw manifest follow its files.')
    define_check_flags()


def define_check_flags() -> None:
    """Defines the flags that say how raw runs are read, here and in `pca_tools.append`."""
    flags.DEFINE_bool(
        'check_units', True, 'Refuse positions and dt that are implausible in metres and seconds.'
    )
    flags.DEFINE_bool(
        'match_particles', False,
        'Reorder the particles of every run: each goes with its nearest neighbour in frame 0.',
    )  # fmt: skip


def main(values) -> None:
    """Runs the command."""
    if not (values.output_path or values.rehash):
        raise ValueError('--output_path is missing: the folder of the new dataset')
    idle = [f'--{name}' for name in _FLAGS_WITHOUT_LIKE if values[name].present]
    if values.like and idle:
        raise ValueError(f'{", ".join(idle)} do not go with --like: subspace and splits are given')
    if values.rehash:
        changed = raw_writer.rehash(values.raw_path)
        print(f'{values.raw_path}: the manifest has new entries for {len(changed)} files')
        if not values.output_path:
            return
    metadata = convert(
        values.raw_path, values.output_path, modes=values.num_modes, centering=values.centering,
        split=values.split and [float(share) for share in values.split], seed=values.seed,
        hold_out=values.hold_out, frame_stride=values.frame_stride,
        max_memory_mb=values.max_memory_mb, like=values.like, overwrite=values.overwrite,
        check_units=values.check_units, match_particles=values.match_particles,
        cluster=values.cluster, packed=values.packed,
    )  # fmt: skip
    print(summary(metadata, values.output_path))


if __name__ == '__main__':
    define_flags()
    command.start_quietly(main)
