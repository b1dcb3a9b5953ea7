"""Series of a run in few bytes: positions as whole steps, everything else bit for bit.

Numbers change little from frame to frame, so each one's own course in time is kept together and the
bytes of equal weight after each other; LZMA then finds most of them to be equal.

`PackedRuns` is a file of a dataset with such a series of each run of a split, read one by one. So a
dataset keeps what its modes cannot tell: a sample of the particles (`pca_tools.particles`) and the
map of heights (`pca_tools.heights`), as whole steps from `rest`: most soil rests most of the time.
"""

import abc
import lzma
import math
import os
import struct
from collections.abc import Mapping, Sequence
from typing import ClassVar, Self

import numpy as np

from pca_tools import files

FRAME_STRIDE = 4
# Arrays of a file -> kind and number of axes.
_KINDS = {
    'rest': ('f', 2), 'frames': ('i', 1), 'offsets': ('i', 1), 'data': ('u', 1),
    'frame_stride': ('i', 0), 'resolution': ('f', 0),
}  # fmt: skip

# Steps that a folded 32-bit difference can hold.
_MAX_STEPS = 2**30
_LZMA = [{'id': lzma.FILTER_LZMA2, 'preset': 6 | lzma.PRESET_EXTREME}]
# Before a series: frames, values a frame; before steps also their length, and the first frame.
_SERIES_HEAD = struct.Struct('<II')
_STEPS_HEAD = struct.Struct('<IId')
# A run of 5,000 frames and 10,000 values a frame; what claims more is damaged or hostile.
_MAX_VALUES = 5 * 10**7


def pack_steps(positions: np.ndarray, rest: np.ndarray, resolution: float) -> bytes:
    """Packs positions or heights [F, ...] (m) as whole steps of a `resolution` (m) from `rest`
    [...], differenced in time, signs folded (0, -1, 1, -2 -> 0, 1, 2, 3). ValueError: a point is
    farther from rest than a step count can hold."""
    offset = (np.asarray(positions, np.float64) - rest) / resolution
    if not np.all(np.abs(offset) < _MAX_STEPS):
        far = f'a point is {np.abs(offset).max() * resolution:.3g} m from its rest place'
        raise ValueError(f'{far}, which steps of {resolution} m cannot hold')
    steps = np.rint(offset).astype(np.int32).T  # axis, point, frame
    change = np.diff(steps, axis=-1, prepend=np.int32(0))
    return _compressed(((change << 1) ^ (change >> 31)).astype('<u4'))


def unpack_steps(data: bytes, n_frames: int, rest: np.ndarray, resolution: float) -> np.ndarray:
    """Unpacks `pack_steps`: float64 [F, ...] m, to within half a step; ValueError for bytes that
    are damaged or do not hold `n_frames` frames."""
    folded = _decompressed(data, n_frames * rest.size).reshape(*rest.shape[::-1], n_frames)
    change = (folded >> 1).astype(np.int32) ^ -(folded & 1).astype(np.int32)
    steps = np.cumsum(change, axis=-1, dtype=np.int64)
    return rest + resolution * steps.T


def pack_positions(positions: np.ndarray, resolution: float) -> bytes:
    """Packs float32 [T, P, 3] with all that `unpack_positions` needs: steps from frame 0."""
    first = np.ascontiguousarray(positions[0], '<f4')
    head = _STEPS_HEAD.pack(len(positions), len(first), resolution)
    return head + first.tobytes() + pack_steps(positions, first.astype(np.float64), resolution)


def unpack_positions(data: bytes) -> np.ndarray:
    """Returns float32 [T, P, 3], packed again the same bytes; ValueError for damaged ones."""
    n_frames, points, resolution = _head(_STEPS_HEAD, data, axes=3)
    start = _STEPS_HEAD.size + 12 * points
    if len(data) < start or not 0 < resolution < math.inf:
        raise ValueError('packed positions are damaged')
    first = np.frombuffer(data[_STEPS_HEAD.size : start], '<f4')
    if not np.isfinite(first).all():
        raise ValueError('packed positions begin with NaN or infinity')
    rest = first.reshape(points, 3).astype(np.float64)
    return unpack_steps(data[start:], n_frames, rest, resolution).astype(np.float32)


def pack_series(values: np.ndarray) -> bytes:
    """Packs float32 [T, ...] bit for bit."""
    rows = np.ascontiguousarray(values.reshape(len(values), -1).T, '<f4')
    return _SERIES_HEAD.pack(len(values), len(rows)) + _compressed(rows.view('<u4'))


def unpack_series(data: bytes) -> np.ndarray:
    """Returns float32 [T, values]; ValueError for damaged bytes."""
    n_frames, values = _head(_SERIES_HEAD, data)
    rows = _decompressed(data[_SERIES_HEAD.size :], n_frames * values).view('<f4')
    return np.ascontiguousarray(rows.reshape(values, n_frames).T.astype(np.float32))


