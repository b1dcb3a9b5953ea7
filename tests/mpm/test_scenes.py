"""Tables of cases against nested loops written out, motions against their definition."""

import numpy as np
import pytest

from mpm import bodies, scenes


def test_excavation_numbers_are_nested_loops():
    case = 0
    for depth in (0.02, 0.04, 0.05, 0.08, 0.10):
        for speed in (0.01, 0.04, 0.08, 0.10, 0.15):
            for angle in (0.0, 3.8, 10.0, 30.8, 45.0):
                for motion in (1, 2):
                    case += 1
                    found = scenes.EXCAVATION.parameters(case)
                    assert tuple(found.values()) == (depth, speed, angle, motion)
                    assert scenes.EXCAVATION.case_id(**found) == case
    assert scenes.EXCAVATION.case_count == case == 250


def test_wheel_numbers_are_nested_loops():
    case = 0
    for gravity in (1.62, 3.72, 9.81):
        for slip in (20, 40, 70):
            for load in (100.0, 164.0, 225.0):
                for diameter in (0.05, 0.15, 0.30):
                    for friction in (30.0, 37.0, 43.0):
                        case += 1
                        found = scenes.WHEEL.parameters(case)
                        assert tuple(found.values()) == (gravity, slip, load, diameter, friction)
    assert scenes.WHEEL.case_count == case == 243


def test_published_wheel_contexts():
    """Contexts of published records, as they stand in their files."""
    expected = {44: (1.62, 37.0, 164.0), 154: (3.72, 30.0, 25.0), 203: (9.81, 37.0, 164.0)}
    for case, values in expected.items():
        context = scenes.context_of(scenes.WHEEL, scenes.WHEEL.parameters(case))
        assert tuple(context.values()) == pytest.approx(values)
        assert tuple(context) == scenes.WHEEL.context_names


@pytest.mark.parametrize('scene', scenes.SCENES.values(), ids=str)
def test_mini_cases_are_spread(scene):
    cases = scenes.mini_cases(scene)
    assert len(set(cases)) == 40 and cases == scenes.mini_cases(scene)
    assert set(scene.published) <= set(cases)
    assert scene.demo_case not in cases
    for name, values in scene.levels.items():
        used = [scene.parameters(case)[name] for case in cases]
        counts = [used.count(value) for value in values]
        # The published ones are uneven; the rest evens it out.
        assert min(counts) >= 0.7 * 40 / len(values), (name, counts)


@pytest.mark.parametrize('scene', scenes.SCENES.values(), ids=str)
def test_demo_case_is_no_corner_of_the_grid(scene):
    parameters = scene.parameters(scene.demo_case)
    for name, values in scene.levels.items():
        if len(values) > 2:
            assert parameters[name] not in (values[0], values[-1])


def test_first_motion_is_ramp_cut_ramp():
    times = np.arange(0, 30, 0.01)
    path = scenes.blade_displacement(1, 0.05, 0.1, times)
    assert path[:, 1].min() == pytest.approx(-0.05)
    velocity = np.diff(path, axis=0) / 0.01
    np.testing.assert_allclose(velocity[50], [-0.025, -0.025], atol=1e-12)
    np.testing.assert_allclose(velocity[400], [-0.1, 0.0], atol=1e-12)
    np.testing.assert_allclose(velocity[700], [-0.025, 0.025], atol=1e-12)
    np.testing.assert_allclose(path[-1], [-0.5, 0.0], atol=1e-12)


def test_second_motion_is_half_an_ellipse():
    times = np.linspace(0, 10, 1001)
    path = scenes.blade_displacement(2, 0.08, 0.1, times)
    on_ellipse = ((path[:, 0] + 0.2) / 0.2) ** 2 + (path[:, 1] / 0.08) ** 2
    np.testing.assert_allclose(on_ellipse, 1.0, atol=1e-12)
    assert path[:, 0].min() == pytest.approx(-0.38)
    np.testing.assert_allclose(np.diff(path[100:300, 0]), -0.001, atol=1e-12)


def test_published_blade_motion():
    """Travel between stored frames of published records (float32 files, four decimals)."""
    # Case 213, motion 1 at 4 cm/s: from frame 80 to 160 of the record, 0.0333 m down and forward.
    path = scenes.blade_displacement(1, 0.10, 0.04, np.array([80.0, 160.0]) / 60)
    np.testing.assert_allclose(path[1] - path[0], [-0.0333, -0.0333], atol=1e-4)
    # Case 186, motion 2 at 10 cm/s, frames 80 and 160 (record: 0.7005 and 0.5672).
    path = scenes.blade_displacement(2, 0.08, 0.10, np.array([80.0, 160.0]) / 60)
    assert path[1, 0] - path[0, 0] == pytest.approx(0.5672 - 0.7005, abs=1e-4)


def test_unknown_motion_is_refused():
    with pytest.raises(ValueError, match='motion'):
        scenes.blade_displacement(3, 0.1, 0.1, np.zeros(1))


@pytest.mark.parametrize(('slip', 'ratio'), [(20, 0.2), (40, 0.385), (70, 0.7)])
@pytest.mark.parametrize('diameter', [0.05, 0.15, 0.3])
def test_wheel_slips_as_much_as_it_says(slip, ratio, diameter):
    parameters = scenes.WHEEL.parameters(122) | {'slip_percent': slip, 'diameter_m': diameter}
    drive = scenes.make_drive(scenes.WHEEL, parameters)
    path = drive.path(np.array([0.0, 1.0]))
    travel = path[0, 0] - path[1, 0]
    assert 1 - travel / (drive.spin * diameter / 2) == pytest.approx(ratio, abs=0.001)


def test_small_wheel_carries_a_ninth():
    parameters = scenes.WHEEL.parameters(122) | {'diameter_m': 0.05}
    assert scenes.wheel_load(parameters) == pytest.approx(164.0 / 9)


@pytest.mark.parametrize('scene', scenes.SCENES.values(), ids=str)
def test_bodies_stay_within_the_bounds(scene):
    """Every case, at every frame, with a margin of a cell."""
    times = np.arange(scenes.FRAMES) / scenes.FRAME_RATE
    low, high = np.array(scene.bin.bounds).T
    for case in range(1, scene.case_count + 1):
        drive = scenes.make_drive(scene, scene.parameters(case))
        path = drive.path(times)
        for x, y in path[[0, 80, 160, 240, 320]]:
            if drive.load:
                y = scene.bin.surface + drive.body.dims[3]
            points = bodies.sample_points(drive.body, x, y, 0.0)
            assert (points > low + scene.bin.dx).all() and (points < high - scene.bin.dx).all()


def test_blade_near_the_floor_is_refused():
    parameters = scenes.EXCAVATION.parameters(1) | {'depth_m': 0.15}
    with pytest.raises(ValueError, match='0.15 m brings the blade within a cell'):
        scenes.make_drive(scenes.EXCAVATION, parameters)


@pytest.mark.parametrize(
    ('text', 'words'),
    [('', 'mini'), ('all', 'mini'), ('0', 'cases 1 to 250'), ('251', '251'), ('3,3', 'twice')],
)
def test_bad_case_lists_are_refused(text, words):
    with pytest.raises(ValueError, match=words):
        scenes.select_cases(scenes.EXCAVATION, text)


def test_case_lists():
    assert scenes.select_cases(scenes.WHEEL, '44, 122') == (44, 122)
    assert scenes.select_cases(scenes.WHEEL, 'full') == tuple(range(1, 244))
    with pytest.raises(ValueError, match="unknown scene 'sea'"):
        scenes.scene_named('sea')
