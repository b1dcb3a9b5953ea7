"""The particle sample: what is drawn, how exact and how small it is, what is refused."""

import numpy as np
import pytest

from pca_tools import files, particles


def test_sample_covers_the_bed_once():
    points = np.random.default_rng(0).uniform(size=(5000, 3)) * [1.2, 0.2, 0.6]
    chosen = particles.choose_particles(points)
    assert chosen.dtype == np.int32 and len(set(chosen.tolist())) == 600
    assert np.array_equal(chosen, particles.choose_particles(points))
    # every eighth of every axis holds its share of the draw, closer than plain chance would
    for axis in range(3):
        part = np.floor(8 * points[:, axis] / points[:, axis].max() * 0.999).astype(int)
        share = np.bincount(part[chosen], minlength=8) / 600
        np.testing.assert_allclose(share, np.bincount(part, minlength=8) / 5000, atol=0.03)
    assert particles.choose_particles(points[:10]).tolist() == list(range(10))
    same = particles.choose_particles(np.zeros((700, 3)))  # nothing to tell them apart by
    assert len(set(same.tolist())) == 600


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
    with pytest.raises(IndexError):
        particles.read_sample(excavation, 'test')[1]
    arrays['data'] = np.zeros_like(arrays['data'])
    files.write_npz(path, **arrays)
    with pytest.raises(ValueError, match='run 0: packed numbers'):
        particles.ParticleSample(path)[0]
