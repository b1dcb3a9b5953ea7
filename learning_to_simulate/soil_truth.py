"""What the soil of a recorded run did, and how far a prediction of networks in the subspace is
from it.

The error is the root mean square over frames, particles and axes, in full space, over the solver's
own particles. Where a dataset holds a sample of these (`pca_tools.particles`), it is the truth.
Records alone hold mode scores. The modes are orthonormal, so the squared error of all particles is

    sum of squared score errors / (D N) + truncation error,

the last term as the converter stated it; where nobody did, the error is one in the subspace.
"""

import dataclasses
import os
from typing import Any

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from pca_tools import dataset, particles
from pca_tools.subspace import Subspace

# What an error is taken over, as it is printed.
PARTICLES = "over the solver's particles"
WITH_CUT_OFF = 'in full space: of the modes, and what they cut off'
SUBSPACE = 'in the subspace'


@dataclasses.dataclass(frozen=True, eq=False)
class SoilTruth:
    """The soil of one run in F frames after the H given ones.

    Attributes:
      frames: int [F], counted from the first of the record.
      particles: float64 [F, P, 3], m; mode scores where there is no subspace to decode them with.
      start: float64 [P, 3], the same in the first frame of the record.
      indices: int [P], which of the N particles of the subspace they are.
      space: PARTICLES, WITH_CUT_OFF or SUBSPACE.
      cut_off: m2, what is added to mean squares of whole runs: 0 but for WITH_CUT_OFF.
      count: particles that squared errors are divided by: P, or N of mode scores.
      components, mean: float64 [P, r] and [P, 3] (or a number) decode modes; None of mode scores.
    """

    frames: np.ndarray
    particles: np.ndarray
    start: np.ndarray
    indices: np.ndarray
    space: str
    cut_off: float
    count: int
    components: np.ndarray | None = None
    mean: Any = 0.0

    def decode(self, modes) -> np.ndarray:
        """Particles [F', P, 3], m, of scores [F', r', 3]; left-out modes say 0."""
        modes = np.asarray(modes, np.float64)
        if self.components is not None:
            return self.components[:, : modes.shape[1]] @ modes + self.mean
        left = self.particles.shape[1] - modes.shape[1]
        return np.pad(modes, ((0, 0), (0, left), (0, 0)))

    def of_modes(self, modes) -> np.ndarray:
        """Predicted particles, as far as the prediction goes, of its scores [T' - H, r', 3]."""
        return self.decode(modes[self.frames[self.frames < H + len(modes)] - H])

    def of_particles(self, stored, frames, indices) -> np.ndarray:
        """Predicted particles [F, P, 3] of those [F', P', 3], m, that a method wrote, in frames int
        [F'] and of indices int [P']; ValueError where they do not fit each other, or lack frames or
        particles."""
        stored, asked = np.asarray(stored, np.float64), (self.frames, self.indices)
        if stored.shape[:2] != (len(frames), len(indices)):
            raise ValueError(
                f'predicted_particles {stored.shape} for {len(frames)} frames and {len(indices)} '
                f'particles'
            )
        places = [{int(n): i for i, n in enumerate(given)} for given in (frames, indices)]
        missing = [len(set(which.tolist()) - at.keys()) for at, which in zip(places, asked)]
        if any(missing):
            raise ValueError(
                f'predicted_particles: lacks {missing[0]} frames and {missing[1]} particles of the '
                f'truth'
            )
        rows, columns = ([at[int(n)] for n in which] for at, which in zip(places, asked))
        return stored[np.ix_(rows, columns)]

    def of_rollout(self, modes, arrays) -> np.ndarray:
        """Predicted particles of a rollout: its own where its `arrays` hold them, else of modes."""
        if 'predicted_particles' not in arrays:
            return self.of_modes(modes)
        names = 'predicted_particles', 'particle_frames', 'particle_indices'
        return self.of_particles(*(arrays[name] for name in names))

    def mean_square(self, predicted) -> np.ndarray:
        """Mean squared error [F], m2, of predicted particles [F, P, 3] of the first F frames; what
        modes cut off is not in it."""
        square = (predicted - self.particles[: len(predicted)]) ** 2
        return square.sum(axis=(1, 2)) / (3 * self.count)

    def soil_mm(self, predicted) -> float:
        """The error of soil, mm: root mean square over all frames."""
        return float(1e3 * np.sqrt(self.mean_square(predicted).mean() + self.cut_off))


class TruthReader:
    """Reads the soil of the runs of a dataset folder; '' where there are records alone. `subspace`
    is that of the records, or None where the folder has none. FileNotFoundError, ValueError: no
    dataset, or a damaged or foreign file."""

    def __init__(self, folder: str, metadata: dict | None = None):
        self.folder = folder
        self.metadata = dataset.read_metadata(folder) if metadata is None else metadata
        path = os.path.join(folder, 'subspace.npz')
        self.subspace = Subspace.load(path) if folder and os.path.exists(path) else None
        self._samples: dict[str, Any] = {}

    def sample(self, split: str):
        """The split's particle sample, or None where the dataset holds none."""
        if split not in self._samples:
            there = os.path.exists(particles.sample_path(self.folder, split))
            self._samples[split] = particles.read_sample(self.folder, split) if there else None
        return self._samples[split]

    def read(self, split: str | None, record: int | None, modes, n_soil: int | None) -> SoilTruth:
        """The soil of a run (split and record; None where they are not known: then modes are the
        truth) with recorded scores float64 [T, r, 3]; n_soil is N, for a dataset without a
        subspace. ValueError for a sample of other runs than the records."""
        space, floor = self.subspace, of_run(self.metadata.get('projection_mse'), split, record)
        if space is None or modes.shape[1] > space.n_modes:
            return of_nodes(modes, n_soil or modes.shape[1], floor)
        sample = None if split is None or record is None else self.sample(split)
        indices = np.arange(space.n_soil) if sample is None else np.asarray(sample.indices)
        mean = space.mean[indices] if np.ndim(space.mean) else space.mean
        truth = of_nodes(modes, len(indices), floor)
        found = dataclasses.replace(
            truth, components=space.components[indices], mean=mean, indices=indices
        )
        if sample is None:
            decoded, start = found.decode(modes[H:]), found.decode(modes[:1])[0]
            return dataclasses.replace(found, particles=decoded, start=start)
        if record >= len(sample):
            raise ValueError(
                f'{self.folder}: {split} has a record {record}, its particles are of {len(sample)} '
                f'runs'
            )
        every = np.arange(len(sample[record])) * sample.frame_stride
        late = (every >= H) & (every < len(modes))
        return dataclasses.replace(
            found,
            frames=every[late],
            particles=sample[record][late],
            start=sample[record][0],
            space=PARTICLES,
            cut_off=0.0,
        )


def of_nodes(nodes, n_soil: int, floor: float | None = None, space: str = '') -> SoilTruth:
    """The soil of a run as its record has it: nodes float64 [T, r, 3], mode scores, or the
    particles of a record without modes, which stand for `n_soil` particles N. `floor` is the
    truncation error of the run, m2, or None where it is not known; `space` what its errors are
    called, '' for that of modes."""
    return SoilTruth(
        frames=np.arange(H, len(nodes)),
        particles=nodes[H:],
        start=nodes[0],
        indices=np.arange(nodes.shape[1]),
        space=space or (SUBSPACE if floor is None else WITH_CUT_OFF),
        cut_off=float(floor or 0.0),
        count=n_soil,
    )


def of_run(values, split, record):
    """values[split][record], or None where the metadata do not state it."""
    rows = (values or {}).get(split)
    return None if rows is None or record is None or record >= len(rows) else rows[record]
