"""Rigid fits of degenerate bodies and long motions, on the host and in the compiled rollout."""

import numpy as np
import pytest
import tensorflow as tf
from scipy.spatial.transform import Rotation

from learning_to_simulate.subspace import rigid_body
from pca_tools.rigid_fit import fit_rigid_motion

RNG = np.random.default_rng(0)
# 4 x 5 points on a plane, 0.1 m apart, as on the blade.
BLADE = np.stack(np.meshgrid(np.arange(4) * 0.1, np.arange(5) * 0.1, [0.0]), -1).reshape(-1, 3)
TURN = np.arange(8) * np.pi / 4
RING = 0.15 * np.stack([np.cos(TURN), np.sin(TURN), 0 * TURN], axis=-1)
SHAPES = {
    'cloud': RNG.standard_normal((16, 3)),
    'coplanar': BLADE,
    'symmetric wheel': np.concatenate([RING, RING + [0.0, 0.0, 0.125]]),
    'nearly coplanar': BLADE + 1e-9 * RNG.standard_normal(BLADE.shape),
    'collinear': np.outer(np.linspace(0.0, 1.0, 7), [1.0, 2.0, 3.0]),
    'coincident': np.full((5, 3), 0.3),
}
CORRECTION = tf.function(rigid_body.rigid_correction, jit_compile=True)


@pytest.mark.parametrize('shape', SHAPES.values(), ids=SHAPES)
def test_compiled_correction_places_every_body(shape):
    """The rollout's own fit, as XLA compiles it, recovers exact poses of degenerate bodies too."""
    centred = shape - shape.mean(axis=0)
    targets = shape @ Rotation.random(64, rng=2).as_matrix() + [0.5, -1.0, 2.0]
    placed = CORRECTION(np.repeat(centred[None], 64, axis=0), targets).numpy()
    # Measured 1e-15 to 5e-8 m, the latter on a cloud of 4 m: XLA's eigenvalue solver stops there.
    np.testing.assert_allclose(placed, targets, atol=5e-7)


@pytest.mark.parametrize('shape', [SHAPES['cloud'], BLADE, RING], ids=['cloud', 'blade', 'ring'])
def test_deformed_body_is_rigid_after_each_correction(shape):
    """What a network leaves: edge lengths come back to round-off, whatever the deformation. The
    nearest rigid placement is unique, so the SVD fit and scipy find it as well."""
    centred = shape - shape.mean(axis=0)
    deformed = centred @ Rotation.random(50, rng=4).as_matrix()
    deformed += 0.05 * np.random.default_rng(3).standard_normal(deformed.shape)
    shapes = np.repeat(centred[None], 50, axis=0)
    placed = CORRECTION(shapes, deformed).numpy()

    def edges(x):
        return np.linalg.norm(x[..., :, None, :] - x[..., None, :, :], axis=-1)

    size = edges(centred).max()
    # Measured 3e-16.
    assert np.abs(edges(placed) - edges(centred)).max() < 5e-15 * size
    for one, target in zip(rigid_body.rigid_correction(shapes, deformed).numpy(), deformed):
        fit = fit_rigid_motion(centred, target).apply(centred)
        np.testing.assert_allclose(one, fit, atol=1e-12)
        nearest, _ = Rotation.align_vectors(target - target.mean(axis=0), centred)
        np.testing.assert_allclose(one, nearest.apply(centred) + target.mean(axis=0), atol=1e-7)


@pytest.mark.parametrize('way', ['host', 'compiled'])
def test_rotation_is_continuous_over_two_turns(way):
    """No angle is stored: steps of a degree stay steps of a degree across 180 and 360 degrees."""
    centred = BLADE - BLADE.mean(axis=0)
    axis = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
    turns = Rotation.from_rotvec(np.radians(np.arange(721))[:, None] * axis).as_matrix()
    targets = np.einsum('tij,rj->tri', turns, centred)
    if way == 'host':
        placed = np.stack([fit_rigid_motion(centred, target).apply(centred) for target in targets])
    else:
        placed = CORRECTION(np.repeat(centred[None], 721, axis=0), targets).numpy()
    steps = np.linalg.norm(np.diff(placed, axis=0), axis=-1).max()
    farthest = np.linalg.norm(np.cross(axis, centred), axis=-1).max()
    assert steps <= 1.001 * 2 * np.sin(np.radians(0.5)) * farthest
