"""Whole ways over a terrain: the frames of a stepper, particles that are followed, files."""

import numpy as np
import pytest

from learning_to_simulate.soil_field import rollout as rollout_lib
from learning_to_simulate.soil_field.stepper import SoilStepper
from learning_to_simulate.soil_field.tools import Blade, Wheel
from pca_tools import files
from tests.learning_to_simulate.soil_field import scenes, worlds
from tests.learning_to_simulate.soil_field.scenes import DT


def stepper_of(run):
    return SoilStepper(worlds.trained()[0], run.before(), run.tool)


def test_a_rollout_is_the_frames_of_its_stepper(tmp_path):
    run = worlds.run(11)
    live = stepper_of(run)
    frames = [live.start(run.pose[0])] + [live.step(pose, DT) for pose in run.pose[1:]]
    made = rollout_lib.roll_out(stepper_of(run), run.pose, DT)
    assert (made.force == [frame.force for frame in frames]).all()
    assert (made.pose == [frame.pose for frame in frames]).all()
    assert (made.heights[-1] == live.terrain.heights.astype(np.float32)).all()
    assert not made.before.heights.any() and len(made) == 49 == len(made.frame_status)
    assert repr(made) == "<rollout 'rollout': 49 frames, ok>" and made.time[-1] == 48 * DT
    made.save(str(tmp_path / 'cut.npz'))
    stored = files.read_npz(str(tmp_path / 'cut.npz'))
    assert (stored['predicted_heights'] == made.heights).all() and str(stored['status']) == 'ok'
    for bad in (run.pose[0], run.pose[:, :6], run.pose[:0]):
        with pytest.raises(ValueError, match=r'\[T, 7\] poses'):
            rollout_lib.roll_out(stepper_of(run), bad)


def test_particles_are_followed_from_before_the_tool():
    """They move as the soil does, across new anchors; the rest stays to the last bit."""
    run = worlds.run(11)
    live, points = stepper_of(run), run.particles[0]
    found = rollout_lib.roll_out(live, run.pose, DT, particles=points).particles
    assert found.shape == run.particles.shape and (found[0] == points.astype(np.float32)).all()
    off, moved = found[-1] - run.particles[-1], run.particles[-1] - points
    assert np.sqrt((off**2).mean()) < 0.6 * np.sqrt((moved**2).mean())
    far = np.abs(points[:, 2]) > worlds.TOOL.width / 2 + 0.1
    far |= points[:, 0] > 0.15
    assert far.any() and np.abs(found[-1] - points)[far].max() < 2e-3
    # Each map of particles belongs to its frame, not to the one before.
    other = stepper_of(run)
    other.start(run.pose[0], points)
    for pose in run.pose[1 : 6 * worlds.STRIDE + 1]:
        other.step(pose, DT)
    assert (found[6] == other.particles()).all() and (found[6] != found[5]).any()
    # A tool that turns in the air goes on elsewhere; particles stay where they are.
    here = live.particles()
    live.step(run.pose[-1] + [0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0], 0.5)
    before = live.place
    live.step(scenes.poses([[0.5, 0.5, 0.0]], yaw=0.5)[0], 1.0)
    assert live.place.origin is not before.origin and (live.particles() == here).all()


def test_outlines_have_the_size_of_the_tool():
    blade = rollout_lib.outline(Blade(0.4, radius=0.01, length=0.3))
    hull = [blade.min(axis=0), blade.max(axis=0)]
    np.testing.assert_allclose(hull, [[-0.01, -0.01], [0.01, 0.29]])
    x, y = (np.roll(blade, -1, axis=0) - blade).T  # the corners go round once
    assert (x * np.roll(y, -1) - y * np.roll(x, -1) >= -1e-12).all()
    wheel = rollout_lib.outline(Wheel(0.1, 0.2))
    np.testing.assert_allclose(np.linalg.norm(wheel[1:], axis=1), 0.2)
