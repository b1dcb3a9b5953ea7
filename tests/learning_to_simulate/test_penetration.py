"""Soil inside the tool, of tools and particles that are placed by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from learning_to_simulate.penetration import EVERY, H, Penetration
from learning_to_simulate.scene import RigidMotion
from pca_tools import subspace

N_FRAME = H + 2 * EVERY
OUT, MIDDLE = [0.9, 0.3, 0.2], 0.2
X = 0.5 - 1e-3 * np.arange(N_FRAME)
POSE = np.stack([X, 0 * X + 0.3, 0 * X + MIDDLE, 0 * X + 1, 0 * X, 0 * X, 0 * X], axis=1)


def measure(folder, motion, body, soil, predicted=None, lift=0.0, names=(), context=None):
    """Figures of a run of one particle per mode.

    Args:
      body: [R, 3] of the tool about its place on the path `POSE`.
      soil: [T, 3, 3] recorded particles.
      predicted: [T, 3, 3] particles from the frame H on; None for the recorded ones.
      lift: of the predicted body, m.
      names, context: of the scene, and its values in all frames.
    """
    mean = np.zeros((3, 3))
    space = subspace.Subspace(mean, np.eye(3), np.ones(3), 3.0, 9, 'configuration', ('a',), mean)
    space.save(str(folder / 'subspace.npz'))
    body = POSE[:, None, :3] + np.array(body)
    run = SimpleNamespace(
        position=np.concatenate([body, soil], axis=1), n_rigid=body.shape[1], rigid_pose=POSE,
        step_context=np.tile(context, (N_FRAME, 1)) if names else None,
    )  # fmt: skip
    scene = SimpleNamespace(rigid_motion=motion, up_axis=1, context_names=names)
    found = Penetration(str(folder), {}, [run], 'test', scene)
    group = SimpleNamespace(
        n_rigid=run.n_rigid, position=run.position[None], with_left_modes=lambda position: position
    )
    said = soil[H:] if predicted is None else predicted
    position = np.concatenate([body[H:] + [0, lift, 0], said], axis=1)[None]
    return found(0, group, SimpleNamespace(position=position))


def test_of_a_blade_and_of_the_truth(tmp_path):
    """An upright blade 14 mm to either side of its middle: a particle 4 mm off that is 10 mm in."""
    # Markers as the solver's: corners of the box around the round edges.
    body = [[-0.014, -0.0115, -0.2], [-0.014, 0.2885, 0.2], [0, 0.2, 0]]
    soil = np.tile(np.array(OUT), (N_FRAME, 3, 1))
    soil[H:, 0] = np.stack([X + 0.004, 0 * X + 0.4, 0 * X + MIDDLE], axis=1)[H:]
    predicted = soil[H:].copy()
    predicted[:EVERY, 0] = OUT
    predicted[:, 0, 0] += 0.008  # 12 mm off: 2 mm in
    found = measure(tmp_path, RigidMotion.PRESCRIBED, body, soil, predicted)
    assert found['true_penetration_mm'] == pytest.approx(10.0, abs=1e-6)
    assert found['true_penetration_particles'] == 1.0
    assert found['penetration_mm'] == pytest.approx(2.0, abs=1e-6)
    assert found['penetration_particles'] == 0.5


def test_of_a_wheel_whose_height_is_predicted(tmp_path):
    """The axle 5 mm higher than in the truth: soil that is 8 mm in is 3 mm in."""
    radius, angles = 0.1, np.linspace(0, 2 * np.pi, 8, endpoint=False)
    ring = [(radius * np.cos(a), radius * np.sin(a), z) for z in (-0.05, 0.05) for a in angles]
    soil = np.tile(np.array(OUT), (N_FRAME, 3, 1))
    soil[:, 0] = np.stack([X, 0 * X + 0.3 - radius + 0.008, 0 * X + MIDDLE], axis=1)
    names = ('gravity', 'friction_angle_deg', 'load')
    context = [9.81, 30.0, 100.0]
    found = measure(
        tmp_path, RigidMotion.DRIVEN, ring, soil, lift=0.005, names=names, context=context
    )
    assert found['true_penetration_mm'] == pytest.approx(8.0, abs=1e-4)
    assert found['penetration_mm'] == pytest.approx(3.0, abs=1e-4)
    assert found['penetration_particles'] == found['true_penetration_particles'] == 1.0


def test_a_body_of_another_shape_is_refused(tmp_path):
    """A plate that is not the solver's blade."""
    body, soil = [[0, 0, -0.1], [0, 0, 0.1], [0.05, 0.2, 0]], np.full((N_FRAME, 3, 3), OUT)
    with pytest.raises(ValueError, match='record 0: the body is not the blade of the solver'):
        measure(tmp_path, RigidMotion.PRESCRIBED, body, soil)


def test_a_dataset_without_poses_says_nothing(tmp_path):
    """As does one without a subspace, before a record is read."""
    whole = SimpleNamespace(rigid_motion=RigidMotion.PRESCRIBED, bodies=(), n_soil=3)
    assert Penetration.of_dataset(str(tmp_path), {}, 'test', whole) is None
    for motion in (RigidMotion.PREDICTED, RigidMotion.NONE):
        free = SimpleNamespace(rigid_motion=motion, bodies=(), n_soil=3)
        assert Penetration.of_dataset(str(tmp_path), {}, 'test', free) is None
