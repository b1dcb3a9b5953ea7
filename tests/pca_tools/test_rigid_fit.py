"""Rigid fit against scipy, exact motions and degenerate point sets; more in `tests/stiff`."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pca_tools.rigid_fit import fit_rigid_motion

CLOUD = np.random.default_rng(0).standard_normal((16, 3))
# 4 x 5 points on a plane, 0.1 m apart, as on the blade
BLADE = np.stack(np.meshgrid(np.arange(4) * 0.1, np.arange(5) * 0.1, [0.0]), -1).reshape(-1, 3)
TURN = np.arange(8) * np.pi / 4
RING = 0.15 * np.stack([np.cos(TURN), np.sin(TURN), np.zeros(8)], -1)
WHEEL = np.concatenate([RING, RING + [0, 0, 0.125]])


@pytest.mark.parametrize('points', [CLOUD, BLADE, WHEEL], ids=['cloud', 'blade', 'wheel'])
def test_exact_motions_are_recovered_and_never_mirrored(points):
    half_turn = np.diag([-1.0, 1.0, -1.0])
    for rotation in (half_turn, *Rotation.random(200, random_state=0).as_matrix()):
        target = points @ rotation.T + [1.0, -2.0, 0.5]
        motion = fit_rigid_motion(points, target)
        # measured: rotation 5e-15, translation 1e-15 m, residual 6e-15 m
        np.testing.assert_allclose(motion.rotation, rotation, atol=5e-14)
        np.testing.assert_allclose(motion.translation, [1.0, -2.0, 0.5], atol=2e-14)
        np.testing.assert_allclose(motion.apply(points), target, atol=5e-14)
        assert abs(np.linalg.det(motion.rotation) - 1) < 1e-14
        assert motion.residual < 6e-14


def test_lines_and_mirrored_points_get_a_proper_rotation():
    line = np.outer(np.linspace(0, 1, 7), [1.0, 2.0, 3.0])
    rotation = Rotation.from_euler('xyz', [0.3, 0.2, 0.9]).as_matrix()
    for target in (line @ rotation.T + 1, -line):
        motion = fit_rigid_motion(line, target)
        assert motion.residual < 1e-14 and np.linalg.det(motion.rotation) == pytest.approx(1)
    motion = fit_rigid_motion(np.full((5, 3), 2.0), np.full((5, 3), 3.0))
    np.testing.assert_allclose(motion.apply(np.full((1, 3), 2.0)), [[3, 3, 3]])
    motion = fit_rigid_motion(CLOUD, CLOUD * [1, 1, -1])
    nearest, misfit = Rotation.align_vectors(*(p - p.mean(0) for p in (CLOUD * [1, 1, -1], CLOUD)))
    assert motion.residual == pytest.approx(misfit / np.sqrt(len(CLOUD)))
    np.testing.assert_allclose(motion.rotation, nearest.as_matrix(), atol=1e-7)
