"""Resistive force theory: symmetries, friction, the older theory of the plane, closed forms."""

import dataclasses

import numpy as np
import pytest

from learning_to_simulate.soil_field.place import place_of
from learning_to_simulate.soil_field.tools import Blade, Wheel
from reports.protocol import resistive_force
from tests.learning_to_simulate.soil_field import worlds


def pointing(degrees):
    return np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])


def plane_theory(beta, gamma):
    """Stress along and up of Li, Zhang & Goldman (2013), Science 339, 1408, generic coefficients:
    of a plate whose leading side is turned by beta, which goes down at gamma."""
    b, g = np.radians([beta, gamma])
    up = 0.206 + 0.169 * np.cos(2 * b) + 0.212 * np.sin(2 * b + g) + 0.358 * np.sin(g)
    up += 0.055 * np.sin(g - 2 * b)
    along = -0.124 * np.cos(2 * b + g) + 0.253 * np.cos(g) + 0.007 * np.sin(g - 2 * b)
    return np.array([-along - 0.088 * np.sin(2 * b), up])


@pytest.mark.parametrize(('beta', 'gamma'), [(0, 90), (30, 90), (30, 45), (60, 45), (45, 0)])
def test_it_is_like_the_older_theory_of_the_plane(beta, gamma):
    found = resistive_force.stress(pointing(beta - 90), pointing(-gamma), friction=10.0)
    # The plates of that theory are rougher than those of the other.
    assert found == pytest.approx(plane_theory(beta, gamma), abs=0.22)


def test_stresses_push_rub_no_more_than_friction_and_do_not_know_left_from_right():
    rng = np.random.default_rng(0)
    normal, motion = (pointing(rng.uniform(-180, 180, 500)).T for _ in range(2))
    found = resistive_force.stress(normal, motion, 0.3)
    pressure = -(found * normal).sum(axis=1)
    shear = np.linalg.norm(found + pressure[:, None] * normal, axis=1)
    assert (pressure >= 0).all() and (shear <= 0.3 * pressure + 1e-12).all()
    assert not found[(normal * motion).sum(axis=1) < 0].any() and found.any(axis=1).mean() > 0.3
    mirror = np.array([-1.0, 1.0])
    again = resistive_force.stress(mirror * normal, mirror * motion, 0.3)
    np.testing.assert_allclose(again, mirror * found, atol=1e-12)


@pytest.mark.parametrize('tool', [Blade(width=0.3, radius=0.02, length=0.2), Wheel(radius=0.1)])
def test_outlines_are_closed_but_for_the_top_of_a_blade(tool):
    places, normals, lengths = resistive_force.outline(tool)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    open_top = np.array([0.0, -2 * tool.radius]) if tool.name == 'blade' else 0.0
    np.testing.assert_allclose((normals * lengths[:, None]).sum(axis=0), open_top, atol=1e-4)
    assert places[:, 1].min() == pytest.approx(-tool.radius, rel=1e-2)


def pressed_run():
    """An upright blade that goes straight down into a flat bed, 5 mm a frame, and halts."""
    deep = np.clip(0.005 * np.arange(-2, 13), None, 0.03)
    way = np.stack([0 * deep, worlds.TOOL.radius - deep, 0 * deep], axis=1)
    run = worlds.run(0, way=way)
    return run._replace(heights=np.zeros_like(run.heights)), np.maximum(deep, 0.0)


def test_a_plate_that_is_pressed_down_feels_its_depth_and_keeps_it_where_it_halts():
    run, depth = pressed_run()
    force, torque = resistive_force.loads(run)
    assert force.shape == torque.shape == (len(run.pose), 3)
    soil = run.soil
    xi = resistive_force.scale(soil.density, soil.gravity, soil.friction)
    # No deeper than its radius, the round edge is the whole plate; its stress is near that of flat
    # ground under a flat plate, 0.875, and less on the slopes.
    early = (depth > 0) & (depth <= run.tool.radius)
    wide = 2 * np.sqrt(2 * run.tool.radius * depth[early] - depth[early] ** 2)
    flat = 0.875 * xi * run.tool.width * wide * depth[early]
    assert (force[early, 1] < flat).all() and (force[early, 1] > 0.4 * flat).all()
    assert (np.diff(force[2:9, 1]) > 0).all()
    np.testing.assert_allclose(force[9:], force[8:9].repeat(len(force) - 9, 0), rtol=1e-9)
    np.testing.assert_allclose(force[:, [0, 2]], 0.0, atol=1e-9 * force.max())
    heavy = dataclasses.replace(soil, gravity=2 * soil.gravity)
    np.testing.assert_allclose(resistive_force.loads(run._replace(soil=heavy))[0], 2 * force)


def test_the_factor_fits_and_errors_follow_from_it():
    run = worlds.run(1)
    force, torque = resistive_force.loads(run)
    run = run._replace(force=0.25 * place_of(run.pose[0]).vectors(force), torque=0.25 * torque)
    assert resistive_force.gain([run, run]) == pytest.approx(0.25)
    plain, fitted = resistive_force.errors(run, (1.0, 0.25))
    assert plain['force_relative_l2'] == pytest.approx(3.0)
    assert fitted['force_relative_l2'] == pytest.approx(0.0, abs=1e-6)
