"""The particle sample: what is drawn, how exact and how small it is, what is refused."""

import os

import numpy as np
import pytest

from pca_tools import convert, dataset, files, particles
from tests.pca_tools import synthetic


def test_sample_covers_the_bed_once():
    points = np.random.default_rng(0).uniform(size=(5000, 3)) * [1.2, 0.2, 0.6]
    chosen = particles.choose_particles(points, 600)
    assert chosen.dtype == np.int32 and len(set(chosen.tolist())) == 600
    assert np.array_equal(chosen, particles.choose_particles(points, 600))
    assert not np.array_equal(chosen, particles.choose_particles(points, 600, seed=1))
    # every eighth of every axis holds its share of the draw, closer than plain chance would
    for axis in range(3):
        part = np.floor(8 * points[:, axis] / points[:, axis].max() * 0.999).astype(int)
        share = np.bincount(part[chosen], minlength=8) / 600
        np.testing.assert_allclose(share, np.bincount(part, minlength=8) / 5000, atol=0.03)
    assert particles.choose_particles(points[:10], 600).tolist() == list(range(10))
    same = particles.choose_particles(np.zeros((50, 3)), 7)  # nothing to tell them apart by
    assert len(set(same.tolist())) == 7


def test_dataset_holds_the_sample_of_every_record(excavation, raw_excavation):
    metadata = dataset.read_metadata(excavation)
    for split, cases in metadata['dataset_split'].items():
        sample = particles.read_sample(excavation, split)
        assert metadata['particles'][split] == f'particles_{split}.npz'
        assert len(sample) == len(cases) and sample.frame_stride == 4
        for index, case in enumerate(cases):
            raw = np.load(f'{raw_excavation}/run_{case:03d}.npz')['positions']
            truth = raw[::4][:, sample.indices].astype(np.float64)
            assert sample[index].shape == truth.shape == (6, 140, 3)
            assert np.abs(sample[index] - truth).max() <= 2e-5
    with pytest.raises(IndexError):
        sample[len(sample)]


def test_bad_samples_are_refused(excavation, tmp_path):
    with pytest.raises(FileNotFoundError, match='holds no particle sample'):
        particles.read_sample(str(tmp_path), 'train')
    arrays = files.read_npz(particles.sample_path(excavation, 'test'))
    path = str(tmp_path / 'sample.npz')
    for change in (
        {'data': arrays['data'][:-1]},
        {'offsets': arrays['offsets'][::-1]},
        {'indices': arrays['indices'][::-1]},
        {'frames': np.int32([10**9] * len(arrays['frames']))},
        {'frame_stride': np.int64(0)},
        {'resolution': np.float64('nan')},
        {'rest': arrays['rest'][:-1]},
    ):
        files.write_npz(path, **{**arrays, **change})
        with pytest.raises(ValueError, match='is not a particle sample'):
            particles.ParticleSample(path)
    arrays['data'] = np.zeros_like(arrays['data'])
    files.write_npz(path, **arrays)
    with pytest.raises(ValueError, match='run 0: packed numbers'):
        particles.ParticleSample(path)[0]


def test_new_runs_keep_the_same_particles(excavation, tmp_path):
    raw = synthetic.write_raw_folder(str(tmp_path / 'raw'), 'excavation', [31, 32])
    convert.convert(raw, str(tmp_path / 'new'), like=excavation)
    first, second = (
        particles.read_sample(str(folder), 'test') for folder in (excavation, tmp_path / 'new')
    )
    np.testing.assert_array_equal(first.indices, second.indices)
    np.testing.assert_array_equal(first.rest, second.rest)
    assert os.path.getsize(tmp_path / 'new' / 'particles_test.npz') < 20_000
