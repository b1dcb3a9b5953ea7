"""A whole dataset in memory: made of raw runs, or read from a folder; written.

The files of a dataset are those of `pca_tools.convert`; it, `append` and `subset` only choose which
runs these are.
"""

import dataclasses
import os
import statistics
import tempfile
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

import numpy as np
from tqdm import tqdm

from pca_tools import dataset, files
from pca_tools.heights import Grid, Heights
from pca_tools.metadata import METADATA_NAME, PROJECTION_KEYS, SCHEMA_VERSION, union_of_bounds
from pca_tools.particles import ParticleSample
from pca_tools.raw_runs import RawRun, RawRuns
from pca_tools.storage.folder_lock import LOCK_NAME
from pca_tools.subspace import SUBSPACE_NAME, Subspace

# The truncation error is measured at these numbers of modes, and at the number that is kept.
FLOOR_MODES = (8, 16, 24, 48)
# DeepMind's key; the subspace graphs only scale edge features by it (the authors' value).
CONNECTIVITY_RADIUS = 0.025


@dataclasses.dataclass(frozen=True)
class EncodedRun:
    """One run in the subspace, with what its record in the metadata says."""

    trajectory: dataset.Trajectory  # the record
    parameters: dict[str, Any]  # all parameters of the case
    details: dict[str, float]  # see `projection_details`
    floors: dict[int, float]  # number of modes -> mean squared error in m^2 that they leave
    sample: tuple[bytes, int]  # packed particles, number of frames: `pca_tools.particles`
    heights: tuple[bytes, int] | None = None  # the same of the map: `pca_tools.heights`


Parts = Mapping[str, Sequence[EncodedRun]]  # by split


@dataclasses.dataclass(frozen=True)
class Contents:
    """A whole dataset in memory."""

    parts: Parts  # split -> runs, in the order of their records
    space: Subspace  # their subspace
    sampled: np.ndarray  # int [P], which particles are kept as such
    metadata: dict[str, Any]  # of `make_metadata`
    grid: Grid | None = None  # where the map of heights of every run lies; None without one

    def with_parts(self, parts: Parts, world: Mapping[str, Any] | None = None) -> Self:
        """Returns a dataset of other runs in the same subspace, with the same statistics; `world`
        is `scene`, `bounds` and `dt` of those that are new. Splits without runs are left out."""
        parts, base = {split: part for split, part in parts.items() if part}, self.metadata
        packed = base.get('packed', False)
        metadata = make_metadata(parts, self.space, world or base, base, packed=packed)
        return dataclasses.replace(self, parts=parts, metadata=metadata)


def encode_runs(
    runs: RawRuns, indices: Sequence[int], space: Subspace, n_modes: int, sampled: np.ndarray
) -> list[EncodedRun]:
    """Projects the raw runs `indices`, one in memory at a time. The space has at least `n_modes`
    modes, r, those of the records; further ones only give floors. `sampled`, int [P], are the
    particles to keep as such."""
    kept, encoded = space.truncated(n_modes), []
    for index in tqdm(indices, desc='encode', unit='run'):
        run = runs[index]
        scores, maps = space.encode(run.positions), run.heights
        kept_scores = np.ascontiguousarray(scores[:, :n_modes])
        made = EncodedRun(
            _trajectory(run, kept_scores, runs.scene),
            {'case': run.case} | run.parameters | {'case': run.case},
            projection_details(run.positions, kept, kept_scores),
            _floors(run.positions, space, scores, n_modes),
            ParticleSample.pack(run.positions[:, sampled], space.initial[sampled]),
            None if maps is None else Heights.pack(maps, np.zeros(maps.shape[1:])),
        )
        encoded.append(made)
    return encoded


def projection_details(
    positions: np.ndarray, space: Subspace, scores: np.ndarray
) -> dict[str, float]:
    """Measures what is lost between particles [T, N, 3] (m) and their scores [T, r, 3] (m):
    `projection_mse` in m^2 over frames, particles and axes; `projection_max_mm`, the farthest
    particle in mm; `motion_mse`, mean square of the displacement from frame 0 in m^2;
    `motion_kept`, the share of it that lies in the subspace."""
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


def _floors(
    positions: np.ndarray, space: Subspace, scores: np.ndarray, n_modes: int
) -> dict[int, float]:
    """Truncation error of one run against the number of modes, m^2. Components are orthonormal:
    each mode takes its squared scores off the squared distance to the mean."""
    energy = np.sum((positions - space.mean) ** 2)
    left = energy - np.cumsum(np.sum(scores**2, axis=(0, 2)))
    return {
        count: max(float(left[count - 1]), 0.0) / positions.size
        for count in sorted({*FLOOR_MODES, n_modes})
        if count <= space.n_modes
    }


