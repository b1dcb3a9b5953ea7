"""From raw runs to what a dataset stores of them: scores, particles, and what was lost."""

from __future__ import annotations

import dataclasses
import os
import statistics
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pca_tools import dataset, matching, packing, particles
from pca_tools.metadata import DIM, PROJECTION_KEYS, SCHEMA_VERSION, union_of_bounds
from pca_tools.raw_runs import RawRun, RawRuns
from pca_tools.statistics import motion_statistics
from pca_tools.subspace import Subspace

# The truncation error is measured at these numbers of modes, and at the number that is kept.
FLOOR_MODES = (8, 16, 24, 48)
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
        floors: number of modes -> mean squared error in m^2 that so many modes leave.
        sample: packed particles and their number of frames, see `pca_tools.particles`.
    """

    trajectory: dataset.Trajectory
    parameters: dict[str, Any]
    details: dict[str, float]
    floors: dict[int, float]
    sample: tuple[bytes, int]


def encode_runs(
    runs: RawRuns,
    parts: Mapping[str, Sequence[int]],
    space: Subspace,
    n_modes: int,
    sampled: np.ndarray,
    progress=lambda sequence, label: sequence,
) -> dict[str, list[EncodedRun]]:
    """Projects all runs, one in memory at a time.

    Args:
        runs: the raw runs.
        parts: split -> indices into `runs`.
        space: subspace of at least `n_modes` modes; further ones only give floors.
        n_modes: r, modes in the records.
        sampled: int [P], particles to keep as such.
        progress: wraps the pass, called with the sequence and a label.

    Returns:
        split -> encoded runs.

    Raises:
        ValueError: a run is damaged, or its particles are not those of the subspace.
    """
    kept = space.truncated(n_modes)
    encoded: dict[str, list[EncodedRun]] = {name: [] for name in parts}
    order = [(name, index) for name, indices in parts.items() for index in indices]
    for name, index in progress(order, 'encode'):
        run = runs[index]
        _refuse_other_particles(run, space)
        scores = space.encode(run.positions)
        kept_scores = np.ascontiguousarray(scores[:, :n_modes])
        sample = run.positions[:: particles.FRAME_STRIDE, sampled]
        packed = packing.pack_steps(sample, space.initial[sampled], particles.RESOLUTION)
        encoded[name].append(
            EncodedRun(
                make_trajectory(len(encoded[name]), run, kept_scores, runs.scene),
                {'case': run.case, **run.parameters},
                projection_details(run.positions, kept, kept_scores),
                _floors(run.positions, space, scores, n_modes),
                (packed, len(sample)),
            )
        )
    return encoded


def _refuse_other_particles(run: RawRun, space: Subspace) -> None:
    """Raises if column i is not the same particle as in the subspace."""
    if run.positions.shape[1] != space.n_soil:
        raise ValueError(
            f'case {run.case}: has {run.positions.shape[1]} particles, the subspace {space.n_soil}'
        )
    first = f'case {space.runs[0]}'
    if fault := matching.order_fault(run.positions[0], space.initial, first):
        raise ValueError(f'case {run.case}: {fault}')


def projection_details(
    positions: np.ndarray, space: Subspace, scores: np.ndarray
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


def _floors(
    positions: np.ndarray, space: Subspace, scores: np.ndarray, n_modes: int
) -> dict[int, float]:
    """Returns the truncation error of one run against the number of modes, m^2.

    Components are orthonormal: each mode takes its squared scores off the squared distance to the
    mean.
    """
    energy = np.sum((positions - space.mean) ** 2)
    left = energy - np.cumsum(np.sum(scores**2, axis=(0, 2)))
    return {
        count: max(float(left[count - 1]), 0.0) / positions.size
        for count in sorted({*FLOOR_MODES, n_modes})
        if count <= space.n_modes
    }


def make_trajectory(
    key: int, run: RawRun, scores: np.ndarray, scene: dict[str, Any]
) -> dataset.Trajectory:
    """Returns the record of a run.

    Args:
        key: its place in its split.
        run: T frames.
        scores: [T, r, 3] encoded positions.
        scene: of the raw runs.
    """
    one = {'rigid_motion': scene['rigid_motion'], 'points': run.rigid_positions.shape[1]}
    types = [
        np.full(
            body['points'],
            dataset.KINEMATIC_PARTICLE_ID
            if body['rigid_motion'] == 'prescribed'
            else dataset.RIGID_PARTICLE_ID,
        )
        for body in scene.get('bodies', [one])
    ]
    context = run.step_context
    if context is None and len(run.context):
        context = np.tile(run.context.astype(np.float32), (len(scores), 1))
    series = {name: getattr(run, name) for name in dataset.FRAME_SERIES} | {'step_context': context}
    types.append(np.full(scores.shape[1], dataset.MODE_PARTICLE_ID))
    return dataset.Trajectory(
        key,
        np.concatenate(types).astype(np.int64),
        np.concatenate([run.rigid_positions, scores.astype(np.float32)], axis=1),
        **series,
    )


def make_metadata(
    world: dict[str, Any],
    encoded: dict[str, list[EncodedRun]],
    space: Subspace,
    frame_stride: int,
    base: dict[str, Any] | None,
    packed: bool,
) -> dict[str, Any]:
    """Returns the metadata of a dataset.

    Args:
        world: `scene`, `bounds` and `dt` of the runs that are new.
        encoded: split -> runs.
        space: their subspace.
        frame_stride: of the frames that it was fitted to.
        base: metadata of the dataset to fit in with, whose scene and statistics stay and whose
            bounds are widened by those of the new runs; None: statistics of train.
        packed: form of the records, see `pca_tools.dataset`.
    """
    scene, bounds = world['scene'], world['bounds']
    if base is None:
        moments = motion_statistics([run.trajectory for run in encoded['train']])
    else:
        moments = {key: base[key] for key in base if key.endswith(('_mean', '_std'))}
        scene, bounds = base['scene'], union_of_bounds([base['bounds'], bounds])
    trajectories = [run.trajectory for part in encoded.values() for run in part]
    n_frames = max(run.n_frames for run in trajectories)
    lengths = {name: [run.trajectory.n_frames for run in part] for name, part in encoded.items()}
    differ = any(run.n_frames != n_frames for run in trajectories)

    return {
        'schema_version': SCHEMA_VERSION,
        'scene': scene,
        'bounds': bounds,
        **({'packed': True} if packed else {}),
        'sequence_length': n_frames - 1,
        'frames_stored': n_frames,
        # Only where the runs differ in length: sequence_length is then the longest.
        **({'frames_of_runs': lengths} if differ else {}),
        'default_connectivity_radius': CONNECTIVITY_RADIUS,
        'dim': DIM,
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
            'modes': list(next(iter(encoded.values()))[0].floors),
            **{name: _mean_floors(part) for name, part in encoded.items()},
        },
        'particles': {name: os.path.basename(particles.sample_path('', name)) for name in encoded},
        **{
            key: {name: [run.details[key] for run in part] for name, part in encoded.items()}
            for key in PROJECTION_KEYS
        },
        'dataset_split': {
            name: [run.parameters['case'] for run in part] for name, part in encoded.items()
        },
        'cases': {name: [run.parameters for run in part] for name, part in encoded.items()},
    }


def _mean_floors(part: list[EncodedRun]) -> list[float]:
    """Returns the mean floors of a split, as many as `projection_floors.modes`, m^2."""
    return np.mean([list(run.floors.values()) for run in part], axis=0).tolist()
