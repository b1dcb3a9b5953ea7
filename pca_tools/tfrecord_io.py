"""TFRecord files of `tf.train.SequenceExample` records: the only part of `pca_tools` that uses
TensorFlow.

TensorFlow checks the CRC32C of headers and data, but it crashes on a header that promises more than
memory holds, and it takes a file cut at a record boundary for a shorter file. So the headers are
walked in Python first; counts and sizes of whole files are the manifest's business
(`pca_tools.files`).

Framing of one record: length (uint64 little-endian), masked CRC32C of the length, data, masked
CRC32C of the data (https://www.tensorflow.org/tutorials/load_data/tfrecord).
"""

import dataclasses
import os
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Self

import numpy as np

from pca_tools import files

# One trajectory of ours is 0.1 MB; a full-space one of 5000 particles x 321 frames is 20 MB.
MAX_RECORD_BYTES = 2**30
_HEADER_BYTES = 12
_FOOTER_BYTES = 4
_PACKED = 'packed/'


@dataclasses.dataclass(frozen=True)
class SequenceRecord:
    """The bytes of one SequenceExample, before they are given a shape."""

    key: int  # int64 context feature `key`
    particle_type: bytes  # bytes of the context feature `particle_type` (little-endian int64)
    frames: dict[str, list[bytes]]  # feature -> one value per frame (little-endian float32)
    # Series name -> bytes of `compression`, in place of frames; context features of the names
    # `packed/<name>`
    packed: dict[str, bytes] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(
        cls, key: int, particle_type: np.ndarray, series: Mapping[str, np.ndarray | None]
    ) -> Self:
        """Returns the record of series [T, ...], one buffer a frame; None is left out."""
        frames = {
            name: [frame.tobytes() for frame in np.ascontiguousarray(values, '<f4')]
            for name, values in series.items()
            if values is not None
        }
        return cls(int(key), np.ascontiguousarray(particle_type, '<i8').tobytes(), frames)

    def node_types(self, where: str) -> np.ndarray:
        """Returns the particle types, int64 [V]; ValueError, with `where`, for no such row."""
        size = len(self.particle_type)
        if size % 8 or not size:
            raise ValueError(f'{where}: particle_type has {size} bytes, not whole int64 numbers')
        return np.frombuffer(self.particle_type, '<i8').astype(np.int64)

    def series(self, name: str, where: str) -> np.ndarray:
        """Returns a series as float32 [T, values]; ValueError, with `where`: no frames, or of
        different sizes."""
        frames, where = self.frames[name], f'{where}: {name}'
        if not frames:
            raise ValueError(f'{where}: has no frames')
        sizes = set(map(len, frames))
        if len(sizes) > 1 or not min(sizes) or min(sizes) % 4:
            raise ValueError(f'{where}: its frames have {sorted(sizes)} bytes, not float32 numbers')
        joined = np.frombuffer(b''.join(frames), '<f4').astype(np.float32)
        return joined.reshape(len(frames), -1)


def shaped(values: np.ndarray, of_frame: Sequence[int | None], where: str) -> np.ndarray:
    """Gives a series [T, values] the shape of a frame, where None is any number; ValueError, with
    `where`: it has other sizes."""
    try:
        return values.reshape(len(values), *(size or -1 for size in of_frame))
    except ValueError:
        sizes = ' x '.join(str(size or 'any') for size in of_frame)
        found = f'{values.shape[1]} values a frame'
        raise ValueError(f'{where} has {found}, {sizes} were expected') from None


def scan_record_headers(path: str) -> list[tuple[int, int]]:
    """Returns (offset, data length) in bytes of every record of a TFRecord file, by walking its
    headers without reading its data. FileNotFoundError: there is no such file. ValueError, with
    file, record and offset: empty file, git-lfs pointer, foreign file, oversized or truncated
    record."""
    files.refuse_git_lfs_pointer(path)
    size = os.path.getsize(path)
    records: list[tuple[int, int]] = []
    offset = 0
    with open(path, 'rb') as file:
        while offset < size:
            where = f'{path}: record {len(records)} at offset {offset}'
            header = file.read(_HEADER_BYTES)
            if len(header) < _HEADER_BYTES:
                raise ValueError(f'{where}: the file ends inside a record header: copy it again')
            length, checksum = struct.unpack('<QI', header)
            if checksum != masked_crc32c(header[:8]):
                raise ValueError(f'{where}: not a TFRecord header (wrong checksum)')
            if length > MAX_RECORD_BYTES:
                limit = f'the limit is {MAX_RECORD_BYTES}; the file is damaged or hostile'
                raise ValueError(f'{where}: promises {length} bytes, {limit}')
            end = offset + _HEADER_BYTES + length + _FOOTER_BYTES
            if end > size:
                text = f'the file ends {end - size} bytes too early: copy or convert it again'
                raise ValueError(f'{where}: promises {length} bytes, {text}')
            records.append((offset, length))
            offset = end
            file.seek(offset)
    return records


