"""TFRecord framing and SequenceExample against bytes built by hand from the format descriptions."""

import struct

import pytest

from pca_tools import tfrecord_io
from pca_tools.tfrecord_io import SequenceRecord

RECORD = SequenceRecord(5, b'types---', {'position': [b'p0', b'p1'], 'force': [b'f0', b'f1']})


def crc32c(data):
    """Castagnoli CRC as polynomial division, bit by bit, most significant bit first."""
    remainder = 0
    bits = [(byte >> i) & 1 for byte in data for i in range(8)] + [0] * 32
    for index, bit in enumerate(bits):
        top = remainder >> 31
        # the first 32 bits are inverted, which is the initial value of all ones
        bit ^= index < 32
        remainder = ((remainder << 1) & 0xFFFFFFFF) | bit
        if top:
            remainder ^= 0x1EDC6F41
    return int(f'{remainder:032b}'[::-1], 2) ^ 0xFFFFFFFF


def masked(data):
    crc = crc32c(data)
    return (((crc >> 15) | (crc << 17) & 0xFFFFFFFF) + 0xA282EAD8) % 2**32


def framed(data):
    """One TFRecord by hand."""
    length = struct.pack('<Q', len(data))
    return length + struct.pack('<I', masked(length)) + data + struct.pack('<I', masked(data))


def message(field, payload):
    """A length-delimited protobuf field, with a varint length."""
    length, varint = len(payload), b''
    while length > 127:
        varint += bytes([length % 128 + 128])
        length //= 128
    return bytes([field * 8 + 2]) + varint + bytes([length]) + payload


def sequence_example(record):
    """SequenceExample by hand, from tensorflow/core/example/{example,feature}.proto."""

    def bytes_feature(value):
        return message(1, message(1, value))

    def entry(key, value):
        return message(1, message(1, key.encode()) + message(2, value))

    key = message(3, message(1, bytes([record.key])))
    context = entry('key', key) + entry('particle_type', bytes_feature(record.particle_type))
    lists = b''.join(
        entry(name, b''.join(message(1, bytes_feature(frame)) for frame in frames))
        for name, frames in record.frames.items()
    )
    return message(1, context) + message(2, lists)


def write(path, data):
    path.write_bytes(data)
    return str(path)


def test_checksum_of_the_standard_vector():
    # RFC 3720 B.4 and the CRC catalogue: CRC-32C of "123456789" is 0xE3069283.
    assert crc32c(b'123456789') == 0xE3069283
    assert tfrecord_io.masked_crc32c(b'123456789') == masked(b'123456789')


def test_reads_bytes_built_by_hand(tmp_path):
    path = write(tmp_path / 'x.tfrecord', framed(sequence_example(RECORD)) * 3)
    assert [length for _, length in tfrecord_io.scan_record_headers(path)] == [
        len(sequence_example(RECORD))
    ] * 3
    assert list(tfrecord_io.read_records(path)) == [RECORD] * 3


def test_writes_what_tensorflow_parses(tmp_path):
    import tensorflow as tf

    path = str(tmp_path / 'x.tfrecord')
    assert tfrecord_io.write_records(path, [RECORD, RECORD]) == 2
    assert list(tfrecord_io.read_records(path)) == [RECORD, RECORD]
    serialised = next(tf.data.TFRecordDataset(path).as_numpy_iterator())
    context, lists = tf.io.parse_single_sequence_example(
        serialised,
        context_features={
            'key': tf.io.FixedLenFeature([], tf.int64, default_value=0),
            'particle_type': tf.io.VarLenFeature(tf.string),
        },
        sequence_features={name: tf.io.VarLenFeature(tf.string) for name in RECORD.frames},
    )
    assert int(context['key']) == RECORD.key
    assert context['particle_type'].values.numpy().tolist() == [RECORD.particle_type]
    assert lists['position'].values.numpy().tolist() == RECORD.frames['position']


@pytest.mark.parametrize(
    'second, text',
    [
        (lambda one: one[:5], 'ends inside a record header'),
        (lambda one: one[:-2], 'ends 2 bytes too early'),
        (lambda one: one[:-30], 'truncated'),
        (lambda one: b'\n' * 7, 'ends inside a record header'),
        (lambda one: bytes(64), 'not a TFRecord header'),
        (lambda one: b'not a record at all', 'not a TFRecord header'),
    ],
)
def test_truncated_files_and_trailing_garbage_are_named(tmp_path, second, text):
    one = framed(sequence_example(RECORD))
    with pytest.raises(ValueError, match='x.tfrecord: record 1 at offset .*' + text):
        tfrecord_io.scan_record_headers(write(tmp_path / 'x.tfrecord', one + second(one)))


@pytest.mark.parametrize('length', [2**31, 2**34, 2**36, 2**62])
def test_oversized_length_with_valid_checksum_never_reaches_tensorflow(tmp_path, length):
    # TensorFlow itself ends with a segmentation fault on 2^36 and above.
    header = struct.pack('<Q', length)
    data = header + struct.pack('<I', masked(header)) + bytes(100)
    with pytest.raises(ValueError, match=f'promises {length} bytes, the limit'):
        list(tfrecord_io.read_records(write(tmp_path / 'x.tfrecord', data)))
