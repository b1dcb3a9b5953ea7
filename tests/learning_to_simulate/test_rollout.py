"""Rollouts: the compiled loop against single steps, the rigid correction against scipy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from learning_to_simulate import rollout
from learning_to_simulate.subspace import rigid_body
from pca_tools import rigid_fit
from tests.learning_to_simulate import models

BODIES = {
    'ball': np.random.default_rng(0).normal(size=(9, 3)),
    'coplanar': np.random.default_rng(1).normal(size=(12, 3)) * [1.0, 1.0, 0.0],
    'ring': np.stack([np.cos(np.arange(8)), np.sin(np.arange(8)), np.zeros(8)], -1),
}


@pytest.mark.parametrize('body', BODIES.values(), ids=BODIES)
def test_correction_equals_the_svd_fit_and_scipy(body):
    """Random poses with deformation: the nearest rigid placement is unique, so all ways agree."""
    rng = np.random.default_rng(2)
    shape = body - body.mean(axis=0)
    for _ in range(50):
        turn = Rotation.random(random_state=int(rng.integers(1 << 30)))
        target = turn.apply(shape) + rng.normal(size=3) + 0.05 * rng.normal(size=shape.shape)
        placed = rigid_body.rigid_correction(shape[None], target[None])[0].numpy()
        fit = rigid_fit.fit_rigid_motion(shape, target)
        np.testing.assert_allclose(placed, shape @ fit.rotation.T + fit.translation, atol=1e-12)
        nearest, _ = Rotation.align_vectors(target - target.mean(axis=0), shape)
        np.testing.assert_allclose(placed, nearest.apply(shape) + target.mean(axis=0), atol=1e-7)


@pytest.mark.parametrize('context', [True, 'changing'])
def test_compiled_loop_equals_steps_one_by_one(tmp_path, context):
    """All runs as a batch; that a single step is right, a twin says."""
    model, (group,), _ = models.make(tmp_path, motion='driven', context=context)
    function = rollout.RolloutFunction(model.simulator, model.layout(group.n_rigid))
    result, count = rollout.roll_out(function, group), group.position.shape[1] - 6
    scale = np.ptp(group.position[:, :, group.n_rigid :])
    for run in (0, 3):
        position, force = models.steps(model, group, run, count)
        # A random network amplifies float32 round-off over 34 steps: measured 3e-6 of the range of
        # the modes and 3e-5 of the force. Ten times that.
        np.testing.assert_allclose(result.position[run], position, atol=3e-5 * scale)
        np.testing.assert_allclose(result.force[run], force, atol=3e-4 * np.abs(force).max())


@pytest.mark.parametrize('correct', [True, False])
def test_predicted_body_stays_rigid_with_the_correction_only(tmp_path, monkeypatch, correct):
    model, (group,), _ = models.make(
        tmp_path, preset='pcg_thesis', motion='predicted', rigid_counts=(6,)
    )
    function = rollout.RolloutFunction(model.simulator, model.layout(6))
    if not correct:
        monkeypatch.setattr(rollout, 'shape_of', lambda *_: None)
    body = rollout.roll_out(function, group).position[:, :, :6]

    def edges(points):
        return np.linalg.norm(points[..., :, None, :] - points[..., None, :, :], axis=-1)

    stretch = np.abs(edges(body) - edges(group.position[:, 5:6, :6])).max()
    assert (stretch < 1e-6) == correct  # 2e-7 m with it (float32), more than 1e-4 m without