def read_records(path: str) -> Iterator[SequenceRecord]:
    """Yields the records of a TFRecord file after its headers were checked; raises as
    `scan_record_headers`, and ValueError for a wrong data checksum or another schema."""
    headers = scan_record_headers(path)
    tf = _tensorflow()
    stream = tf.data.TFRecordDataset(path).as_numpy_iterator()
    for index, (offset, _) in enumerate(headers):
        where = f'{path}: record {index} at offset {offset}'
        try:
            data = next(stream)
        except tf.errors.DataLossError as error:
            raise ValueError(f'{where}: wrong data checksum; copy or convert it again') from error
        except (StopIteration, tf.errors.OpError) as error:
            raise ValueError(f'{where}: the file was replaced while it was read') from error
        yield parse_sequence_example(data, where)


def parse_sequence_example(data: bytes, where: str) -> SequenceRecord:
    """Parses one serialised SequenceExample. ValueError, with `where`, which names file and record:
    it is foreign or lacks a feature of the schema."""
    tf = _tensorflow()
    from google.protobuf.message import DecodeError

    try:
        example = tf.train.SequenceExample.FromString(data)
    except DecodeError as error:
        raise ValueError(f'{where}: is not a SequenceExample ({error})') from error
    types = example.context.feature['particle_type'].bytes_list.value
    if len(types) != 1:
        raise ValueError(f'{where}: particle_type has {len(types)} bytes values, 1 was expected')
    keys = example.context.feature['key'].int64_list.value
    frames = {}
    for name, feature_list in example.feature_lists.feature_list.items():
        values = []
        for index, feature in enumerate(feature_list.feature):
            if len(feature.bytes_list.value) != 1:
                raise ValueError(f'{where}: {name} frame {index} has no single bytes value')
            values.append(feature.bytes_list.value[0])
        frames[name] = values
    packed = {
        name.removeprefix(_PACKED): feature.bytes_list.value[0]
        for name, feature in example.context.feature.items()
        if name.startswith(_PACKED) and len(feature.bytes_list.value) == 1
    }
    if 'position' not in frames and not packed:
        raise ValueError(f'{where}: has no feature list "position", only {sorted(frames)}')
    return SequenceRecord(keys[0] if keys else 0, types[0], frames, packed)


def serialise_sequence_example(record: SequenceRecord) -> bytes:
    """Serialises one record; equal records give equal bytes."""
    tf = _tensorflow()
    example = tf.train.SequenceExample()
    example.context.feature['key'].int64_list.value.append(record.key)
    example.context.feature['particle_type'].bytes_list.value.append(record.particle_type)
    for name, data in record.packed.items():
        example.context.feature[_PACKED + name].bytes_list.value.append(data)
    for name, values in record.frames.items():
        features = example.feature_lists.feature_list[name].feature
        for value in values:
            features.add().bytes_list.value.append(value)
    return example.SerializeToString(deterministic=True)


def write_records(path: str, records: Iterable[SequenceRecord]) -> int:
    """Writes a TFRecord file whole or not at all and returns the number of records. OSError: it
    could not be written (for instance a full disk); nothing is left under its name."""
    tf = _tensorflow()
    count = 0

    def write(temporary: str) -> None:
        nonlocal count
        try:
            with tf.io.TFRecordWriter(temporary) as writer:
                for record in records:
                    writer.write(serialise_sequence_example(record))
                    count += 1
        except tf.errors.OpError as error:
            raise OSError(f'{path}: cannot be written: {error.message}') from error
        found = len(scan_record_headers(temporary)) if count else 0
        if found != count:
            raise OSError(f'{path}: {count} records were written but {found} arrived on disk')

    files.write_atomically(path, write)
    return count


def _tensorflow():
    """Imports TensorFlow when a record is first touched, not when the package is."""
    os.environ.setdefault('TF_CPP_MIN_LOG_LEVEL', '2')
    import tensorflow as tf

    return tf


def masked_crc32c(data: bytes) -> int:
    """Returns TFRecord's masked CRC32C (Castagnoli polynomial, reflected) of a few bytes."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0x82F63B78 if crc & 1 else 0)
    crc ^= 0xFFFFFFFF
    return (((crc >> 15) | (crc << 17)) + 0xA282EAD8) & 0xFFFFFFFF
