"""What a run records: pose, torque, load, parameters; what a lead-in leaves."""

import dataclasses

import numpy as np
import pytest

from mpm import bodies, run, scenes, splits, versions
from mpm.motions import catalogue
from mpm.simulation import Settings


def rotated(quaternion, vector):
    """Turns a vector by a unit quaternion (w, x, y, z): v + 2 u x (u x v + w v)."""
    w, u = quaternion[0], quaternion[1:]
    return vector + 2.0 * np.cross(u, np.cross(u, vector) + w * vector)


@pytest.fixture
def short(monkeypatch):
    monkeypatch.setattr(scenes, 'FRAMES', 31)


def body_of(scene, parameters):
    if scene.name == 'wheel':
        return bodies.make_wheel(parameters['diameter_m'])
    return bodies.make_blade(parameters.get('blade_width_m', 0.457))


@pytest.mark.parametrize('case', [188, 'reverse_0002'])
def test_pose_moves_the_upright_points_onto_the_sample_points(
    coarse_excavation, excavation_packing, short, case
):
    made = run.run_case(coarse_excavation, case, excavation_packing, Settings())
    points = body_of(coarse_excavation, made.parameters).points
    for pose, sampled in zip(made.pose.astype(np.float64), made.rigid_positions):
        assert np.linalg.norm(pose[3:]) == pytest.approx(1.0, abs=1e-6)
        expected = [pose[:3] + rotated(pose[3:], point) for point in points]
        np.testing.assert_allclose(sampled, expected, atol=1e-6)
    assert made.pose.dtype == made.torque.dtype == np.float32 and made.step_context is None


def test_wheel_records_its_free_height_and_the_changing_load(
    coarse_wheel, wheel_packing, short, monkeypatch
):
    monkeypatch.setattr('mpm.motions.grid.REST_FRAMES', 24)
    monkeypatch.setattr(scenes, 'FRAMES', 61)
    made = run.run_case(coarse_wheel, 'load_0007', wheel_packing, Settings())
    motion = catalogue.motion_of(coarse_wheel, 'load_0007')
    expected = -motion.drive.machine.force(np.arange(61) / 60)[:, 1]
    assert np.ptp(expected) > 0.0
    gravity, angle, load = made.step_context.T
    np.testing.assert_allclose(load, expected, rtol=1e-6)
    context = made.parameters['context']
    assert (gravity == np.float32(context['gravity'])).all()
    assert (angle == context['friction_angle_deg']).all()
    points = body_of(coarse_wheel, made.parameters).points
    for pose, sampled in zip(made.pose[::10].astype(np.float64), made.rigid_positions[::10]):
        moved = [pose[:3] + rotated(pose[3:], point) for point in points]
        np.testing.assert_allclose(sampled, moved, atol=1e-6)
    # The soil carries what weighs on it, within the inertia of a wheel that hardly moves.
    assert made.force[1:, 1].mean() == pytest.approx(expected[1:].mean(), rel=0.05)
    assert context['load'] == pytest.approx(float(expected[0]))


def test_wheel_that_the_soil_does_not_carry_is_an_error(coarse_wheel, wheel_packing, monkeypatch):
    monkeypatch.setattr('mpm.motions.grid.REST_FRAMES', 2)
    monkeypatch.setattr(scenes, 'wheel_load', lambda context: 1500.0)
    with pytest.raises(ValueError, match=r'the body sank to the floor at 0\.\d+ s.* not carry it'):
        run.run_case(coarse_wheel, 'slip_0004', wheel_packing, Settings())


def test_draft_and_torque_belong_together(coarse_excavation, excavation_packing, monkeypatch):
    """The resultant acts within the part of the blade that is in the soil."""
    monkeypatch.setattr(scenes, 'FRAMES', 161)
    made = run.run_case(coarse_excavation, 182, excavation_packing, Settings())  # upright, 8 cm
    force, torque = made.force[100:].mean(axis=0), made.torque[100:].mean(axis=0)
    assert force[0] > 50.0
    # About the edge torque_z = x F_y - y F_x; the face stands 14 mm ahead of it. The draft acts
    # between the round edge and the middle of the 8 cm that are in the soil (measured -1 mm).
    height = (-0.014 * force[1] - torque[2]) / force[0]
    assert -0.014 < height < 0.04
    # Roll and yaw are those of a draft that acts within half a cell of the middle: with two
    # particles a cell they hang on where the grains lie, and change their sign with a mirrored bed
    # (`test_experiments.py::test_no_side_is_preferred`). Measured 17 mm of 20.
    assert np.abs(torque[:2]).max() < 0.5 * coarse_excavation.bin.dx * force[0]


def test_parameters_say_what_was_run(coarse_excavation, excavation_packing, short):
    made = run.run_case(coarse_excavation, 'stops_0001', excavation_packing, Settings())
    p = made.parameters
    assert (p['case'], p['kind'], p['path_seed'], p['split']) == ('stops_0001', 'stops', 1, 'test')
    assert p['solver_version'] == versions.SOLVER_VERSION
    assert p['data_version'] == versions.DATA_VERSION
    assert p['penetration_deepest_cells'] >= 0.0 and p['penetration_inside'] >= 0
    assert p['blade_width_m'] in (0.30, 0.457) and p['solver_cpu_s'] > 0.0
    new = run.run_case(coarse_excavation, 'stops_9001', excavation_packing, Settings())
    assert new.parameters['split'] is None
    case = splits.grid_runs(scenes.EXCAVATION)[0]
    grid = run.run_case(coarse_excavation, case, excavation_packing, Settings())
    assert grid.parameters['kind'] == 'grid' and grid.parameters['split'] in splits.SPLITS


def test_record_begins_after_the_lead_in(coarse_excavation, excavation_packing, short):
    done = []
    made = run.run_case(
        coarse_excavation, 'disturbed_0004', excavation_packing, Settings(), done.append
    )
    lead_in = made.parameters['lead_in_frames']
    assert len(made.positions) == 31 and done == list(range(1, lead_in + 31))
    # The bed is cut before the first frame, and calm; the blade stands above it.
    flat = excavation_packing[0][:: coarse_excavation.bin.keep_every, :3]
    moved = np.linalg.norm(made.positions[0] - flat, axis=1)
    assert 0.02 < (moved > 0.01).mean() < 0.5
    assert np.linalg.norm(made.positions[1] - made.positions[0], axis=1).max() < 2e-3
    assert np.abs(made.force[0]).max() < 1.0
    drive = catalogue.motion_of(coarse_excavation, 'disturbed_0004').drive
    expected = drive.pose(np.array([lead_in / 60]))[0]
    np.testing.assert_allclose(made.pose[0, :2], expected[:2], atol=1e-6)


def test_motion_out_of_the_bin_is_refused_before_it_is_simulated(
    coarse_excavation,
):
    shallow = dataclasses.replace(coarse_excavation.bin, size=(0.8, 0.1, 0.6))
    scene = dataclasses.replace(coarse_excavation, bin=shallow)
    with pytest.raises(ValueError, match='cell above the floor'):  # 10 cm of 10 cm
        run.prepared(scene, 242, Settings())