def _trajectory(run: RawRun, scores: np.ndarray, scene: dict[str, Any]) -> dataset.Trajectory:
    one = {'rigid_motion': scene['rigid_motion'], 'points': run.rigid_positions.shape[1]}
    bodies = scene.get('bodies', [one])
    kinds = [dataset.rigid_type(body['rigid_motion']) for body in bodies]
    counts = [body['points'] for body in bodies]
    types = np.repeat([*kinds, dataset.MODE_PARTICLE_ID], [*counts, scores.shape[1]])
    context = run.step_context
    if context is None and len(run.context):
        context = np.tile(run.context.astype(np.float32), (len(scores), 1))
    series = {name: getattr(run, name) for name in dataset.FRAME_SERIES} | {'step_context': context}
    position = np.concatenate([run.rigid_positions, scores.astype(np.float32)], axis=1)
    return dataset.Trajectory(0, types.astype(np.int64), position, **series)


def load(data_path: str) -> Contents:
    """Reads a dataset with a particle sample: its runs as they were when it was written. The
    truncation error by number of modes is kept for a split, not for a run: each has its mean.
    FileNotFoundError, ValueError: there is none, or its files do not fit each other."""
    metadata, space = load_space(data_path)
    listed = files.check_manifest(data_path, ()) or {}
    parts, grids = {}, {}
    for split, cases in metadata['cases'].items():
        sample = ParticleSample.read(data_path, split)
        floors = metadata['projection_floors']
        by_modes = dict(zip(floors['modes'], floors[split]))
        has_heights = Heights.path_of('', split) in listed
        terrain = Heights.read(data_path, split) if has_heights else None
        grids[split] = terrain and terrain.grid
        parts[split] = [
            EncodedRun(
                trajectory,
                cases[index],
                {key: metadata[key][split][index] for key in PROJECTION_KEYS},
                {count: mse for count, mse in by_modes.items() if count <= space.n_modes},
                sample.packed(index),
                terrain and terrain.packed(index),
            )
            for index, trajectory in enumerate(dataset.read_split(data_path, split))
        ]
    if len(set(grids.values())) > 1:
        raise ValueError(f'{data_path}: height maps differ by split ({grids}); convert again')
    return Contents(parts, space, sample.indices, metadata, next(iter(grids.values()), None))


def load_space(data_path: str) -> tuple[dict[str, Any], Subspace]:
    """Returns metadata and subspace of a dataset, without its runs; raises as `load`."""
    metadata = dataset.read_metadata(data_path)
    space = Subspace.load(os.path.join(data_path, SUBSPACE_NAME))
    if metadata.get('pca', {}).get('digest') != space.digest:
        raise ValueError(f'{data_path}: {SUBSPACE_NAME} is not the one that the metadata names')
    return metadata, space


def refuse_occupied_output(output_path: str, overwrite: bool) -> None:
    """Raises ValueError, with what to do, unless the output is absent, empty, or a finished dataset
    that may be replaced; OSError if nothing can be written beside it."""
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
            f'{output_path}: is not empty and not a finished dataset; name another folder'
        )
    foreign = held - set(files.check_manifest(output_path) or ()) - {files.MANIFEST_NAME}
    if foreign:
        found = f'holds files that are not of the dataset ({sorted(foreign)[:5]})'
        raise ValueError(f'{output_path}: {found}; move them away, or name another folder')
    if not overwrite:
        raise ValueError(f'{output_path}: holds a finished dataset; use --overwrite to replace it')


def write(output_path: str, contents: Contents, overwrite: bool) -> None:
    """Writes a dataset as a whole: all files beside the output, the manifest last."""
    space, metadata, sampled = contents.space, contents.metadata, contents.sampled

    def fill(folder: str) -> None:
        listed: dict[str, dict[str, Any]] = {METADATA_NAME: {}, SUBSPACE_NAME: {}}
        files.write_json(os.path.join(folder, METADATA_NAME), metadata)
        space.save(os.path.join(folder, SUBSPACE_NAME))
        for name, part in contents.parts.items():
            path = dataset.split_path(folder, name)
            runs = [dataclasses.replace(run.trajectory, key=i) for i, run in enumerate(part)]
            records = dataset.write_split(path, runs, metadata.get('packed', False))
            listed[os.path.basename(path)] = {'records': records}
            packed, rest = [run.sample for run in part], space.initial[sampled]
            file = ParticleSample.write(folder, name, packed, rest, indices=np.int32(sampled))
            listed[file] = {}
            if grid := contents.grid:
                maps = [run.heights for run in part if run.heights]  # of every run
                place = {'corner': np.float64(grid.corner), 'cell': np.float64(grid.cell)}
                file = Heights.write(folder, name, maps, np.zeros(grid.shape), **place)
                listed[file] = {}
        files.write_manifest(folder, listed)

    files.write_folder_atomically(output_path, fill, replace=overwrite)


