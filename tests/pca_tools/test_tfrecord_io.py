"""TFRecord framing and SequenceExample against TensorFlow's own writer and messages; what we write
TensorFlow parses in `test_formats.py`."""

import struct

import pytest
import tensorflow as tf

from pca_tools import tfrecord_io
from pca_tools.tfrecord_io import SequenceRecord

RECORD = SequenceRecord(5, b'types---', {'position': [b'p0', b'p1'], 'force': [b'f0', b'f1']})


def feature(value):
    return tf.train.Feature(bytes_list=tf.train.BytesList(value=[value]))


def write_by_tensorflow(path, count):
    """Writes `RECORD` so many times as tensorflow/core/example/{example,feature}.proto say."""
    key = tf.train.Feature(int64_list=tf.train.Int64List(value=[RECORD.key]))
    context = {'key': key, 'particle_type': feature(RECORD.particle_type)}
    lists = {
        name: tf.train.FeatureList(feature=map(feature, frames))
        for name, frames in RECORD.frames.items()
    }
    example = tf.train.SequenceExample(
        context=tf.train.Features(feature=context),
        feature_lists=tf.train.FeatureLists(feature_list=lists),
    )
    with tf.io.TFRecordWriter(str(path)) as writer:
        for _ in range(count):
            writer.write(example.SerializeToString())


def test_reads_what_tensorflow_writes(tmp_path):
    path = tmp_path / 'x.tfrecord'
    write_by_tensorflow(path, 3)
    headers = tfrecord_io.scan_record_headers(str(path))
    size = path.stat().st_size // 3
    assert headers == [(n * size, size - 16) for n in range(3)]
    assert list(tfrecord_io.read_records(str(path))) == [RECORD] * 3


@pytest.mark.parametrize(
    'second, text',
    [
        (lambda one: one[:5], 'ends inside a record header'),
        (lambda one: one[:-2], 'ends 2 bytes too early'),
        (lambda one: bytes(64), 'not a TFRecord header'),
        (lambda one: b'not a record at all', 'not a TFRecord header'),
    ],
)
def test_truncated_files_and_trailing_garbage_are_named(tmp_path, second, text):
    path = tmp_path / 'x.tfrecord'
    write_by_tensorflow(path, 1)
    one = path.read_bytes()
    path.write_bytes(one + second(one))
    with pytest.raises(ValueError, match='x.tfrecord: record 1 at offset .*' + text):
        tfrecord_io.scan_record_headers(str(path))


@pytest.mark.parametrize('length', [2**31, 2**34, 2**36, 2**62])
def test_oversized_length_with_valid_checksum_never_reaches_tensorflow(tmp_path, length):
    # TensorFlow itself ends with a segmentation fault on 2^36 and above.
    path, header = tmp_path / 'x.tfrecord', struct.pack('<Q', length)
    path.write_bytes(header + struct.pack('<I', tfrecord_io.masked_crc32c(header)) + bytes(100))
    with pytest.raises(ValueError, match=f'promises {length} bytes, the limit'):
        list(tfrecord_io.read_records(str(path)))
