"""Rollouts: the compiled loop against single steps; the rigid correction on the way, which
`tests/stiff/test_rigid_fit.py` holds against other fits."""

import numpy as np
import pytest

from learning_to_simulate import rollout
from tests.learning_to_simulate import models


@pytest.mark.xla
def test_compiled_loop_equals_steps_one_by_one(tmp_path):
    """All runs as a batch; that a single step is right, a twin says."""
    model, (group,), _ = models.make(tmp_path, motion='driven', context='changing')
    function = rollout.RolloutFunction(model.simulator, model.layout(group.n_rigid))
    result, count = rollout.roll_out(function, group), group.position.shape[1] - 6
    scale = np.ptp(group.position[:, :, group.n_rigid :])
    for run in (0, 3):
        position, force = models.steps(model, group, run, count)
        # A random network amplifies float32 round-off over 34 steps: measured 3e-6 of the range of
        # the modes and 3e-5 of the force. Ten times that.
        np.testing.assert_allclose(result.position[run], position, atol=3e-5 * scale)
        np.testing.assert_allclose(result.force[run], force, atol=3e-4 * np.abs(force).max())


@pytest.mark.xla
def test_predicted_body_stays_rigid(tmp_path):
    model, (group,), _ = models.make(
        tmp_path, preset='pcg_thesis', motion='predicted', rigid_counts=(6,)
    )
    function = rollout.RolloutFunction(model.simulator, model.layout(6))
    body = rollout.roll_out(function, group).position[:, :, :6]

    def edges(points):
        return np.linalg.norm(points[..., :, None, :] - points[..., None, :, :], axis=-1)

    stretch = np.abs(edges(body) - edges(group.position[:, 5:6, :6])).max()
    assert stretch < 1e-6  # 2e-7 m (float32); more than 1e-4 m without the correction