def _compressed(numbers: np.ndarray) -> bytes:
    """LZMA of little-endian numbers of four bytes, bytes of equal weight together."""
    planes = np.ascontiguousarray(numbers.reshape(-1, 1).view(np.uint8).T)
    return lzma.compress(planes.tobytes(), lzma.FORMAT_RAW, filters=_LZMA)


def _decompressed(data: bytes, count: int) -> np.ndarray:
    """Returns `count` numbers, uint32; never unpacks more than they take."""
    try:
        decoder = lzma.LZMADecompressor(lzma.FORMAT_RAW, filters=_LZMA)
        planes = decoder.decompress(data, 4 * count + 1)
    except lzma.LZMAError as error:
        raise ValueError(f'packed numbers are damaged ({error})') from error
    if len(planes) != 4 * count:
        raise ValueError(f'packed numbers take {len(planes)} bytes, {4 * count} were expected')
    together = np.frombuffer(planes, np.uint8).reshape(4, -1)
    return np.ascontiguousarray(together.T).view('<u4').ravel()


def _head(layout: struct.Struct, data: bytes, axes: int = 1) -> tuple:
    if len(data) < layout.size:
        raise ValueError(f'packed numbers end after {len(data)} bytes')
    n_frames, points, *more = layout.unpack_from(data)
    if not 0 < n_frames * points * axes <= _MAX_VALUES:
        raise ValueError(f'packed numbers promise {n_frames} frames of {points} x {axes}')
    return n_frames, points, *more


class PackedRuns(Sequence):
    """The series of a split, unpacked one run at a time: `runs[i]` is float64 [F, ...] in metres,
    frame `f * frame_stride` of record i, to within half of `resolution`."""

    rest: np.ndarray  # float64 [a, b], metres, what the steps are counted from
    frame_stride: int  # frames of the record from one kept frame to the next
    resolution: float  # metres

    NAME: ClassVar[str]  # of the files
    TITLE: ClassVar[str]  # of what they hold, in messages
    RESOLUTION: ClassVar[float]  # metres of a step, where we write
    KINDS: ClassVar[Mapping[str, tuple[str, int]]]  # arrays beside the common ones

    @classmethod
    def path_of(cls, folder: str, split: str) -> str:
        return os.path.join(folder, f'{cls.NAME}_{split}.npz')

    @classmethod
    def pack(cls, values: np.ndarray, rest: np.ndarray) -> tuple[bytes, int]:
        """Packs the kept frames of a run [T, ...], m; returns bytes and their number."""
        kept = values[::FRAME_STRIDE]
        return pack_steps(kept, rest, cls.RESOLUTION), len(kept)

    @classmethod
    def write(
        cls,
        folder: str,
        split: str,
        packed: Sequence[tuple[bytes, int]],
        rest: np.ndarray,
        frame_stride: int = FRAME_STRIDE,
        resolution: float | None = None,
        **own: np.ndarray,
    ) -> str:
        """Writes the packed runs of a split, in the order of its records, and their `own` arrays,
        those of `KINDS`; returns the name of the file."""
        path, blobs = cls.path_of(folder, split), [data for data, _ in packed]
        files.write_npz(
            path,
            **own,
            rest=np.asarray(rest, np.float64),
            frames=np.array([count for _, count in packed], np.int32),
            offsets=np.cumsum([0, *map(len, blobs)]),
            data=np.frombuffer(b''.join(blobs), np.uint8),
            frame_stride=frame_stride,
            resolution=resolution or cls.RESOLUTION,
        )
        return os.path.basename(path)

    @classmethod
    def read(cls, folder: str, split: str) -> Self:
        """Opens the file of a split of a dataset. FileNotFoundError: the dataset has none (those
        made before there were any). ValueError: it is damaged, or not the one in the manifest."""
        path = cls.path_of(folder, split)
        if not os.path.exists(path):
            text = (
                f'this dataset holds no {cls.TITLE}; convert it again, from raw runs that have it'
            )
            raise FileNotFoundError(f'{path}: {text}')
        files.check_manifest(folder, [os.path.basename(path)])
        return cls(path)

    def __init__(self, path: str):
        """Reads a file of `write`; nothing is unpacked yet. ValueError: damaged or foreign."""
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

    @abc.abstractmethod
    def _fits(self) -> bool:
        """Whether the arrays of `KINDS` have possible shapes and values."""

    def __len__(self) -> int:
        return len(self._frames)

    def packed(self, index: int) -> tuple[bytes, int]:
        """Returns what `write` takes for one run: its bytes and its number of frames."""
        index = range(len(self))[index]
        data = self._data[self._offsets[index] : self._offsets[index + 1]].tobytes()
        return data, int(self._frames[index])

    def __getitem__(self, index: int) -> np.ndarray:  # type: ignore[override]
        data, n_frames = self.packed(index)
        try:
            return unpack_steps(data, n_frames, self.rest, self.resolution)
        except ValueError as error:
            raise ValueError(f'{self._path}: run {index}: {error}') from error
