"""Runs of a dataset as a soil field reads them, against the raw runs."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from learning_to_simulate.soil_field import runs
from learning_to_simulate.soil_field.tools import Blade, Soil, Wheel
from pca_tools import convert
from tests.pca_tools.synthetic import raw_of, write_raw_folder
from tests.pca_tools.test_heights import BIN, SPLITS, surface


@pytest.mark.parametrize(
    'case, tool',
    [
        ({'body_width_m': 0.457}, Blade(0.457)),
        ({'blade_width_m': 0.3, 'body_width_m': 0.3}, Blade(0.3)),
        (
            {'body_width_m': 0.4, 'tool': {'name': 'scoop', 'width': 0.4, 'edge_radius': 0.004,
             'outline': [[0, 0.0], [0.2, 0.03], [0.1, 0.35]], 'side_plates': {'thickness': 0.02}}},
            Blade(0.4, 0.004, 0.35, 1.0, 1.0, np.degrees(np.arctan(0.15)),
                  np.hypot(0.2, 0.03) / 0.35),
        ),
        ({'body_width_m': 0.08, 'diameter_m': 0.15}, Wheel(0.08, 0.075)),
        (
            {'body_width_m': 0.1, 'diameter_m': 0.2,
             'tool': {'radius': 0.1, 'grousers': {'count': 12, 'height': 0.01}}},
            Wheel(0.1, 0.1, 12, 0.01),
        ),
    ],
)  # fmt: skip
def test_tools_are_read_from_parameters(case, tool):
    found = runs.tool_of(case)
    assert type(found) is type(tool)
    assert dataclasses.astuple(found) == pytest.approx(dataclasses.astuple(tool))


def test_a_soil_is_that_of_the_parameters():
    said = {'friction_angle_deg': 30.0, 'bulk_density_kg_m3': 1500.0, 'gravity_m_s2': 1.62}
    assert runs.soil_of(said) == Soil(30.0, 1500.0, 1.62)
    assert runs.soil_of({}) == Soil()


def test_a_floor_lies_as_deep_as_the_bin_is_filled():
    maps = np.full((2, 5, 5), 0.25)
    maps[0, 0] = 0.31, 0.1, 0.25, 0.25, 0.25  # a heap, a trench
    maps[1] = 0.0
    assert runs.floor_of({'bin_m': [0.8, 0.15, 0.6]}, maps) == pytest.approx(0.1)
    assert runs.floor_of({}, maps) < -100


def test_what_moved_a_tool_is_read_from_its_record():
    pose = np.tile([0.4, 0.3, 0.2, 1.0, 0, 0, 0], (5, 1)).astype(np.float32)
    target = np.stack([np.linspace(0.4, 0.5, 5), np.full(5, 0.25), np.full(5, -0.3)], axis=1)
    external = np.tile([1.0, -30.0, 2.0], (5, 1))
    record = SimpleNamespace(rigid_pose=pose, target=target, external=external)
    said = {'is_free': [True, True, False], 'mass_kg': 12.0, 'inertia_kg_m2': 0.5,
            'stiffness': [4e4, 3e4, 0.0], 'damping': [1e3, 2e3, 0.0]}  # fmt: skip
    machine = runs.machine_of({'machine': said}, record)
    assert machine[:3] == (12.0, 0.5, (True, True, False))
    np.testing.assert_array_equal(machine.stiffness, said['stiffness'])
    np.testing.assert_array_equal(machine.damping, said['damping'])
    # The angle counts about +z; across the way the body stays where it is.
    turn = Rotation.from_quat(np.roll(machine.target[:, 3:], -1, axis=1)).as_rotvec()
    np.testing.assert_allclose(turn, np.tile([0, 0, -0.3], (5, 1)), atol=1e-12)
    np.testing.assert_allclose(machine.target[:, :2], target[:, :2])
    np.testing.assert_allclose(machine.target[:, 2], 0.2, atol=1e-7)
    np.testing.assert_array_equal(machine.external[:, [0, 1, 5]], external)
    wheel = runs.machine_of({}, record)
    assert wheel.free == (False, True, False) and wheel.mass == pytest.approx(30.0 / 9.81)
    assert runs.machine_of({}, SimpleNamespace(target=None, external=None)) is None


def raw_folder(folder, change, **parameters):
    split = {'split': lambda case: SPLITS.get(case, 'train'), 'bin_m': BIN}
    return write_raw_folder(folder, 'excavation', range(1, 8), change=change, **split, **parameters)


def add_torque(case, arrays):
    arrays['heights'] = surface(case)
    arrays['torque'] = arrays['force'][:, ::-1].copy()


def test_a_dataset_gives_its_raw_runs(tmp_path):
    raw = raw_folder(tmp_path / 'raw', add_torque, body_width_m=0.5)
    convert.convert(raw, str(tmp_path / 'data'), modes=4)
    found = runs.read(str(tmp_path / 'data'), 'test')
    assert [run.case for run in found] == ['6', '7']
    for run in found:
        truth = raw_of(raw, int(run.case))
        np.testing.assert_allclose(run.pose, truth['pose'], atol=1e-7)
        for name in ('force', 'torque'):
            np.testing.assert_array_equal(getattr(run, name), truth[name])
        np.testing.assert_allclose(run.heights, truth['heights'][::4], atol=6e-5)
        assert run.particles.shape[0] == len(run.heights) == 6 and run.stride == 4
        assert run.tool == Blade(0.5) and run.terrain(8).shape == run.heights.shape[1:]
        assert (run.terrain(8).heights == run.heights[2]).all()
        assert (run.before().heights == run.heights[0]).all() and np.ptp(run.heights[0]) > 1e-3
        np.testing.assert_allclose(run.terrain().cell * run.terrain().shape, [BIN[0], BIN[2]])


@pytest.mark.parametrize('lead_in', [{}, {'lead_in_frames': 120}])
def test_a_wheel_stands_on_a_level_bed_or_over_a_rut(tmp_path, lead_in):
    wheel = {'diameter_m': 0.3, 'body_width_m': 0.1}
    raw = raw_folder(tmp_path / 'raw', add_torque, **wheel, **lead_in)
    convert.convert(raw, str(tmp_path / 'data'), modes=4)
    for run in runs.read(str(tmp_path / 'data'), 'test'):
        bed = run.before().heights
        assert run.tool == Wheel(0.1, 0.15) and np.ptp(run.heights[0]) > 1e-3
        assert np.all(bed == run.heights[0] if lead_in else bed == np.median(run.heights[0]))


def test_what_is_missing_is_named(tmp_path):
    def without_torque(case, arrays):
        arrays['heights'] = surface(case)

    raw = raw_folder(tmp_path / 'raw', without_torque)
    convert.convert(raw, str(tmp_path / 'data'), modes=4)
    with pytest.raises(ValueError, match='run 6 lacks a pose, force or torque'):
        runs.read(str(tmp_path / 'data'), 'test')
    raw = raw_folder(tmp_path / 'raw2', add_torque)
    convert.convert(raw, str(tmp_path / 'data2'), modes=4)
    with pytest.raises(ValueError, match="run 6 does not say its tool.*'body_width_m'"):
        runs.read(str(tmp_path / 'data2'), 'test')