def make_metadata(
    parts: Parts,
    space: Subspace,
    world: dict[str, Any],
    base: dict[str, Any] | None = None,
    frame_stride: int = 1,
    packed: bool = True,
) -> dict[str, Any]:
    """Returns the metadata of a dataset of runs by split. `world` is `scene`, `bounds` and `dt` of
    those that are new; `base` the metadata of a dataset to fit in with, whose scene and statistics
    stay and whose bounds are widened by those of the new runs, None for statistics of train;
    `frame_stride` that of the frames that the subspace was fitted to; `packed` the form of the
    records (`dataset`)."""
    scene, bounds = world['scene'], world['bounds']
    if base is None:
        moments = motion_statistics([run.trajectory for run in parts['train']])
    else:
        moments = {key: base[key] for key in base if key.endswith(('_mean', '_std'))}
        scene, bounds = base['scene'], union_of_bounds([base['bounds'], bounds])
    trajectories = [run.trajectory for part in parts.values() for run in part]
    n_frames = max(run.n_frames for run in trajectories)

    def of_runs(value: Callable[[EncodedRun], Any]) -> dict[str, list]:
        return {split: [value(run) for run in part] for split, part in parts.items()}

    lengths = {'frames_of_runs': of_runs(lambda run: run.trajectory.n_frames)}
    return {
        'schema_version': SCHEMA_VERSION,
        'scene': scene,
        'bounds': bounds,
        **({'packed': True} if packed else {}),
        'sequence_length': n_frames - 1,
        'frames_stored': n_frames,
        # Only where the runs differ in length: sequence_length is then the longest.
        **(lengths if len({run.n_frames for run in trajectories}) > 1 else {}),
        'default_connectivity_radius': CONNECTIVITY_RADIUS,
        'dim': 3,
        'dt': world['dt'],
        'units': {
            'position': 'm',
            'force': 'N',
            'torque': 'N m',
            'velocity': 'm per frame',
            'dt': 's',
        },
        **moments,
        'rigid_body_ref_point': None,
        'particles_rigid': statistics.mode(run.n_rigid for run in trajectories),
        'mode_number': space.n_modes,
        'n_soil': space.n_soil,
        'pca': {
            'file': SUBSPACE_NAME,
            'n_modes': space.n_modes,
            'centering': space.centering,
            'mean': 'scalar' if space.centering == 'scalar' else 'per_feature',
            'explained_variance_ratio': space.explained_variance_ratio[: space.n_modes].tolist(),
            'projection_floor': space.projection_floor(),
            'frame_stride': frame_stride if base is None else base['pca'].get('frame_stride', 1),
            'fitted_on': list(space.runs),
            'digest': space.digest,
        },
        'projection_floors': {
            'modes': list(next(iter(parts.values()))[0].floors),
            **{
                name: np.mean([list(run.floors.values()) for run in part], axis=0).tolist()
                for name, part in parts.items()
            },
        },
        'particles': {name: ParticleSample.path_of('', name) for name in parts},
        **{
            key: {split: [run.details[key] for run in part] for split, part in parts.items()}
            for key in PROJECTION_KEYS
        },
        'dataset_split': of_runs(lambda run: run.parameters['case']),
        'cases': of_runs(lambda run: run.parameters),
    }


def motion_statistics(trajectories: Sequence[dataset.Trajectory]) -> dict[str, list[float]]:
    """Computes the normalisation statistics of DeepMind's metadata and of the authors': `vel_mean,
    vel_std, acc_mean, acc_std` [3] per frame (v_t = x_t - x_{t-1}, a_t = v_t - v_{t-1}, not divided
    by dt), over all nodes that are not kinematic; the same of `rigid_body_force`,
    `rigid_body_torque` [3] and `context` [C] where the runs have them."""
    moving = [
        run.position[:, run.particle_type != dataset.KINEMATIC_PARTICLE_ID].astype(np.float64)
        for run in trajectories
    ]
    statistics = {}
    for name, samples in (
        ('vel', [np.diff(positions, axis=0) for positions in moving]),
        ('acc', [np.diff(positions, n=2, axis=0) for positions in moving]),
        ('rigid_body_force', [run.force for run in trajectories]),
        ('rigid_body_torque', [run.torque for run in trajectories]),
        ('context', [run.step_context for run in trajectories]),
    ):
        held = [sample for sample in samples if sample is not None]
        if held:
            rows = np.concatenate([sample.reshape(-1, sample.shape[-1]) for sample in held])
            rows = rows.astype(np.float64)
            statistics[f'{name}_mean'] = rows.mean(axis=0).tolist()
            statistics[f'{name}_std'] = rows.std(axis=0).tolist()
    return statistics


def mean_share(shares: Sequence[float], weights: Sequence[float]) -> float:
    """Returns the mean of shares of energy, each weighted by its energy; 1 if there is none."""
    total = float(np.sum(weights))
    return float(np.dot(shares, weights)) / total if total > 0 else 1.0
