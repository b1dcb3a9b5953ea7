"""The swept area of a bounded bed in closed form, and what is refused. Its steps are those of
`soil_field.sweep`, which `soil_field/test_sweep` holds against a drawn circle."""

import numpy as np
import pytest

from learning_to_simulate import swept

GRID = swept.SweptGrid(radius=0.014, spacing=0.004, behind=0.3, ahead=0.5)
DT = 1 / 60
SURFACE = 0.25


def test_a_straight_cut_has_the_area_of_its_swath():
    """Length times depth and two halves of a circle's segment."""
    depth, length, grid = 0.01, 0.2, swept.SweptGrid(0.014, spacing=0.0005, behind=0.1, ahead=0.4)
    y = SURFACE - depth + grid.radius
    path = np.array([[[0.0, y], [length, y]]])
    state = swept.advance(grid, swept.start(grid, path[:, 0], SURFACE), path[:, 1], DT)
    angle = np.arccos(1 - depth / grid.radius)
    segment = grid.radius**2 * (angle - np.sin(angle) * np.cos(angle))
    assert swept.swept_area(grid, state)[0] == pytest.approx(depth * length + segment, rel=2e-3)
    assert swept.profile_at(grid, state, np.array([[length / 2]]))[0, 0] == pytest.approx(
        SURFACE - depth
    )


@pytest.mark.parametrize(
    'call, message',
    [
        (lambda _: swept.start(GRID, [[0.0, np.nan]], 0.2), r'position holds nan at \(0, 1\)'),
        (lambda _: swept.start(GRID, [0.0, 0.1], 0.2), 'position has shape'),
        (lambda _: swept.start(GRID, [[0.0, 0.1]], np.zeros((1, 3))), 'surface has shape'),
        (lambda _: swept.start(GRID, [[0.0, 0.1]], np.inf), 'surface holds inf'),
        (lambda s: swept.advance(GRID, s, [[1.0, 0.2]], DT), 'do not hold it'),
        (lambda s: swept.advance(GRID, s, [[np.nan, 0.2]], DT), 'position holds nan'),
        (lambda s: swept.advance(GRID, s, [[0.0, 0.2]], 0.0), 'time does not go back'),
        (lambda s: swept.advance(GRID, s, [[0.0, 0.2]], -0.1), 'time does not go back'),
        (lambda _: swept.SweptGrid(0.0), 'radius must be positive'),
        (lambda _: swept.SweptGrid(0.001), 'falls between bins'),
    ],
)
def test_bad_bins_starts_and_steps_are_refused(call, message):
    state = swept.start(GRID, [[0.0, 0.2]], SURFACE)
    with pytest.raises(ValueError, match=message):
        call(state)
