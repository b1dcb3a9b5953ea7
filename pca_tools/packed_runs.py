"""A series of each run of a split in one file of a dataset, packed; runs are read one by one.

So a dataset keeps what its modes cannot tell: a sample of the particles (`pca_tools.particles`) and
the map of heights (`pca_tools.heights`). A run is whole steps of `resolution` from `rest`
(`pca_tools.packing`): most soil rests most of the time, so nearly all bytes are 0.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

import numpy as np

from pca_tools import files, packing

FRAME_STRIDE = 4
# Arrays of a file -> kind and number of axes.
_KINDS = {
    'rest': ('f', 2), 'frames': ('i', 1), 'offsets': ('i', 1), 'data': ('u', 1),
    'frame_stride': ('i', 0), 'resolution': ('f', 0),
}  # fmt: skip


def write_runs(
    path: str,
    packed: Sequence[tuple[bytes, int]],
    rest: np.ndarray,
    frame_stride: int,
    resolution: float,
    **own: Any,
) -> None:
    """Writes the packed runs of a split, in the order of its records.

    Args:
        path: of the file.
        packed: bytes of `packing.pack_steps` and number of frames F of each run.
        rest, frame_stride, resolution: see `PackedRuns`.
        **own: further arrays, `KINDS` of its reader.
    """
    blobs = [data for data, _ in packed]
    files.write_npz(
        path,
        **own,
        rest=np.asarray(rest, np.float64),
        frames=np.array([count for _, count in packed], np.int32),
        offsets=np.cumsum([0, *map(len, blobs)]),
        data=np.frombuffer(b''.join(blobs), np.uint8),
        frame_stride=frame_stride,
        resolution=resolution,
    )


class PackedRuns(Sequence):
    """The series of a split, unpacked one run at a time: `runs[i]` is float64 [F, ...] in metres,
    frame `f * frame_stride` of record i, to within half of `resolution`.

    Attributes:
        rest: float64 [a, b], metres, what the steps are counted from.
        frame_stride: frames of the record from one kept frame to the next.
        resolution: metres.
    """

    # Of the files, of one of them in messages, and the arrays that it has beside the common ones.
    NAME: ClassVar[str]
    TITLE: ClassVar[str]
    KINDS: ClassVar[Mapping[str, tuple[str, int]]]

    @classmethod
    def path_of(cls, folder: str, split: str) -> str:
        return os.path.join(folder, f'{cls.NAME}_{split}.npz')

    @classmethod
    def read(cls, folder: str, split: str) -> Self:
        """Opens the file of a split of a dataset.

        Raises:
            FileNotFoundError: the dataset has none (those made before there were any).
            ValueError: it is damaged, or not the one in the manifest.
        """
        path = cls.path_of(folder, split)
        if not os.path.exists(path):
            raise FileNotFoundError(
                f'{path}: this dataset holds no {cls.TITLE}; convert it again, from raw runs that '
                'have it'
            )
        files.check_manifest(folder, [os.path.basename(path)])
        return cls(path)

    def __init__(self, path: str):
        """Reads a file of `write_runs`; nothing is unpacked yet. ValueError: damaged or foreign."""
        arrays = files.read_npz(path)
        for name, (kind, ndim) in {**_KINDS, **self.KINDS}.items():
            array = arrays.get(name)
            if array is None or array.dtype.kind != kind or array.ndim != ndim:
                raise ValueError(f'{path}: is not a {self.TITLE}: {name} is missing or foreign')
        self._path, self._data = path, arrays['data']
        self._frames, self._offsets = arrays['frames'], arrays['offsets']
        for name in self.KINDS:
            setattr(self, name, arrays[name])
        self.rest = arrays['rest']
        self.frame_stride = int(arrays['frame_stride'])
        self.resolution = float(arrays['resolution'])
        if (
            self._data.dtype != np.uint8
            or not np.all(np.isfinite(self.rest))
            or not 0 < self.resolution < np.inf
            or self.frame_stride < 1
            or len(self._offsets) != len(self._frames) + 1
            or self._offsets[0] != 0
            or self._offsets[-1] != len(self._data)
            or np.any(np.diff(self._offsets) < 0)
            or np.any(self._frames < 1)
            or np.any(self._frames.astype(np.int64) * self.rest.size * 8 > files.MAX_BYTES)
            or not self._fits()
        ):
            raise ValueError(f'{path}: is not a {self.TITLE}: its arrays do not fit each other')

    def _fits(self) -> bool:
        """Whether the arrays of `KINDS` have possible shapes and values."""
        raise NotImplementedError

    def __len__(self) -> int:
        return len(self._frames)

    def packed(self, index: int) -> tuple[bytes, int]:
        """Returns what `write_runs` takes for one run: its bytes and its number of frames."""
        index = range(len(self))[index]
        data = self._data[self._offsets[index] : self._offsets[index + 1]].tobytes()
        return data, int(self._frames[index])

    def __getitem__(self, index: int) -> np.ndarray:  # type: ignore[override]
        data, n_frames = self.packed(index)
        try:
            return packing.unpack_steps(data, n_frames, self.rest, self.resolution)
        except ValueError as error:
            raise ValueError(f'{self._path}: run {index}: {error}') from error
