"""One loader for our datasets and Kipf's files; foreign files get a clear message."""

import dataclasses

import numpy as np
import pytest

from nri import data
from pca_tools import dataset
from tests.learning_to_simulate import synthetic
from tests.nri import small


def test_kipfs_order_of_axes_and_pairs(tmp_path):
    small.write_springs(tmp_path)
    held = data.load(str(tmp_path), 'valid')
    loc, vel, edges = (
        np.load(tmp_path / f'{name}_valid_springs3.npy') for name in ('loc', 'vel', 'edges')
    )
    assert held.features.shape == (16, 3, 15, 4) and held.features.dtype == np.float32
    for s, v, t in ((0, 0, 0), (3, 2, 7), (15, 1, 14)):
        np.testing.assert_array_equal(held.features[s, v, t, :2], loc[s, t, :, v])
        np.testing.assert_array_equal(held.features[s, v, t, 2:], vel[s, t, :, v])
    for s in range(16):
        pairs = [edges[s, i, j] for i in range(3) for j in range(3) if i != j]
        np.testing.assert_array_equal(held.edges[s], pairs)


def test_charges_become_types():
    relations = np.array([[[1.0, -1.0], [-1.0, 1.0]], [[1.0, 1.0], [1.0, 1.0]]])
    np.testing.assert_array_equal(data.edge_types(relations), [[0, 0], [1, 1]])
    with pytest.raises(ValueError, match='from 0.5 to 0.5'):
        data.edge_types(np.full((1, 2, 2), 0.5))


def test_normalised_kipf_data_fill_minus_one_to_one_and_still_ones_keep_their_scale():
    held = small.springs(n_run=16)
    offset, scale = data.normalization(held)
    assert offset.shape == (1, 4)
    normal = (held.features - offset[:, None]) / scale[:, None]
    for group in ([0, 1], [2, 3]):
        assert normal[..., group].min() == pytest.approx(-1, abs=1e-6)
        assert normal[..., group].max() == pytest.approx(1, abs=1e-6)
    still = dataclasses.replace(held, features=np.full_like(held.features, 3.0))
    offset, scale = data.normalization(still)
    assert (scale == 1.0).all() and (offset == 3.0).all()


def test_modes_of_a_dataset(tmp_path):
    folder = synthetic.write_dataset(tmp_path)
    held = data.load(folder, 'train')
    runs = dataset.read_split(folder, 'train')
    assert held.node_names == ('mode_0', 'mode_1', 'mode_2') and held.edges is None
    assert held.features.shape == (4, 3, synthetic.N_FRAMES - 1, 6)
    position = runs[2].position.astype(np.float64)
    np.testing.assert_allclose(held.features[2, 1, 5, :3], position[6, 5], rtol=1e-7)
    np.testing.assert_allclose(
        held.features[2, 1, 5, 3:], position[6, 5] - position[5, 5], rtol=1e-6
    )
    offset, scale = data.normalization(held)
    assert offset.shape == (3, 6)
    normal = (held.features - offset[:, None]) / scale[:, None]
    assert np.abs(normal).max() <= 1 + 1e-5
    # Every node fills its own range; an axis that hardly moves is not blown up to it.
    assert np.abs(normal[..., :3]).max(axis=(0, 2, 3)).min() > 0.9
    assert np.abs(normal[:, 1, :, 5]).max() < 0.9


def test_first_modes_and_the_lowest_rigid_particles_of_a_dataset(tmp_path):
    folder = synthetic.write_dataset(tmp_path / 'data', rigid_counts=(4, 6))
    whole, some = data.load(folder, 'valid'), data.load(folder, 'valid', modes=2)
    assert some.node_names == whole.node_names[:2] and some.digest == whole.digest
    np.testing.assert_array_equal(some.features, whole.features[:, :2])
    with pytest.raises(ValueError, match='modes is 4, but .* holds 3'):
        data.load(folder, 'train', modes=4)
    with pytest.raises(ValueError, match='no modes to choose from'):
        data.load(small.write_springs(tmp_path / 'springs'), 'train', modes=2)
    held = data.load(folder, 'train', 'modes_and_rigid')
    assert held.node_names == tuple(f'rigid_{i}' for i in range(4)) + whole.node_names
    run = dataset.read_split(folder, 'train')[1]
    lowest = np.sort(run.position[0, :6, 1])[:4]
    np.testing.assert_allclose(np.sort(run.position[1, :4, 1]), held.features[1, :4, 0, 1])
    assert run.position[0, :4, 1].max() <= lowest.max()


LFS_POINTER = 'version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n'


@pytest.mark.parametrize(
    ('name', 'content', 'message'),
    [
        ('loc_train_springs3', np.zeros((32, 15, 2)), r'has shape \(32, 15, 2\)'),
        ('loc_train_springs3', np.zeros((31, 15, 2, 3)), 'not of the same runs'),
        ('edges_train_springs3', np.zeros((32, 4, 4)), r'\(32, 3, 3\) was expected'),
        ('edges_train_springs3', np.full((32, 3, 3), 7.0), 'found values from 7 to 7'),
        ('vel_train_springs3', np.full((32, 15, 2, 3), np.nan), 'holds 2880 NaN'),
        ('vel_train_springs3', np.full((32, 15, 2, 3), 'a'), 'array of numbers'),
        ('vel_train_springs3', np.array([{}], dtype=object), 'not a plain .npy'),
        ('vel_train_springs3', 'x', 'vel_train'),
        ('vel_train_springs3', LFS_POINTER, 'git-lfs'),
        ('loc_train_charged3', 'x', 'one system per folder'),
    ],
)
def test_damaged_and_foreign_files_are_named(tmp_path, name, content, message):
    folder, path = small.write_springs(tmp_path), tmp_path / f'{name}.npy'
    if isinstance(content, str):
        path.write_text(content)
    else:
        np.save(path, content)
    with pytest.raises(ValueError, match=message) as error:
        data.load(folder, 'train')
    assert str(tmp_path) in str(error.value)


def test_missing_files_and_wrong_names(tmp_path):
    folder = small.write_springs(tmp_path / 'a')
    (tmp_path / 'a' / 'edges_train_springs3.npy').unlink()
    (tmp_path / 'empty').mkdir()
    for arguments, error, message in (
        ((folder, 'train'), FileNotFoundError, 'edges_train_springs3.npy'),
        ((str(tmp_path / 'empty'), 'train'), FileNotFoundError, 'neither metadata.json'),
        ((str(tmp_path / 'none'), 'train'), FileNotFoundError, 'no such folder'),
        ((folder, 'tests'), ValueError, "split 'tests'"),
        ((folder, 'valid', 'all'), ValueError, "nodes 'all'"),
    ):
        with pytest.raises(error, match=message):
            data.load(*arguments)
