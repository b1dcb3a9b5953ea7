"""The shipped models in C over recorded runs: against TensorFlow, and against the numpy twins."""

import numpy as np
import pytest

from learning_to_simulate import registry
from learning_to_simulate.native import agreement
from learning_to_simulate.native.binding import CSubspace
from pca_tools import rigid_fit
from tests.learning_to_simulate.native.worlds import needs_c
from tests.learning_to_simulate.twins.numpy_twin import Twin

pytestmark = [needs_c, pytest.mark.slow]
H = 6
SHIPPED = [('excavation', 'pcg_thesis'), ('wheel', 'pcg')]


def run_of(path, data):
    """The first test run of a dataset."""
    return registry.open_model(path, data, 'test').groups[0].select(0)


def twin_step(twin, group, history, k):
    """The twin's frame k after a history, a free body kept rigid, and its force."""
    n = group.n_rigid
    expected, force = twin.step(history, group.position[0, k, :n], group.context_at(H, 0))
    if not twin.scene.rigid_motion.is_known:
        moved = rigid_fit.fit_rigid_motion(history[-1, :n], expected[:n])
        expected[:n] = moved.apply(history[-1, :n])
    return expected, force


@pytest.mark.parametrize('scene, name', SHIPPED)
def test_shipped_graphs_over_a_rollout_and_single_steps_of_the_twin(scene, name):
    path, data = f'models/{scene}/{name}', f'datasets/{scene}'
    opened, group = agreement.Opened.of(path), run_of(path, data)
    row = agreement.over_frames(*opened.steppers(), group)
    assert row['frames'] > 40 and row['same_status'] == row['frames']
    # As a share of the motion and of the largest force.
    assert row['position'] <= 1e-5 and row['force'] <= 1e-5
    # Two float32 decodings of positions of a metre, each right to 2e-7.
    assert 0 < row['particles_m'] <= 1e-6
    soil, twin = CSubspace.of(opened.model, group.n_rigid), Twin(opened.model, group.n_rigid)
    known, truth = twin.scene.rigid_motion.is_known, group.position[0]
    for k in (H, 60, 120):
        expected, force = twin_step(twin, group, truth[k - H : k], k)
        soil.reset(truth[k - H : k], group.context_at(H, 0))
        frame = soil.step(truth[k, : group.n_rigid] if known else None)
        got = np.concatenate([frame.rigid_pose, frame.modes])
        motion = np.abs(expected - truth[0]).max()
        np.testing.assert_allclose(got, expected, atol=1e-5 * motion + 1e-7)
        np.testing.assert_allclose(frame.force, force, atol=1e-5 * np.abs(force).max())
