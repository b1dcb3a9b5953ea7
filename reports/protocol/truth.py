"""What a run did, in full space: the particles of the solver where the dataset keeps them, else the
particles that its modes decode to."""

import dataclasses
import os
from typing import Any

import numpy as np

from learning_to_simulate import reading_utils
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.tool import bed
from pca_tools import dataset, particles, subspace

PARTICLES, DECODED = 'particles', 'decoded'
# Kind of runs of the case grid, which state none.
GRID = 'grid'


@dataclasses.dataclass(frozen=True)
class Truth:
    """One run of F frames of P particles, after the H frames that methods are given.

    Attributes:
      record: index in its split.
      case: number of its case.
      kind: of run, e.g. `grid`, `lift`.
      source: PARTICLES, or DECODED where the dataset holds modes only.
      frames: int [F], numbers of the frames, counted from the first of the record.
      particles: float64 [F, P, 3], m.
      start: float64 [P, 3], the same in the first frame of the record.
      cut_off: mean square, m2, of what DECODED truth lacks; it adds to squared errors of whole
        runs, since it is orthogonal to the subspace. 0 for PARTICLES.
      truncation: root mean square, mm, of what the subspace cuts off the run; None if unknown.
      motion: root mean square, mm, of the soil's displacement in the run.
      modes: float64 [T - H, r, 3] recorded scores, m.
      force: float64 [T - H, 3], N (of several bodies one behind the other), or None.
      height: float64 [T - H] of the body's mean particle, m, or None where it is given.
      torque: float64 [T - H, 3] about the body's reference point, N m, or None.
      across: the horizontal axis across the body's way.
      dt: s per frame.
      spacing: between particles of the solver, m.
    """

    record: int
    case: object
    kind: str
    source: str
    frames: np.ndarray
    particles: np.ndarray
    start: np.ndarray
    cut_off: float
    truncation: float | None
    motion: float
    modes: np.ndarray
    force: np.ndarray | None
    height: np.ndarray | None
    torque: np.ndarray | None
    across: int
    dt: float
    spacing: float

    @property
    def times(self) -> np.ndarray:
        """[F] s since the last given frame."""
        return (self.frames - (H - 1)) * self.dt


class TruthReader:
    """Reads the runs of a dataset, one at a time.

    Args:
      folder: dataset folder.

    Raises:
      FileNotFoundError: no dataset, or one without `subspace.npz` (nothing can be judged in full
        space without it).
      ValueError: a damaged or foreign file.
    """

    def __init__(self, folder: str):
        self.folder = folder
        self.metadata = dataset.read_metadata(folder)
        path = os.path.join(folder, 'subspace.npz')
        if not os.path.exists(path):
            raise FileNotFoundError(
                f'{path}: no such file; errors in full space need the subspace of the records'
            )
        self.subspace = subspace.Subspace.load(path)
        self._samples: dict[str, Any] = {}

    def sample(self, split: str):
        """The split's particle sample, or None where the dataset holds none."""
        if split not in self._samples:
            there = os.path.exists(particles.sample_path(self.folder, split))
            self._samples[split] = particles.read_sample(self.folder, split) if there else None
        return self._samples[split]

    def indices(self, split: str) -> np.ndarray:
        """int [P], which of the N particles the truth of the split holds."""
        sample = self.sample(split)
        return np.arange(self.subspace.n_soil) if sample is None else np.asarray(sample.indices)

    def decode(self, modes, indices) -> np.ndarray:
        """Particles [F, P, 3] (m) of scores [F, r, 3]; r may be less than the subspace has."""
        space, n_modes = self.subspace, modes.shape[1]
        mean = space.mean[indices] if space.mean.ndim else space.mean
        return space.components[indices, :n_modes] @ np.asarray(modes, np.float64) + mean

    def read(self, split: str):
        """Yields the `Truth` of each run of a split, in file order."""
        sample, indices = self.sample(split), self.indices(split)
        runs = dataset.read_split(self.folder, split)
        if sample is not None and len(sample) != len(runs):
            raise ValueError(
                f'{self.folder}: {split} has {len(runs)} records, its particles are of '
                f'{len(sample)} runs'
            )
        for record, run in enumerate(runs):
            yield self._truth(split, record, run, sample, indices)

    def _truth(self, split, record, run, sample, indices):
        metadata = self.metadata
        case = _of_run(metadata.get('cases'), split, record) or {}
        scores = run.position[:, run.n_rigid :].astype(np.float64)
        frames, cut_off = np.arange(H, run.n_frames), 0.0
        floor = _of_run(metadata.get('projection_mse'), split, record)
        if sample is None:
            source, positions = DECODED, self.decode(scores[H:], indices)
            start = self.decode(scores[:1], indices)
            cut_off = floor or 0.0
            truncation = None if floor is None else 1e3 * np.sqrt(floor)
        else:
            every = np.arange(len(sample[record])) * sample.frame_stride
            start, positions = sample[record][:1], sample[record][every >= H]
            source, frames = PARTICLES, every[every >= H]
            rest = positions - self.decode(scores[frames], indices)
            truncation = 1e3 * np.sqrt((rest**2).mean())
        motion = _of_run(metadata.get('motion_mse'), split, record)
        if motion is None or source == PARTICLES:
            motion = ((positions - start) ** 2).mean()
        up = metadata.get('scene', {}).get('up_axis', 1)
        driven = metadata.get('scene', {}).get('rigid_motion') == 'driven'
        body = run.position[H:, : run.n_rigid].astype(np.float64)
        force = reading_utils.force_of(run)
        return Truth(
            record=record,
            case=case.get('case', record),
            kind=case.get('kind') or GRID,
            source=source,
            frames=frames,
            particles=positions,
            start=start[0],
            cut_off=float(cut_off),
            truncation=None if truncation is None else float(truncation),
            motion=float(1e3 * np.sqrt(motion)),
            modes=scores[H:],
            force=None if force is None else force[H:],
            height=body[..., up].mean(axis=1) if driven else None,
            torque=None if run.torque is None else run.torque[H:].astype(np.float64),
            across=_across(body, up),
            dt=float(metadata['dt']),
            spacing=bed.solver_spacing(case)
            or bed.kept_spacing(self.subspace.initial),
        )


def _across(body, up):
    """The horizontal axis along which a body [T, R, 3] moves least; the last one without a body."""
    moved = np.ptp(body.mean(axis=1), axis=0) if body.shape[1] else np.zeros(3)
    return min((axis for axis in (2, 1, 0) if axis != up), key=lambda axis: moved[axis])


def _of_run(values, split, record):
    """values[split][record], or None where the metadata do not state it."""
    rows = (values or {}).get(split)
    return None if rows is None or record >= len(rows) else rows[record]
