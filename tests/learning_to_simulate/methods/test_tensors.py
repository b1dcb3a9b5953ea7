"""Path features in TensorFlow against the same lines in numpy, and under compilation."""

import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate.methods import swept_features, tensors
from learning_to_simulate.methods.swept_features import SweptGrid
from learning_to_simulate.methods.swept_field import (
    quality,
    soil_physics,
    tool_path,
    wheel_path,
)
from learning_to_simulate.methods.swept_field.axes import Axes
from learning_to_simulate.methods.swept_field.tool_path import Bed
from learning_to_simulate.methods.swept_field.tools import Blade
from tests.learning_to_simulate.methods.swept_field import small_wheel

GRID = SweptGrid(radius=0.014, spacing=0.004, behind=0.3, ahead=0.5)
DT = 1 / 60


def paths(n_tool=3, n_frame=50):
    """[T, B, 3] smooth paths in and above the soil, forth and back, some frames at rest."""
    rng = np.random.default_rng(0)
    t = np.linspace(0, 1, n_frame)
    waves = rng.normal(size=(n_tool, 2, 3))
    u = 0.08 * np.einsum('bk,kt->tb', waves[:, 0], np.sin(np.outer([1, 2, 4], 2 * t)))
    y = 0.25 + 0.02 * np.einsum('bk,kt->tb', waves[:, 1], np.sin(np.outer([1, 3, 6], 3 * t)))
    path = np.stack([0.7 + np.clip(u, -0.2, 0.4), y, 0.5 * np.sin(u)], axis=-1)
    path[20:24] = path[20]
    return path


@pytest.mark.parametrize('dtype, tolerance', [(np.float64, 1e-12), (np.float32, 2e-6)])
def test_states_and_frames_are_those_of_numpy(dtype, tolerance):
    path = paths()
    surface = 0.25 + 0.01 * np.sin(30 * GRID.offsets) * np.arange(3)[:, None]
    bed = Bed(surface, np.full(3, 0.25), path[0, :, 0] + 0.4)
    width, velocity = np.array([0.3, 0.4, 0.5]), np.full((3, 3), 0.1)
    given = Bed(*(tf.constant(x, dtype) for x in bed))
    ours = tool_path.start(
        GRID, given, tf.constant(path[0], dtype), tf.constant(velocity, dtype), tensors
    )
    theirs = tool_path.start(GRID, bed, path[0], velocity)
    step = tf.function(
        lambda state, pose: tool_path.advance(GRID, state, pose, tf.constant(DT, dtype), tensors),
        autograph=False,
    )
    for pose in path[1:]:
        ours = step(ours, tf.constant(pose, dtype))
        theirs = tool_path.advance(GRID, theirs, pose, DT)
    assert step.experimental_get_tracing_count() == 1
    assert (theirs.swept.profile < theirs.swept.surface).any()
    # The bin at the end of a swath meets the circle where it stands upright: float32 may take it
    # for the next one, and then it is half a circle off (see `swept_features.Finer`).
    edge = 0 if dtype == np.float64 else 4
    for name in ('origin', 'surface', 'position', 'travelled', 'foremost'):
        pair = (getattr(state.swept, name) for state in (ours, theirs))
        np.testing.assert_allclose(*pair, atol=tolerance)
    for one, other in zip((*ours[1:4], ours.swept.velocity), (*theirs[1:4], theirs.swept.velocity)):
        np.testing.assert_allclose(one, other, atol=100 * tolerance)
    for name in ('profile', 'last'):
        apart = np.sort(np.abs(getattr(ours.swept, name) - getattr(theirs.swept, name)).ravel())
        assert apart[-1 - edge] <= 20 * tolerance, name
    mine = tool_path.frame(GRID, given, tf.constant(width, dtype), ours, tensors)
    seen = tool_path.frame(GRID, bed, width, theirs)
    bins = np.sort(np.abs(mine.bins - seen.bins).max(axis=-1).ravel())
    # Float64 ends in float32, as numpy's does; a bin of float32 moves the areas of all later ones.
    assert bins[-1 - edge] <= (1e-6 if not edge else 1e-4)
    np.testing.assert_allclose(mine.scalars, seen.scalars, atol=1e-6 if not edge else 3e-4)


