"""Swept features against a circle that is drawn in fine steps, closed forms and invariants."""

import numpy as np
import pytest

from learning_to_simulate import swept

GRID = swept.SweptGrid(radius=0.014, spacing=0.004, behind=0.3, ahead=0.5)
DT = 1 / 60
SURFACE = 0.25


def wandering_path(seed=0, n_frame=60):
    """[1, T, 2] a path that goes down, forward, back and up again."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 1.0, n_frame)
    u = 0.3 * np.sin(2.2 * np.pi * t) * t + 0.02 * rng.standard_normal()
    y = SURFACE - 0.02 - 0.05 * np.sin(3 * np.pi * t)
    return np.stack([u, y], axis=-1)[None]


def run(path, grid=GRID, surface=SURFACE, state=None):
    """The state after a path [B, T, 2]; goes on from `state` where there is one."""
    frames = range(path.shape[1])
    if state is None:
        state, frames = swept.start(grid, path[:, 0], surface), frames[1:]
    for t in frames:
        state = swept.advance(grid, state, path[:, t], DT)
    return state


def drawn_profile(path, grid=GRID, n=400):
    """The twin: the circle is put down at n places of every frame."""
    bins = path[0, 0, 0] + grid.offsets
    lowest = np.full(bins.shape, SURFACE)
    for before, after in zip(path[0, :-1], path[0, 1:]):
        for share in np.linspace(0.0, 1.0, n):
            centre = before + share * (after - before)
            square = grid.radius**2 - (bins - centre[0]) ** 2
            height = np.where(square > 0, centre[1] - np.sqrt(np.maximum(square, 0)), np.inf)
            lowest = np.minimum(lowest, height)
    return lowest


def test_profile_is_that_of_a_circle_drawn_along_the_path():
    path = wandering_path()
    state = run(path)
    drawn = drawn_profile(path)
    assert drawn.min() < SURFACE - 0.05
    # A bin at the very end of the swath meets the circle where it stands upright: the drawn one
    # may miss it by a step.
    assert np.sort(np.abs(state.profile[0] - drawn))[-4:][0] < 1e-5
    assert (state.profile[0] <= drawn + 1e-12).all()


def test_a_straight_cut_has_the_area_of_its_swath():
    """Length times depth and two halves of a circle's segment."""
    depth, length, grid = 0.01, 0.2, swept.SweptGrid(0.014, spacing=0.0005, behind=0.1, ahead=0.4)
    y = SURFACE - depth + grid.radius
    path = np.array([[[0.0, y], [length, y]]])
    state = run(path, grid)
    angle = np.arccos(1 - depth / grid.radius)
    segment = grid.radius**2 * (angle - np.sin(angle) * np.cos(angle))
    assert swept.swept_area(grid, state)[0] == pytest.approx(depth * length + segment, rel=2e-3)
    assert swept.profile_at(grid, state, np.array([[length / 2]]))[0, 0] == pytest.approx(
        SURFACE - depth
    )


def test_distance_since_a_place_was_passed():
    """Forward through the soil, up, and on in the air: only what lay in the soil was passed."""
    y = SURFACE - 0.01
    path = np.array([[[0.0, y], [0.1, y], [0.1, y + 0.2], [0.3, y + 0.2]]])
    state = run(path)
    since = np.minimum(state.travelled - state.last[0], GRID.forget)
    at = since[np.rint((np.array([0.04, 0.1, 0.25, -0.2]) - GRID.offsets[0]) / 0.004).astype(int)]
    # Distance counts by frames: 0.04 was passed in the first one, 0.1 also while it rose.
    np.testing.assert_allclose(at, [0.4, 0.2, GRID.forget, GRID.forget], atol=1e-9)
    assert state.foremost[0] == pytest.approx(0.1)
    assert state.velocity[0] == pytest.approx([0.2 / DT, 0.0])
    assert state.travelled[0] == pytest.approx(0.1 + 0.2 + 0.2)


@pytest.mark.parametrize(
    'call, message',
    [
        (lambda: swept.start(GRID, [[0.0, np.nan]], 0.2), 'not finite'),
        (lambda: swept.start(GRID, [0.0, 0.1], 0.2), 'shape'),
        (lambda: swept.start(GRID, [[0.0, 0.1]], np.zeros((1, 3))), 'surface has shape'),
        (lambda: swept.start(GRID, [[0.0, 0.1]], np.inf), 'surface is inf'),
    ],
)
def test_bad_input_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize(
    'call, message',
    [
        (lambda s: swept.advance(GRID, s, [[1.0, 0.2]], DT), 'do not hold it'),
        (lambda s: swept.advance(GRID, s, [[np.nan, 0.2]], DT), 'not finite'),
        (lambda s: swept.advance(GRID, s, [[0.0, 0.2]], 0.0), 'time does not go back'),
        (lambda s: swept.advance(GRID, s, [[0.0, 0.2]], -0.1), 'time does not go back'),
        (lambda _: swept.SweptGrid(0.0), 'radius must be positive'),
        (lambda _: swept.SweptGrid(0.001), 'falls between bins'),
    ],
)
def test_bad_steps_and_bins_are_refused(call, message):
    state = swept.start(GRID, [[0.0, 0.2]], SURFACE)
    with pytest.raises(ValueError, match=message):
        call(state)
