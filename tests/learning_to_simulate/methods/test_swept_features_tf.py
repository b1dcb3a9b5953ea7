"""The TensorFlow form against the numpy form, and under compilation."""

import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate.methods import swept_features as twin
from learning_to_simulate.methods import swept_features_tf as swept

GRID = twin.SweptGrid(radius=0.014, spacing=0.004, behind=0.3, ahead=0.5)
DT = 1 / 60


def paths(n_tool=3, n_frame=50):
    """[B, T, 2] smooth paths in and above the soil, forth and back, some frames at rest."""
    rng = np.random.default_rng(0)
    t = np.linspace(0, 1, n_frame)
    waves = rng.normal(size=(n_tool, 2, 3))
    u = 0.08 * np.einsum('bk,kt->bt', waves[:, 0], np.sin(np.outer([1, 2, 4], 2 * t)))
    y = 0.25 + 0.02 * np.einsum('bk,kt->bt', waves[:, 1], np.sin(np.outer([1, 3, 6], 3 * t)))
    path = np.stack([np.clip(u, -0.2, 0.4), y], axis=-1)
    path[:, 20:24] = path[:, 20:21]
    return path + np.array([0.7, 0.0])


def beds(path):
    return 0.25 + 0.01 * np.sin(30 * GRID.offsets) * np.arange(len(path))[:, None]


@pytest.mark.parametrize('dtype, tolerance', [(np.float64, 1e-12), (np.float32, 2e-6)])
def test_states_and_features_are_those_of_numpy(dtype, tolerance):
    path = paths()
    ours = swept.start(GRID, tf.constant(path[:, 0], dtype), beds(path).astype(dtype))
    theirs = twin.start(GRID, path[:, 0], beds(path))
    step = tf.function(lambda state, position: swept.advance(GRID, state, position, DT))
    for t in range(1, path.shape[1]):
        ours = step(ours, tf.constant(path[:, t], dtype))
        theirs = twin.advance(GRID, theirs, path[:, t], DT)
    assert step.experimental_get_tracing_count() == 1
    assert np.isfinite(theirs.profile).all() and (theirs.profile < theirs.surface).any()
    # The bin at the end of a swath meets the circle where it stands upright: float32 may take it
    # for the next one, and then it is half a circle off.
    edge = 0 if dtype == np.float64 else 4
    for name in ('origin', 'surface', 'position', 'travelled', 'foremost'):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), atol=tolerance)
    np.testing.assert_allclose(ours.velocity, theirs.velocity, atol=100 * tolerance)
    for name in ('profile', 'last'):
        apart = np.sort(np.abs(getattr(ours, name) - getattr(theirs, name)).ravel())
        assert apart[-1 - edge] <= 20 * tolerance, name
    np.testing.assert_allclose(
        swept.swept_area(GRID, ours), twin.swept_area(GRID, theirs), atol=1e-5 if edge else 1e-12
    )
    places = path[:, -1, :1, None] + np.linspace(-0.1, 0.1, 6).reshape(1, 2, 3)
    for name in ('profile_at', 'surface_at'):
        np.testing.assert_allclose(
            getattr(swept, name)(GRID, ours, tf.constant(places, dtype)),
            getattr(twin, name)(GRID, theirs, places),
            atol=1e-4 if edge else 1e-12,
        )
    middles = theirs.origin[:, None] + GRID.spacing * np.array([-3, 0, 5, 21])  # not between bins
    np.testing.assert_allclose(
        swept.since_at(GRID, ours, tf.constant(middles, dtype)),
        twin.since_at(GRID, theirs, middles),
        atol=20 * tolerance,
    )


def test_a_flat_bed_is_a_number_or_one_height_for_each_tool():
    position = tf.constant(paths()[:, 0])
    number = swept.start(GRID, position, 0.25)
    each = swept.start(GRID, position, tf.constant([0.25] * 3, tf.float64))
    np.testing.assert_array_equal(number.profile, each.profile)
