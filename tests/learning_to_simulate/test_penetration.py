"""Soil inside the tool, of tools and particles that are placed by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from learning_to_simulate.penetration import EVERY, H, Penetration
from learning_to_simulate.scene import RigidMotion
from pca_tools import subspace

N_FRAME = H + 2 * EVERY
OUT, MIDDLE = [0.9, 0.3, 0.2], 0.2


def scene(motion, names=()):
    return SimpleNamespace(rigid_motion=motion, up_axis=1, context_names=names)


def measure(folder, scene, run, predicted, body=None):
    """Figures of a run of one particle per mode.

    Args:
      run: `Trajectory`-like.
      predicted: [T, 3, 3] particles from the frame H on.
      body: its predicted particles there; None for the true ones.
    """
    mean = np.zeros((3, 3))
    space = subspace.Subspace(mean, np.eye(3), np.ones(3), 3.0, 9, 'configuration', ('a',), mean)
    space.save(str(folder / 'subspace.npz'))
    found = Penetration(str(folder), {}, [run], 'test', scene)
    n = run.n_rigid
    body = run.position[H:, :n] if body is None else body
    group = SimpleNamespace(
        n_rigid=n, position=run.position[None], with_left_modes=lambda position: position
    )
    rollout = SimpleNamespace(position=np.concatenate([body, predicted], axis=1)[None])
    return found(0, group, rollout)


def recorded(body, soil, pose, context=None):
    return SimpleNamespace(
        position=np.concatenate([body, soil], axis=1), n_rigid=body.shape[1], rigid_pose=pose,
        step_context=context,
    )  # fmt: skip


def test_of_a_blade_and_of_the_truth(tmp_path):
    """An upright blade 14 mm to either side of its middle: a particle 4 mm off that is 10 mm in."""
    x = 0.5 - 1e-3 * np.arange(N_FRAME)
    pose = np.stack([x, 0 * x + 0.3, 0 * x + MIDDLE, 0 * x + 1, 0 * x, 0 * x, 0 * x], axis=1)
    # Markers as the solver's: corners of the box around the round edges.
    body = pose[:, None, :3] + np.array(
        [[-0.014, -0.0115, -0.2], [-0.014, 0.2885, 0.2], [0, 0.2, 0]]
    )
    soil = np.tile(np.array(OUT), (N_FRAME, 3, 1))
    soil[H:, 0] = np.stack([x + 0.004, 0 * x + 0.4, 0 * x + MIDDLE], axis=1)[H:]
    predicted = soil[H:].copy()
    predicted[:EVERY, 0] = OUT
    predicted[:, 0, 0] += 0.008  # 12 mm off: 2 mm in
    run = recorded(body, soil, pose)
    found = measure(tmp_path, scene(RigidMotion.PRESCRIBED), run, predicted)
    assert found['true_penetration_mm'] == pytest.approx(10.0, abs=1e-6)
    assert found['true_penetration_particles'] == 1.0
    assert found['penetration_mm'] == pytest.approx(2.0, abs=1e-6)
    assert found['penetration_particles'] == 0.5


def test_of_a_wheel_whose_height_is_predicted(tmp_path):
    """The axle 5 mm higher than in the truth: soil that is 8 mm in is 3 mm in."""
    radius, angles = 0.1, np.linspace(0, 2 * np.pi, 8, endpoint=False)
    ring = [(radius * np.cos(a), radius * np.sin(a), z) for z in (-0.05, 0.05) for a in angles]
    x = 0.5 - 1e-3 * np.arange(N_FRAME)
    pose = np.stack([x, 0 * x + 0.3, 0 * x + MIDDLE, 0 * x + 1, 0 * x, 0 * x, 0 * x], axis=1)
    body = pose[:, None, :3] + np.array(ring)
    soil = np.tile(np.array(OUT), (N_FRAME, 3, 1))
    soil[:, 0] = np.stack([x, 0 * x + 0.3 - radius + 0.008, 0 * x + MIDDLE], axis=1)
    names = ('gravity', 'friction_angle_deg', 'load')
    context = np.tile([9.81, 30.0, 100.0], (N_FRAME, 1))
    run = recorded(body, soil, pose, context)
    found = measure(
        tmp_path, scene(RigidMotion.DRIVEN, names), run, soil[H:], body[H:] + [0, 0.005, 0]
    )
    assert found['true_penetration_mm'] == pytest.approx(8.0, abs=1e-4)
    assert found['penetration_mm'] == pytest.approx(3.0, abs=1e-4)
    assert found['penetration_particles'] == found['true_penetration_particles'] == 1.0


def test_a_body_of_another_shape_is_refused(tmp_path):
    """A plate that is not the solver's blade."""
    pose = np.tile([0.5, 0.3, MIDDLE, 1.0, 0.0, 0.0, 0.0], (N_FRAME, 1))
    body = pose[:, None, :3] + np.array([[0, 0, -0.1], [0, 0, 0.1], [0.05, 0.2, 0]])
    soil = np.tile(np.array(OUT), (N_FRAME, 3, 1))
    with pytest.raises(ValueError, match='record 0: the body is not the blade of the solver'):
        measure(tmp_path, scene(RigidMotion.PRESCRIBED), recorded(body, soil, pose), soil[H:])


def test_a_dataset_without_poses_says_nothing(tmp_path):
    """As does one without a subspace, before a record is read."""
    whole = SimpleNamespace(rigid_motion=RigidMotion.PRESCRIBED, bodies=(), n_soil=3)
    assert Penetration.of_dataset(str(tmp_path), {}, 'test', whole) is None
    for motion in (RigidMotion.PREDICTED, RigidMotion.NONE):
        free = SimpleNamespace(rigid_motion=motion, bodies=(), n_soil=3)
        assert Penetration.of_dataset(str(tmp_path), {}, 'test', free) is None
