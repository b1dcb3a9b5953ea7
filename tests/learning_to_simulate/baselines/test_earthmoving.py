"""The equation of earthmoving against limit equilibrium written anew, and against closed forms."""

import dataclasses
import math

import numpy as np
import pytest

from learning_to_simulate.axes import Axes, blade_pose
from learning_to_simulate.baselines import earthmoving
from learning_to_simulate.baselines.earthmoving import BLADE, BladeSoil, EarthmovingForce
from learning_to_simulate.reading_utils import RunGroup
from learning_to_simulate.scene import RigidMotion, Scene
from mpm import bodies
from mpm.earthmoving import draft_force

SOIL = BladeSoil(
    unit_weight=17e3, friction_angle=0.65, wall_angle=0.29, repose_angle=0.6, width=0.457,
    height=0.3,
)  # fmt: skip
CASE = {'case': 1, 'soil': {'bulk_density': 1730.0, 'mu_s': 0.76}, 'body_friction': 0.3}


def kinematic_scene(motion=RigidMotion.PRESCRIBED):
    return Scene('blade', 1, motion, (), True, (), 10, 1 / 60)


def blade_group(path, lean_deg=0.0):
    """One run of the solver's blade along a path [T, 2] of its edge's middle (x, y)."""
    lean = math.radians(lean_deg)
    points = []
    for row in range(4):
        # The rows of the blade's face, 0.1 m apart, 0.0115 m below the edge's middle the first.
        along, front = -BLADE.along + 0.1 * row, BLADE.behind
        x = along * math.sin(lean) - front * math.cos(lean)
        y = along * math.cos(lean) + front * math.sin(lean)
        points += [(x, y, 0.1 * column) for column in range(5)]
    body = np.array(points)[None] + np.concatenate([path, np.zeros((len(path), 1))], 1)[:, None]
    modes = np.zeros((len(path), 1, 3))
    return RunGroup(
        n_rigid=20,
        particle_type=np.array([3] * 20 + [6]),
        position=np.concatenate([body, modes], axis=1)[None],
        force=np.zeros((1, len(path), 3)),
        context=None,
        record=np.array([0]),
    )