@pytest.mark.parametrize('dtype, tolerance', [(np.float64, 1e-12), (np.float32, 2e-5)])
def test_drives_and_ruts_are_those_of_numpy(dtype, tolerance):
    """Two wheels forth and back with slip and a changing load, one of them in up to its axle."""
    path = np.repeat(small_wheel.path(), 2, axis=1)
    path[:, 1, 1] -= 0.09
    size = np.stack([small_wheel.SIZE] * 2)
    bed = Bed(*(np.repeat(x, 2, axis=0) for x in small_wheel.flat_bed(path[0, 0, 0])))
    bed.surface[:, 70:80] -= 0.003
    velocity = np.full((2, 2), 0.02)
    given = Bed(*(tf.constant(x, dtype) for x in bed))
    ours = wheel_path.start(
        GRID, given, *(tf.constant(x, dtype) for x in (size, path[0], velocity)), tensors
    )
    theirs = wheel_path.start(GRID, bed, size, path[0], velocity)

    def step(drive, rut, pose):
        drive = wheel_path.drive_on(GRID, drive, pose, tf.constant(DT, dtype), tensors)
        return drive, wheel_path.sink(GRID, drive, rut, pose[:, 1], tensors)

    step = tf.function(step, autograph=False)
    for pose in path[1:]:
        ours = step(*ours, tf.constant(pose, dtype))
        drive = wheel_path.drive_on(GRID, theirs[0], pose, DT)
        theirs = drive, wheel_path.sink(GRID, drive, theirs[1], pose[:, 1])
    assert step.experimental_get_tracing_count() == 1
    assert (theirs[1].profile < theirs[1].first).any() and (theirs[0].slid > 1e-3).any()
    np.testing.assert_allclose(ours[1].surface, theirs[1].surface, atol=tolerance)
    mine = wheel_path.frame(GRID, given, *ours, tensors)
    seen = wheel_path.frame(GRID, bed, *theirs)
    # A bin that the rim or the contact just reaches, see `swept_features.Finer`.
    edge = 0 if dtype == np.float64 else 8
    bins = np.sort(np.abs(mine.bins - seen.bins).max(axis=-1).ravel())
    assert bins[-1 - edge] <= (1e-4 if edge else 1e-5)  # of loads of 160 N
    np.testing.assert_allclose(mine.scalars, seen.scalars, rtol=1e-6, atol=3e-4 if edge else 1e-6)


def test_what_lies_in_a_wheel_is_that_of_numpy():
    points = np.random.default_rng(4).uniform(-0.1, 0.1, size=(2000, 3))
    points[0] = [0.01, 0.02, 0.0]  # the axle
    pose = np.array([0.01, 0.02])
    found = soil_physics.inside_wheel(tf.constant(points), tf.constant(pose), 0.07, 0.08, tensors)
    expected = soil_physics.inside_wheel(points, pose, 0.07, 0.08)
    assert (expected[0] > 0).sum() > 200
    for one, other in zip(found, expected):
        np.testing.assert_allclose(one, other, atol=1e-15)


def test_turns_are_differences_of_leans_in_as_many_digits_as_the_change_has():
    rng = np.random.default_rng(5)
    before = rng.normal(size=(200, 4))
    before /= np.linalg.norm(before, axis=1, keepdims=True)
    for axes in (Axes(0, -1, 1, 0.4), Axes(2, 1, 1, 0.1), Axes(0, 1, 2, 0.0)):
        for far in (0.2, 1e-6):
            after = before + far * rng.normal(size=before.shape)
            after /= np.linalg.norm(after, axis=1, keepdims=True)
            leans = (axes.poses(np.pad(q, ((0, 0), (3, 0))))[:, 2] for q in (before, after))
            expected = -np.subtract(*leans)
            expected = (expected + np.pi) % (2 * np.pi) - np.pi
            found = axes.turns(before, after - before)
            np.testing.assert_allclose(found, expected, atol=1e-14)
            change = tf.constant(after - before, tf.float32)
            found = axes.turns(tf.constant(before, tf.float32), change, tensors)
            # Where a lean hardly has a direction, rounding of the rotation tells more.
            apart = np.abs(found - expected) / (np.abs(expected) + far)
            assert np.quantile(apart, 0.95) < 1e-5


def test_a_flat_bed_may_be_a_number_in_numpy():
    position = paths()[0, :, :2]
    number = swept_features.start(GRID, position, 0.25)
    heights = tf.constant(0.25, tf.float64, [3, len(GRID.offsets)])
    each = swept_features.start(GRID, tf.constant(position), heights, tensors)
    np.testing.assert_array_equal(number.profile, each.profile)


