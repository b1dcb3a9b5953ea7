"""The particle sample: what is drawn. What is kept: `test_convert.py`, `test_compression.py`."""

import numpy as np

from pca_tools import particles


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