def forward_path(depth=0.05, n=40, surface=0.25):
    """Down to a depth of the edge's lowest point, then forward (towards -x)."""
    radius = BLADE.radius
    x = np.concatenate([np.full(n // 4, 0.8), 0.8 - 0.005 * np.arange(n - n // 4)])
    y = np.full(n, surface + radius - depth)
    y[: n // 4] = np.linspace(surface + radius + 0.05, surface + radius - depth, n // 4)
    return np.stack([x, y], axis=1)


def method(group, **options):
    axes = Axes.of_bodies([group.position[:, :, :20]], 1)
    return EarthmovingForce(kinematic_scene(), axes, 0.25, **options)


@pytest.mark.parametrize('depth, rake_deg', [(0.02, 90.0), (0.05, 86.0), (0.1, 60.0), (0.1, 45.0)])
def test_force_is_that_of_the_force_polygon(depth, rake_deg):
    """Twin: the solver's own check finds the same wedge from the equilibrium of forces."""
    rake = math.radians(rake_deg)
    expected = draft_force(
        depth, SOIL.width, rake, SOIL.friction_angle, SOIL.wall_angle, SOIL.unit_weight
    )
    parts = earthmoving.cutting_force(depth, rake, 0.0, SOIL)
    assert parts[0, 0] == pytest.approx(expected, rel=2e-3)
    assert (parts[1] == 0).all()
    angle = rake + SOIL.wall_angle
    assert parts[0, 1] == pytest.approx(-expected / math.tan(angle), rel=2e-3)


def test_a_heap_on_the_wedge_weighs_as_in_the_force_polygon():
    area, slope = 0.01, math.tan(SOIL.repose_angle)
    length = math.sqrt(2 * area / slope)

    def weight(reach):
        left = max(length - reach, 0.0)
        return SOIL.unit_weight * SOIL.width * (area - 0.5 * slope * left**2)

    expected = draft_force(
        0.05, SOIL.width, 1.5, SOIL.friction_angle, SOIL.wall_angle, SOIL.unit_weight, weight
    )
    assert earthmoving.cutting_force(0.05, 1.5, area, SOIL)[:, 0].sum() == pytest.approx(
        expected, rel=2e-3
    )


def test_a_wide_smooth_upright_wall_bears_rankines_passive_pressure():
    """gamma d2 / 2 tan2(45 + phi / 2) per metre of width."""
    phi = 0.55
    soil = dataclasses.replace(SOIL, friction_angle=phi, wall_angle=0.0, width=1e6)
    found = earthmoving.cutting_force(0.3, math.pi / 2, 0.0, soil).sum(axis=0)[0] / soil.width
    expected = 0.5 * soil.unit_weight * 0.3**2 * math.tan(math.pi / 4 + phi / 2) ** 2
    assert found == pytest.approx(expected, rel=1e-3)


def test_the_edge_lies_where_the_solvers_blade_has_it():
    """`bodies.make_blade` counts its points from the middle of the edge."""
    points = bodies.make_blade(friction=0.0).points
    geometry = BLADE
    row = points[points[:, 1] < points[:, 1].min() + 0.01].mean(axis=0)
    assert (geometry.along, geometry.behind) == pytest.approx((-row[1], -row[0]), abs=1e-4)
    assert (geometry.width, geometry.height) == (bodies.BLADE_WIDTH, bodies.BLADE_HEIGHT)
    assert geometry.points_width == pytest.approx(np.ptp(points[:, 2]))
    assert geometry.radius == bodies.BLADE_THICKNESS / 2
    for lean_deg in (0.0, 30.0):
        path = forward_path()
        group = blade_group(path, lean_deg)
        axes = Axes.of_bodies([group.position[:, :, :20]], 1)
        pose, lean = blade_pose(group.position[:, :, :20], axes)
        assert np.degrees(lean) == pytest.approx(lean_deg)
        edge = geometry.edge(pose, lean)[0]
        np.testing.assert_allclose(edge, np.stack([-path[:, 0], path[:, 1]], axis=1), atol=1e-9)


def test_force_along_a_path_opposes_the_motion_and_is_absent_in_the_air_and_backwards():
    path = np.concatenate([forward_path(), forward_path()[:25:-1]])
    group = blade_group(path)
    prediction = method(group).predict(group, [CASE])
    force = prediction.force[0]
    forward = slice(11 - 6, 40 - 6)
    assert (force[forward, 0] > 10).all(), 'soil pushes a blade that moves towards -x to +x'
    assert (force[forward, 1] > 0).all(), 'and, upright, up along its face by friction'
    assert (np.diff(force[forward, 0]) > -1e-9).all(), 'the heap grows'
    assert (force[41 - 6 :] == 0).all()
    air = blade_group(forward_path(depth=-0.01))
    assert (method(air).predict(air, [CASE]).force == 0).all()
    still = group.position[:, 5:6, 20:]
    assert (prediction.position[:, :, 20:] == still).all()


def test_a_second_pass_cuts_only_what_the_first_one_left():
    """Back above the bed and forward again at the same depth: no wedge but where the cut ends."""
    there = forward_path()
    back = np.stack([there[::-1, 0], np.full(len(there), 0.35)], axis=1)
    again = np.stack([there[10:, 0], np.full(30, there[-1, 1])], axis=1)
    group = blade_group(np.concatenate([there, back, again]))
    wedge = method(group).wedge_and_heap(group, [CASE])[0, :, 0, 0]
    assert wedge[15:38].min() > 10
    assert wedge[-25:-10].max() < 1e-6


def test_fitted_gains_are_found_again():
    group = blade_group(forward_path(0.08), 20.0)
    gains = np.array([[0.7, 1.3], [0.4, 0.2]])
    truth = method(group, gains=gains).predict(group, [CASE]).force
    force = np.concatenate([np.zeros((1, 6, 3)), truth], axis=1)
    group = dataclasses.replace(group, force=force)
    fitted = method(group).fitted([group], [[CASE]])
    np.testing.assert_allclose(fitted.gains, gains, rtol=1e-6)
    again = EarthmovingForce.of_parts(*fitted.parts(), fitted.scene)
    forces = [one.predict(group, [CASE]).force for one in (again, fitted)]
    np.testing.assert_array_equal(*forces)


def test_bad_input_is_refused():
    group = blade_group(forward_path())
    with pytest.raises(ValueError, match='states no soil'):
        method(group).predict(group, [{'case': 7}])
    with pytest.raises(ValueError, match='driven'):
        EarthmovingForce(kinematic_scene(RigidMotion.DRIVEN), Axes(0, -1, 1), 0.25)