def test_finer_differences_tell_which_bins_the_upright_edge_has_reached():
    """A bin 1e-8 m beyond the edge, which float32 positions about 0.6 m cannot tell."""
    bed, start = 0.25, np.array([[0.6, 0.24]])
    gone = GRID.offsets[90] - GRID.radius - 1e-8 - GRID.offsets[75]
    position = start + [[gone, 0.0]]
    state = swept_features.start(GRID, start, bed)
    truth = swept_features.advance(GRID, state, position, DT)
    rows = tf.constant(state.surface, tf.float32)
    state = swept_features.start(GRID, tf.constant(start, tf.float32), rows, tensors)
    edge = tuple(
        tf.constant(GRID.radius - np.abs(GRID.offsets - (x[:, :1] - start[:, :1])), tf.float32)
        for x in (start, position)
    )
    finer = swept_features.Finer(tf.constant(position - start, tf.float32), edge)
    found = swept_features.advance(
        GRID, state, tf.constant(position, tf.float32), tf.constant(DT), tensors, finer
    )
    np.testing.assert_allclose(found.profile, truth.profile, atol=1e-6)
    np.testing.assert_array_equal(found.last > 0, truth.last > 0)


def test_cones_are_those_of_numpy():
    values = np.random.default_rng(1).uniform(size=(2, 37)) ** 4
    found = tool_path.cone(tf.constant(values), 0.05, tensors)
    apart = np.abs(np.arange(37)[:, None] - np.arange(37))
    expected = (values[:, None] - 0.05 * apart).max(axis=-1)
    np.testing.assert_allclose(found, expected, atol=1e-15)
    np.testing.assert_allclose(tool_path.cone(values, 0.05), expected, atol=1e-15)
    with pytest.raises(ValueError, match='axis is 0'):
        tensors.maximum.accumulate(tf.constant(values), axis=0)


def test_what_lies_in_a_blade_axes_and_bounds_are_those_of_numpy():
    rng = np.random.default_rng(2)
    points = rng.uniform(-0.2, 0.2, size=(2000, 3))
    pose, width = np.array([0.02, -0.1, 0.3]), 0.25
    found = soil_physics.inside(
        tf.constant(points), tf.constant(pose), Blade(), tf.constant(width, tf.float64), tensors
    )
    expected = soil_physics.inside(points, pose, Blade(), width)
    assert (expected[0] > 0).sum() > 20
    for one, other in zip(found, expected):
        np.testing.assert_allclose(one, other, atol=1e-15)
    turns = rng.normal(size=(50, 7))
    turns[:, 3:] /= np.linalg.norm(turns[:, 3:], axis=1, keepdims=True)
    for axes in (Axes(0, -1, 1, 0.4), Axes(2, 1, 1, 0.1), Axes(0, 1, 2, 0.0)):
        np.testing.assert_allclose(
            axes.poses(tf.constant(turns), tensors), axes.poses(turns), atol=1e-14
        )
        back = axes.local(axes.world(tf.constant(points), tensors), tensors)
        np.testing.assert_array_equal(back, points)
        for one, other in zip(axes.world_loads(tf.constant(points), tensors),
                              axes.world_loads(points)):  # fmt: skip
            np.testing.assert_array_equal(one, other)
    values, weights = rng.normal(size=(5, 7, 2)), [1.0, 2.0, 0.3]
    bounds = []
    for xp, given in ((np, values), (tensors, tf.constant(values))):
        signs = (f(given, xp) for f in (quality.spread, quality.size))
        bounds.append(np.asarray(quality.bound(*signs, weights, xp)))
    np.testing.assert_allclose(*bounds, rtol=1e-12)


def test_poses_turn_the_upward_axis_as_a_rotation_matrix_does():
    """`Axes.poses` against the definition, for any rotation."""
    from learning_to_simulate.live import poses

    rng = np.random.default_rng(3)
    for axes in (Axes(0, -1, 1, 0.4), Axes(1, 1, 2, 0.1), Axes(2, -1, 0, 0.0)):
        turn = rng.normal(size=4)
        turn /= np.linalg.norm(turn)
        top = poses.rotation_matrix(turn)[:, axes.up]
        lean = axes.poses(np.concatenate([np.zeros(3), turn]))[2]
        assert lean == pytest.approx(np.arctan2(-axes.sign * top[axes.axis], top[axes.up]))
