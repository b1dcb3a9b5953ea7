"""A sample of the soil's particles beside the records: `particles_<split>.npz`.

Records hold mode scores, which know nothing of what the subspace cuts off. So that every method
can be judged on particles, and particle methods trained, the converter also keeps a fixed sample of
the bed: P particles spread over it, every fourth frame, to within 0.02 mm.

A run is stored as whole steps of `resolution` from the rest place (`pca_tools.packing`): most
particles rest most of the time, so nearly all bytes are 0. Runs can be read one by one.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from pca_tools import files, packing
from pca_tools.metadata import DIM

SAMPLE_SIZE = 600
FRAME_STRIDE = 4
# Metres; positions are kept to half of it.
RESOLUTION = 4e-5
SEED = 0
_KINDS = {
    'indices': ('i', 1), 'rest': ('f', 2), 'frames': ('i', 1), 'offsets': ('i', 1),
    'data': ('u', 1), 'frame_stride': ('i', 0), 'resolution': ('f', 0),
}  # fmt: skip


def sample_path(folder: str, split: str) -> str:
    """Returns the path of a split's particle sample."""
    return os.path.join(folder, f'particles_{split}.npz')


def choose_particles(points: np.ndarray, count: int = SAMPLE_SIZE, seed: int = SEED) -> np.ndarray:
    """Draws particles that are spread over the bed.

    The points are halved along their longest extent until there are `count` groups of nearly equal
    size, and one point of each is drawn: no region is missed and none counts twice.

    Args:
        points: [N, D] positions.
        count: P; all points are taken where there are not more.
        seed: of the draws.

    Returns:
        int32 [P] indices, ascending.
    """
    points = np.asarray(points, np.float64)
    if count >= len(points):
        return np.arange(len(points), dtype=np.int32)
    rng = np.random.default_rng(seed)
    groups = [(np.arange(len(points)), count)]
    chosen = []
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


def write_sample(
    path: str,
    packed: Sequence[tuple[bytes, int]],
    indices: np.ndarray,
    rest: np.ndarray,
    frame_stride: int = FRAME_STRIDE,
    resolution: float = RESOLUTION,
) -> None:
    """Writes the packed runs of a split, in the order of its records.

    Args:
        path: of the file.
        packed: bytes of `packing.pack_steps` and number of frames F of each run.
        indices, rest, frame_stride, resolution: see `ParticleSample`.
    """
    blobs = [data for data, _ in packed]
    files.write_npz(
        path,
        indices=np.asarray(indices, np.int32),
        rest=np.asarray(rest, np.float64),
        frames=np.array([count for _, count in packed], np.int32),
        offsets=np.cumsum([0, *map(len, blobs)]),
        data=np.frombuffer(b''.join(blobs), np.uint8),
        frame_stride=frame_stride,
        resolution=resolution,
    )


class ParticleSample(Sequence):
    """The particles of a split, unpacked one run at a time.

    `sample[i]` is float64 [F, P, 3] in metres: particle `indices[p]` in frame `f * frame_stride` of
    record i, to within half of `resolution`.

    Attributes:
        indices: int32 [P], columns of the raw runs and rows of the subspace.
        rest: float64 [P, 3], their places in frame 0 of the first training run, metres.
        frame_stride: frames of the record from one kept frame to the next.
        resolution: metres.
    """

    def __init__(self, path: str):
        """Reads a file of `write_sample`; nothing is unpacked yet.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is damaged or foreign.
        """
        arrays = files.read_npz(path)
        for name, (kind, ndim) in _KINDS.items():
            array = arrays.get(name)
            if array is None or array.dtype.kind != kind or array.ndim != ndim:
                raise ValueError(f'{path}: is not a particle sample: {name} is missing or foreign')
        self._path, self._data = path, arrays['data']
        self._frames, self._offsets = arrays['frames'], arrays['offsets']
        self.indices, self.rest = arrays['indices'], arrays['rest']
        self.frame_stride = int(arrays['frame_stride'])
        self.resolution = float(arrays['resolution'])
        if (
            self._data.dtype != np.uint8
            or self.rest.shape != (len(self.indices), DIM)
            or not np.all(np.isfinite(self.rest))
            or not 0 < self.resolution < np.inf
            or self.frame_stride < 1
            or np.any(np.diff(self.indices, prepend=-1) < 1)
            or len(self._offsets) != len(self._frames) + 1
            or self._offsets[0] != 0
            or self._offsets[-1] != len(self._data)
            or np.any(np.diff(self._offsets) < 0)
            or np.any(self._frames < 1)
            or np.any(self._frames.astype(np.int64) * self.rest.size * 8 > files.MAX_BYTES)
        ):
            raise ValueError(f'{path}: is not a particle sample: its arrays do not fit each other')

    def __len__(self) -> int:
        return len(self._frames)

    def packed(self, index: int) -> tuple[bytes, int]:
        """Returns what `write_sample` takes for one run: its bytes and its number of frames."""
        index = range(len(self))[index]
        data = self._data[self._offsets[index] : self._offsets[index + 1]].tobytes()
        return data, int(self._frames[index])

    def __getitem__(self, index: int) -> np.ndarray:  # type: ignore[override]
        data, n_frames = self.packed(index)
        try:
            return packing.unpack_steps(data, n_frames, self.rest, self.resolution)
        except ValueError as error:
            raise ValueError(f'{self._path}: run {index}: {error}') from error


def read_sample(folder: str, split: str) -> ParticleSample:
    """Opens the particle sample of a split of a dataset.

    Raises:
        FileNotFoundError: the dataset has none (those made before there were samples).
        ValueError: it is damaged, or not the one in the manifest.
    """
    path = sample_path(folder, split)
    if not os.path.exists(path):
        raise FileNotFoundError(f'{path}: this dataset holds no particle sample; convert it again')
    files.check_manifest(folder, [os.path.basename(path)])
    return ParticleSample(path)
