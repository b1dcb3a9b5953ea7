"""A sample of the soil's particles beside the records: `particles_<split>.npz`.

Records hold mode scores, which know nothing of what the subspace cuts off. So that every method
can be judged on particles, and particle methods trained, the converter also keeps a fixed sample of
the bed: P particles spread over it, every fourth frame, to within 0.02 mm.

A run is stored as whole steps of `resolution` from the rest place (`pca_tools.compression`): most
particles rest most of the time, so nearly all bytes are 0. Runs can be read one by one.
"""

import numpy as np

from pca_tools.compression import PackedRuns
from pca_tools.metadata import DIM

SAMPLE_SIZE = 600
SEED = 0


def choose_particles(points: np.ndarray) -> np.ndarray:
    """Draws particles that are spread over the bed, int32 [P], ascending, of `points` [N, 3].

    The points are halved along their longest extent until there are `SAMPLE_SIZE` groups of nearly
    equal size, and one point of each is drawn: no region is missed and none counts twice.
    """
    points = np.asarray(points, np.float64)
    if len(points) <= SAMPLE_SIZE:
        return np.arange(len(points), dtype=np.int32)
    rng = np.random.default_rng(SEED)
    groups, chosen = [(np.arange(len(points)), SAMPLE_SIZE)], []
    while groups:
        members, wanted = groups.pop()
        if wanted == 1:
            chosen.append(int(rng.choice(members)))
            continue
        axis = int(np.argmax(np.ptp(points[members], axis=0)))
        members = members[np.argsort(points[members, axis], kind='stable')]
        half = wanted // 2
        cut = max(half, min(len(members) - (wanted - half), len(members) * half // wanted))
        groups += [(members[:cut], half), (members[cut:], wanted - half)]
    return np.sort(np.int32(chosen))


class ParticleSample(PackedRuns):
    """The particles of a split, unpacked one run at a time.

    `sample[i]` is float64 [F, P, 3] in metres: particle `indices[p]` in frame `f * frame_stride` of
    record i, to within half of `resolution`; `rest` [P, 3] are their places in frame 0 of the first
    training run.
    """

    NAME, TITLE, KINDS = 'particles', 'particle sample', {'indices': ('i', 1)}
    RESOLUTION = 4e-5

    indices: np.ndarray  # int32 [P], columns of the raw runs and rows of the subspace

    def __str__(self) -> str:
        return f'{len(self.indices)} particles'

    def _fits(self) -> bool:
        ascending = not np.any(np.diff(self.indices, prepend=-1) < 1)
        return self.rest.shape == (len(self.indices), DIM) and ascending


sample_path, read_sample = ParticleSample.path_of, ParticleSample.read
