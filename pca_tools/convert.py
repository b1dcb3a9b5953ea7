"""Converts raw solver runs to a dataset.

A dataset is `{train,valid,test}.tfrecord`, metadata, subspace and manifest. The subspace is fitted
on the training runs only. All files are made in a folder beside the output,
which takes its name at the very end: the output is there whole or not at all.

Examples:
    python -m pca_tools.convert --raw_path=raw/excavation --output_path=datasets/Excavation

    # more modes, the published centering, two cases kept for the test split
    python -m pca_tools.convert --raw_path=raw/wheel --output_path=datasets/Wheel16 --modes=16 \\
        --centering=scalar --hold_out=12,47

    # new runs, all in the test split, in the subspace of the dataset that a model was trained on
    python -m pca_tools.convert --raw_path=raw/new --output_path=datasets/New \\
        --like=datasets/Excavation
"""

from __future__ import annotations

import dataclasses
import os
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from absl import app, flags
from scipy import spatial
from tqdm import tqdm

from pca_tools import dataset, files, subspace
from pca_tools.metadata import (
    DIM,
    METADATA_NAME,
    PROJECTION_KEYS,
    SCHEMA_VERSION,
    metadata_problems,
)
from pca_tools.raw_runs import RawRun, RawRuns, SoilPositions
from pca_tools.splits import split_cases
from pca_tools.statistics import mean_share, motion_statistics

SUBSPACE_NAME = 'subspace.npz'
# DeepMind's key; the subspace graphs only scale edge features by it (the authors' value).
CONNECTIVITY_RADIUS = 0.025


@dataclasses.dataclass(frozen=True)
class EncodedRun:
    """One run in the subspace, with what its record in the metadata says.

    Attributes:
        trajectory: the record.
        parameters: all parameters of the case.
        details: see `projection_details`.
    """

    trajectory: dataset.Trajectory
    parameters: dict[str, Any]
    details: dict[str, float]


