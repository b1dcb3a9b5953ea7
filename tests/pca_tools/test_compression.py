"""Packed series: how exact and how small they are, and what is refused."""

import numpy as np
import pytest

from pca_tools import compression, files
from pca_tools.heights import Heights
from pca_tools.particles import ParticleSample

STEP = 4e-5


def wandering(frames=30, points=40):
    """Points that walk at random, every second of which rests; one flies 900 m."""
    rng = np.random.default_rng(0)
    rest = rng.uniform(0, 1, (points, 3))
    moved = rest + np.cumsum(rng.normal(0, 0.003, (frames, points, 3)), axis=0)
    moved[:, ::2] = rest[::2]
    moved[7:, 1] += [900.0, -40.0, 1e-5]  # far more than 16 bits of steps
    return rest, moved


def test_steps_keep_the_stated_bound():
    rest, moved = wandering()
    data = compression.pack_steps(moved, rest, STEP)
    again = compression.unpack_steps(data, 30, rest, STEP)
    assert again.dtype == np.float64 and again.shape == moved.shape
    assert np.abs(again - moved).max() <= 0.5 * STEP * (1 + 1e-9)
    np.testing.assert_array_equal(again[:, ::2], moved[:, ::2])
    with pytest.raises(ValueError, match='from its rest place'):
        compression.pack_steps(moved + 1e6, rest, STEP)
    with pytest.raises(ValueError, match='bytes, .* were expected'):
        compression.unpack_steps(data, 29, rest, STEP)


@pytest.mark.parametrize('size', [0.1, 3.0, 100.0])  # float32 finer and coarser than the steps
def test_positions_packed_again_are_the_same(size):
    values = np.random.default_rng(1).normal(0, size, (20, 6, 3)).astype(np.float32)
    once = compression.unpack_positions(compression.pack_positions(values, 1e-6))
    assert once.dtype == np.float32
    assert np.abs(once - values).max() <= 0.5e-6 + np.spacing(np.float32(5 * size))
    twice = compression.unpack_positions(compression.pack_positions(once, 1e-6))
    np.testing.assert_array_equal(twice, once)


@pytest.mark.parametrize('shape', [(1,), (3,), (4, 3)])
def test_series_come_back_bit_for_bit(shape):
    values = np.random.default_rng(2).normal(size=(50, *shape)).astype(np.float32)
    values[3] = np.float32('nan')
    again = compression.unpack_series(compression.pack_series(values))
    assert again.tobytes() == values.tobytes()


def test_damaged_bytes_are_refused():
    _, moved = wandering()
    for pack, unpack in (
        (lambda v: compression.pack_positions(v, STEP), compression.unpack_positions),
        (compression.pack_series, compression.unpack_series),
    ):
        data = pack(moved.astype(np.float32))
        for wrong in (data[:-9], data[:5], b'', b'\xff' * 8 + data[8:], bytes(8) + data[8:]):
            with pytest.raises(ValueError, match='packed'):
                unpack(wrong)


REST = np.arange(6.0).reshape(2, 3)
KINDS = {
    ParticleSample: {'indices': np.int32([4, 9])},
    Heights: {'corner': np.array([0.1, 0.2]), 'cell': np.array([0.2, 0.3])},
}
FORGED = {
    ParticleSample: [('indices', [9, 4]), ('rest', REST[:1])],
    Heights: [
        ('corner', [0.1]), ('corner', [0, 1]), ('cell', [-0.2, 0.3]), ('cell', [np.nan, 0.1]),
        ('rest', REST[0]),
    ],
}  # fmt: skip


@pytest.mark.parametrize('kind', KINDS)
def test_files_that_do_not_fit_are_refused(kind, tmp_path):
    folder = str(tmp_path)
    with pytest.raises(FileNotFoundError, match=f'holds no {kind.TITLE}; convert it again'):
        kind.read(folder, 'train')
    packed = kind.pack(REST + np.zeros((9, 1, 1)), REST)
    name = kind.write(folder, 'train', [packed], REST, **KINDS[kind])
    files.write_manifest(folder, {name: {}})
    np.testing.assert_array_equal(kind.read(folder, 'train')[0], [REST] * 3)
    with pytest.raises(IndexError):
        kind.read(folder, 'train')[1]
    path, held = f'{folder}/{name}', files.read_npz(f'{folder}/{name}')
    for key, value in (
        ('data', held['data'][:-1]), ('offsets', held['offsets'][::-1]), ('rest', REST[:0]),
        ('frames', np.int32([10**9])), ('frame_stride', 0), ('resolution', np.nan), *FORGED[kind],
    ):  # fmt: skip
        files.write_npz(path, **held | {key: value})
        with pytest.raises(ValueError, match=f'is not a {kind.TITLE}'):
            kind(path)
    with pytest.raises(ValueError, match='manifest says|differs from the manifest'):
        kind.read(folder, 'train')
    files.write_npz(path, **held | {'data': np.zeros_like(held['data'])})
    with pytest.raises(ValueError, match='run 0: packed numbers'):
        kind(path)[0]
