"""What a run records: pose, torque, load, parameters; what a lead-in leaves."""

import math

import numpy as np
import pytest

from mpm import DATA_VERSION, SOLVER_VERSION, run, scenes, splits
from mpm.motions import catalogue, operator_paths
from mpm.picture import body_of
from mpm.simulation import Settings
from tests.mpm import small

BUCKET = operator_paths.bucket(0.1, 0.3, True)


@pytest.fixture
def made(monkeypatch):
    """Makes a run of some frames."""

    def make(scene, case, count, settings=None, on_frame=lambda frame: None, tool=None):
        monkeypatch.setattr(scenes, 'FRAMES', count)
        packed, chosen = small.packed(scene), settings or Settings()
        return run.run_case(scene, case, packed, chosen, on_frame, tool)

    return make


def check_points(found):
    """The pose moves the upright points onto the sample points: v + 2 u x (u x v + w v)."""
    points = body_of(found.parameters).points
    for pose, sampled in zip(found.pose[::10].astype(np.float64), found.rigid_positions[::10]):
        assert np.linalg.norm(pose[3:]) == pytest.approx(1.0, abs=1e-6)
        w, u = pose[3], pose[4:]
        turned = points + 2.0 * np.cross(u, np.cross(u, points) + w * points)
        np.testing.assert_allclose(sampled, pose[:3] + turned, atol=1e-6)


def test_parameters_say_what_was_run(made):
    found = made(small.BLADE, 'stops_0001', 31)
    check_points(found)
    assert found.pose.dtype == found.torque.dtype == np.float32 and found.step_context is None
    p = found.parameters
    assert (p['case'], p['kind'], p['path_seed'], p['split']) == ('stops_0001', 'stops', 1, 'test')
    assert (p['solver_version'], p['data_version']) == (SOLVER_VERSION, DATA_VERSION)
    assert p['penetration_deepest_cells'] >= 0.0 and p['penetration_inside'] >= 0
    assert p['blade_width_m'] in (0.30, 0.457) and p['solver_cpu_s'] > 0.0
    assert made(small.BLADE, 'stops_9001', 3).parameters['split'] is None
    assert (found.heights[0] == np.float32(small.BLADE.bin.surface)).all()
    assert found.heights[-1].min() < small.BLADE.bin.surface - 0.002
    grid = made(small.BLADE, splits.grid_runs(scenes.EXCAVATION)[0], 3)
    assert grid.parameters['kind'] == 'grid' and grid.parameters['split'] in splits.SPLITS


def test_wheel_records_its_free_height_and_the_changing_load(made, monkeypatch):
    monkeypatch.setattr('mpm.motions.grid.REST_FRAMES', 24)
    found = made(small.WHEEL, 'load_0007', 61)
    motion = catalogue.motion_of(small.WHEEL, 'load_0007')
    expected = -motion.drive.machine.force(np.arange(61) / 60)[:, 1]
    assert np.ptp(expected) > 0.0
    gravity, angle, load = found.step_context.T
    np.testing.assert_allclose(load, expected, rtol=1e-6)
    context = found.parameters['context']
    assert (gravity == np.float32(context['gravity'])).all()
    assert (angle == context['friction_angle_deg']).all()
    check_points(found)
    # The soil carries what weighs on it, within the inertia of a wheel that hardly moves.
    assert found.force[1:, 1].mean() == pytest.approx(expected[1:].mean(), rel=0.05)
    assert context['load'] == pytest.approx(float(expected[0]))


def test_wheel_that_the_soil_does_not_carry_is_an_error(made, monkeypatch):
    monkeypatch.setattr('mpm.motions.grid.REST_FRAMES', 2)
    monkeypatch.setattr(scenes, 'wheel_load', lambda context: 1500.0)
    with pytest.raises(ValueError, match=r'the body sank to the floor at 0\.\d+ s.* not carry it'):
        made(small.WHEEL, 'slip_0004', scenes.FRAMES)


def test_a_free_run_says_what_drove_it(made):
    found = made(small.BLADE, 'free_0000', 9, tool=BUCKET)
    check_points(found)
    assert found.target.shape == found.external.shape == (9, 3)
    assert found.subframe_force.shape == (9, 4, 3)
    np.testing.assert_allclose(found.subframe_force.mean(axis=1), found.force, atol=1e-3)
    machine = found.parameters['machine']
    assert machine['is_free'][1] and machine['mass_kg'] > 0.0


def test_soil_of_the_settings_arrives_in_the_record(made):
    soil = {'friction_angle_deg': 33.0, 'bulk_density': 1500.0, 'gravity': 3.72}
    p = made(small.BLADE, 22, 3, Settings(**soil, tool_friction=0.1)).parameters
    assert p['friction_angle_deg'] == p['set_friction_angle_deg'] == 33.0
    assert p['gravity_m_s2'] == p['set_gravity_m_s2'] == 3.72
    assert p['soil']['bulk_density'] == p['bulk_density_kg_m3'] == 1500.0
    assert p['soil']['mu_s'] == pytest.approx(math.tan(math.radians(33.0)))
    assert p['body_friction'] == p['set_tool_friction'] == 0.1
    usual = made(small.BLADE, 22, 3).parameters
    assert not [name for name in usual if name.startswith('set_')]


def test_record_begins_after_the_lead_in(made):
    done = []
    found = made(small.BLADE, 'disturbed_0004', 31, on_frame=done.append)
    lead_in = found.parameters['lead_in_frames']
    assert len(found.positions) == 31 and done == list(range(1, lead_in + 31))
    # The bed is cut before the first frame, and calm; the blade stands above it.
    flat = small.packed(small.BLADE)[0][:, :3]
    moved = np.linalg.norm(found.positions[0] - flat, axis=1)
    assert 0.02 < (moved > 0.01).mean() < 0.5
    assert np.linalg.norm(found.positions[1] - found.positions[0], axis=1).max() < 2e-3
    assert np.abs(found.force[0]).max() < 1.0
    drive = catalogue.motion_of(small.BLADE, 'disturbed_0004').drive
    expected = drive.pose(np.array([lead_in / 60]))[0]
    np.testing.assert_allclose(found.pose[0, :2], expected[:2], atol=1e-6)