def convert(
    raw_path: str,
    output_path: str,
    *,
    modes: int = 8,
    centering: str = 'configuration',
    split: Sequence[float] = (0.8, 0.1, 0.1),
    seed: int = 0,
    hold_out: Sequence[int | str] = (),
    spread: bool = False,
    max_memory_mb: float = 1024.0,
    like: str | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Converts a folder of raw runs; arguments as the flags of the same names.

    Returns:
        The metadata of the new dataset.

    Raises:
        FileNotFoundError: a folder or file is missing.
        ValueError: bad raw runs, bad arguments, or an output folder that is not empty.
    """
    refuse_occupied_output(output_path, overwrite)
    runs = RawRuns(raw_path)
    if like is None:
        parts = split_cases(runs.cases, split, seed, hold_out, spread)
        space = subspace.fit(
            SoilPositions(runs, parts['train']), modes, centering, max_memory_mb,
            names=[str(runs.cases[index]) for index in parts['train']], progress=progress_bar,
        )  # fmt: skip
        base = None
    else:
        parts = {'test': list(range(len(runs)))}
        base, space = _load_like(like, runs)
    encoded = _encode_runs(runs, {name: part for name, part in parts.items() if part}, space)
    metadata = _make_metadata(runs, encoded, space, base)
    problems = metadata_problems(metadata)
    if problems:
        raise ValueError(f'{raw_path}: gives impossible metadata: ' + '; '.join(problems))
    _write_dataset(output_path, encoded, space, metadata, overwrite)
    return metadata


def refuse_occupied_output(output_path: str, overwrite: bool) -> None:
    """Raises unless the output is absent, empty, or a finished dataset that may be replaced.

    Raises:
        ValueError: the folder holds something; the message says what to do.
    """
    if not os.path.exists(output_path):
        return
    if not os.path.isdir(output_path):
        raise ValueError(f'{output_path}: is a file, a folder was expected')
    held = set(os.listdir(output_path))
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
            'nothing was changed, name another folder'
        )
    if not overwrite:
        raise ValueError(f'{output_path}: holds a finished dataset; use --overwrite to replace it')


def _load_like(like: str, runs: RawRuns) -> tuple[dict[str, Any], subspace.Subspace]:
    """Returns metadata and subspace of the dataset that the new runs are to fit."""
    base = dataset.read_metadata(like)
    space = subspace.Subspace.load(os.path.join(like, SUBSPACE_NAME))
    if base.get('pca', {}).get('digest') != space.digest:
        raise ValueError(f'{like}: {SUBSPACE_NAME} is not the one that the metadata names')
    scene = base.get('scene', {})
    for key in sorted(scene.keys() | runs.scene.keys()):
        if scene.get(key) != runs.scene.get(key):
            raise ValueError(
                f'{like}: is of another scene: its {key} is {scene.get(key)!r}, that of the '
                f'raw runs {runs.scene.get(key)!r}'
            )
    if base['dt'] != runs.dt:
        raise ValueError(f'{like}: has dt {base["dt"]}, the raw runs have {runs.dt}')
    known = sorted(set(space.runs) & {str(case) for case in runs.cases})
    if known:
        raise ValueError(f'{like}: was trained on the cases {known}; they are no test of it')
    return base, space


def _encode_runs(
    runs: RawRuns, parts: dict[str, list[int]], space: subspace.Subspace
) -> dict[str, list[EncodedRun]]:
    """Projects all runs, one in memory at a time; returns them by split."""
    spacing = float(np.median(spatial.cKDTree(space.initial).query(space.initial, 2)[0][:, 1]))
    encoded: dict[str, list[EncodedRun]] = {name: [] for name in parts}
    order = [(name, index) for name, indices in parts.items() for index in indices]
    for name, index in progress_bar(order, 'encode'):
        run = runs[index]
        _refuse_other_particles(run, space, spacing)
        scores = space.encode(run.positions)
        trajectory = _make_trajectory(len(encoded[name]), run, scores, runs.scene)
        details = projection_details(run.positions, space, scores)
        encoded[name].append(EncodedRun(trajectory, {'case': run.case, **run.parameters}, details))
    return encoded


def _refuse_other_particles(run: RawRun, space: subspace.Subspace, spacing: float) -> None:
    """Raises if column i is not the same particle as in the subspace."""
    if run.positions.shape[1] != space.n_soil:
        raise ValueError(
            f'case {run.case}: has {run.positions.shape[1]} particles, the subspace {space.n_soil}'
        )
    shift = float(np.median(np.linalg.norm(run.positions[0] - space.initial, axis=1)))
    if shift > spacing:
        raise ValueError(
            f'case {run.case}: its particles start {shift:.3g} m (median) from those of case '
            f'{space.runs[0]}, more than their spacing of {spacing:.3g} m: not the same packing or '
            'not the same order'
        )


def projection_details(
    positions: np.ndarray, space: subspace.Subspace, scores: np.ndarray
) -> dict[str, float]:
    """Measures what is lost between particles and scores.

    Args:
        positions: [T, N, 3] metres.
        space: the subspace.
        scores: [T, r, 3] encoded positions.

    Returns:
        `projection_mse` in m^2 over frames, particles and axes; `projection_max_mm`, the farthest
        particle in mm; `motion_mse`, mean square of the displacement from frame 0 in m^2;
        `motion_kept`, the share of it that lies in the subspace.
    """
    residual = positions - space.decode(scores)
    displacement = positions.astype(np.float64) - positions[0]
    moved = float(np.mean(displacement**2))
    kept = float(np.sum((scores - scores[0]) ** 2)) / displacement.size
    return {
        'projection_mse': float(np.mean(residual**2)),
        'projection_max_mm': 1e3 * float(np.sqrt(np.max(np.sum(residual**2, axis=-1)))),
        'motion_mse': moved,
        'motion_kept': kept / moved if moved > 0 else 1.0,
    }


def _make_trajectory(
    key: int, run: RawRun, scores: np.ndarray, scene: dict[str, Any]
) -> dataset.Trajectory:
    prescribed = scene['rigid_motion'] == 'prescribed'
    rigid_type = dataset.KINEMATIC_PARTICLE_ID if prescribed else dataset.RIGID_PARTICLE_ID
    n_rigid, n_modes = run.rigid_positions.shape[1], scores.shape[1]
    context = None
    if len(run.context):
        context = np.tile(run.context.astype(np.float32), (len(scores), 1))
    return dataset.Trajectory(
        key=key,
        particle_type=np.repeat(
            np.int64([rigid_type, dataset.MODE_PARTICLE_ID]), [n_rigid, n_modes]
        ),
        position=np.concatenate([run.rigid_positions, scores.astype(np.float32)], axis=1),
        force=run.force,
        step_context=context,
    )


def _make_metadata(
    runs: RawRuns,
    encoded: dict[str, list[EncodedRun]],
    space: subspace.Subspace,
    base: dict[str, Any] | None,
) -> dict[str, Any]:
    """Returns the metadata; with `base` the statistics are those of the dataset to fit in with."""
    if base is None:
        statistics = motion_statistics([run.trajectory for run in encoded['train']])
    else:
        statistics = {key: base[key] for key in base if key.endswith(('_mean', '_std'))}
    first = next(iter(encoded.values()))[0].trajectory

    return {
        'schema_version': SCHEMA_VERSION,
        'scene': runs.scene,
        'bounds': runs.bounds,
        'sequence_length': first.n_frames - 1,
        'frames_stored': first.n_frames,
        'default_connectivity_radius': CONNECTIVITY_RADIUS,
        'dim': DIM,
        'dt': runs.dt,
        'units': {'position': 'm', 'force': 'N', 'velocity': 'm per frame', 'dt': 's'},
        **statistics,
        'rigid_body_ref_point': None,
        'particles_rigid': first.n_rigid,
        'mode_number': first.n_modes,
        'n_soil': space.n_soil,
        'pca': {
            'file': SUBSPACE_NAME,
            'n_modes': space.n_modes,
            'centering': space.centering,
            'mean': 'scalar' if space.centering == 'scalar' else 'per_feature',
            'explained_variance_ratio': space.explained_variance_ratio[: space.n_modes].tolist(),
            'projection_floor': space.projection_floor(),
            'fitted_on': list(space.runs),
            'digest': space.digest,
        },
        **{
            key: {name: [run.details[key] for run in part] for name, part in encoded.items()}
            for key in PROJECTION_KEYS
        },
        'dataset_split': {
            name: [run.parameters['case'] for run in part] for name, part in encoded.items()
        },
        'cases': {name: [run.parameters for run in part] for name, part in encoded.items()},
    }


def _write_dataset(
    output_path: str,
    encoded: dict[str, list[EncodedRun]],
    space: subspace.Subspace,
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
            records = dataset.write_split(path, [run.trajectory for run in part])
            listed[os.path.basename(path)] = {'records': records}
        files.write_manifest(folder, listed)

    files.write_folder_atomically(output_path, fill, replace=overwrite)


def progress_bar(sequence, label: str):
    """Wraps a pass over runs in a progress bar."""
    return tqdm(sequence, desc=label, unit='run')


def summary(metadata: dict[str, Any], output_path: str) -> str:
    """Returns the closing lines: counts, projection error and motion kept by split."""
    lines = [
        f'{output_path}: scene {metadata["scene"]["name"]}, N = {metadata["n_soil"]}, '
        f'R = {metadata["particles_rigid"]}, r = {metadata["mode_number"]}, '
        f'T = {metadata["frames_stored"]}, centering {metadata["pca"]["centering"]}',
        'split    runs   truncated MSE [m^2]   RMS [mm]  farthest [mm]   motion kept',
    ]
    for name, values in metadata['projection_mse'].items():
        mse = float(np.mean(values))
        kept = mean_share(metadata['motion_kept'][name], metadata['motion_mse'][name])
        lines.append(
            f'{name:<8}{len(values):>5}{mse:>22.3e}{1e3 * mse**0.5:>11.3f}'
            f'{max(metadata["projection_max_mm"][name]):>15.2f}{100 * kept:>13.2f}%'
        )
    return '\n'.join(lines)


def define_flags() -> None:
    """Defines the flags; not at import, so that several commands can be imported together."""
    flags.DEFINE_string('raw_path', None, 'Folder of raw solver runs.', required=True)
    flags.DEFINE_string('output_path', None, 'Folder of the new dataset.', required=True)
    flags.DEFINE_integer('modes', 8, 'Number of modes r to keep.')
    flags.DEFINE_enum(
        'centering',
        'configuration',
        subspace.CENTERINGS,
        'Subtracted before the PCA: the mean position of each particle, or one number.',
    )
    flags.DEFINE_list('split', ['0.8', '0.1', '0.1'], 'Shares of train, valid and test.')
    flags.DEFINE_integer('seed', 0, 'Seed of the split.')
    flags.DEFINE_list('hold_out', [], 'Case ids that go to the test split.')
    flags.DEFINE_bool('spread', False, 'Draw valid and test evenly over the order of the cases.')
    flags.DEFINE_float('max_memory_mb', 1024.0, 'Memory of the fit in MiB, beside one run.')
    flags.DEFINE_string(
        'like',
        None,
        'Existing dataset whose subspace and statistics are used; all runs go to test.',
    )
    flags.DEFINE_bool('overwrite', False, 'Replace a finished dataset at --output_path.')


def main(_: Sequence[str]) -> None:
    """Runs the command."""
    # TensorFlow only reads and writes records here; without its kernels its banner stays away too.
    os.environ.setdefault('TF_ENABLE_ONEDNN_OPTS', '0')
    values = flags.FLAGS
    try:
        metadata = convert(
            values.raw_path,
            values.output_path,
            modes=values.modes,
            centering=values.centering,
            split=[float(share) for share in values.split],
            seed=values.seed,
            hold_out=values.hold_out,
            spread=values.spread,
            max_memory_mb=values.max_memory_mb,
            like=values.like,
            overwrite=values.overwrite,
        )
    except (ValueError, OSError) as error:
        sys.exit(f'error: {error}')
    print(summary(metadata, values.output_path))


if __name__ == '__main__':
    define_flags()
    app.run(main)
