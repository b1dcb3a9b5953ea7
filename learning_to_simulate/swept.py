"""How deep a circle on a path has cut: the geometry of one step, shared with `soil_field.sweep`,
and bins that stay where they are, for baselines and networks in the subspace.

A tool is reduced to a circle that moves in the plane of travel. Bins along the way remember how
deep it has been: (1) to (6) of docs/soil_field.md, with all bins in the area (4). A soil field has
a state of its own, in bins that follow the tool (`soil_field.sweep`).

Nothing is integrated over time: two calls in a row equal one call over the joined path.
Coordinates: u (m) along the way, y (m) upwards. Numpy, float64.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

from learning_to_simulate.live.poses import numbers

EDGE_RADIUS = 0.014  # of the solver's blade: half its thickness, m
TINY = 1e-37  # less than any length, m
# A tool that is less deep, m, takes its foremost place along by its share, so that this does not
# jump when it touches the soil.
GRAZE = 1e-4


@dataclasses.dataclass(frozen=True)
class SweptGrid:
    """Bins along the way of travel, and the circle that sweeps them. ValueError for a length that
    is not positive, or a circle narrower than two bins: it could pass between their centres.

    Attributes:
      radius: of the tool's underside, m; a blade's edge has half its thickness.
      spacing: of the bins, m.
      behind, ahead: how far the bins reach behind and ahead of the tool's first position, m.
      forget: distance since the last passage is at most this, m; soil that was never passed has it.
    """

    radius: float
    spacing: float = 0.005
    behind: float = 0.3
    ahead: float = 0.9
    forget: float = 1.0

    def __post_init__(self):
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if not 0 < value < np.inf:
                raise ValueError(f'SweptGrid.{field.name} must be positive, got {value}')
        if self.radius < self.spacing:
            raise ValueError(
                f'a tool of radius {self.radius} m falls between bins of {self.spacing} m: give a '
                f'spacing of at most its radius'
            )

    @property
    def offsets(self) -> np.ndarray:
        """[n] centres of the bins relative to the first position of the tool, m; 0 is one."""
        first = int(np.floor(self.behind / self.spacing))
        return self.spacing * np.arange(-first, int(np.floor(self.ahead / self.spacing)) + 1)


class SweptBed(NamedTuple):
    """State of B tools; a function of all poses so far.

    Attributes:
      origin: [B] u of the first position, m; bin k lies at `origin + grid.offsets[k]`.
      surface: [B, n] height of the bed before the tool came, m.
      profile: [B, n] the lowest of the surface and all heights of the tool's underside so far, m.
      last: [B, n] distance travelled at the last passage below the surface, m; `-grid.forget`
        where there was none.
      position: [B, 2] u and y of the circle's centre, m.
      velocity: [B, 2] of the last frame, m/s.
      travelled: [B] length of the path, m.
      foremost: [B] (27), largest u of the centre while the circle was below the surface, m; the
        first position until then.
    """

    origin: np.ndarray
    surface: np.ndarray
    profile: np.ndarray
    last: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    travelled: np.ndarray
    foremost: np.ndarray

    @property
    def tip(self) -> np.ndarray:
        return self.position[:, 0]


def start(grid: SweptGrid, position, surface) -> SweptBed:
    """The state before any motion: the circle has been where it is now, its centre at u and y of
    `position` [B, 2], m. `surface` is the height of the bed, m: a number, or [B, n] at `position[:,
    :1] + grid.offsets`. ValueError for shapes that do not fit, or values that are not finite."""
    position = numbers('position', position, (None, 2))
    shape = len(position), len(grid.offsets)
    surface = np.broadcast_to(numbers('surface', surface, (), shape), shape).copy()
    # Nothing was passed yet: all that counts as `forget` behind.
    state = SweptBed(
        origin=position[:, 0],
        surface=surface,
        profile=surface,
        last=np.full_like(surface, -grid.forget),
        position=position,
        velocity=np.zeros_like(position),
        travelled=np.zeros(len(position)),
        foremost=position[:, 0],
    )
    return _cut(grid, state, position, None)


def advance(grid: SweptGrid, state: SweptBed, position, dt) -> SweptBed:
    """The state after the tools have gone straight to their next positions [B, 2], m, within dt s.
    ValueError for a time that does not pass; a position that is not finite, or whose underside
    reaches beyond the bins."""
    if not 0 < dt < np.inf:
        raise ValueError(f'a frame must last longer than 0 s, got {dt}: time does not go back')
    position = numbers('position', position, state.position.shape)
    offset, (low, high) = position[:, 0] - state.origin, grid.offsets[[0, -1]]
    outside = (offset - grid.radius < low) | (offset + grid.radius > high)
    if outside.any():
        tool = int(np.argmax(outside))
        raise ValueError(
            f'tool {tool} is {offset[tool]:.3g} m from its first position; with its radius of '
            f'{grid.radius:.3g} m the bins from {low:.3g} to {high:.3g} m do not hold it'
        )
    return _cut(grid, state, position, dt)


def _cut(grid, state, position, dt):
    """The state after the circle's centre has gone straight to `position`."""
    step = position - state.position
    height = underside(state.origin[:, None] + grid.offsets, state.position, position, grid.radius)
    velocity = state.velocity if dt is None else step / dt
    found = after_step(state, height, position[:, 0], np.hypot(step[:, 0], step[:, 1]))
    return state._replace(position=position, velocity=velocity, **found)


def after_step(state, height, tip, length) -> dict[str, np.ndarray]:
    """Fields of a state, of `SweptBed` and of `soil_field.sweep.Sweep`, that a step changes: (2),
    (5), (27). Of the state before the step; height [B, n] of `underside`, m; tip and length [B], u
    at which the step ends and its length, m; of a `Sweep`, whose strips go one way, B is 1."""
    below, travelled = state.surface - height, state.travelled + length
    share = np.clip(below.max(axis=1) / GRAZE, 0.0, 1.0)
    return {
        'profile': np.minimum(state.profile, height),
        'last': np.where(below > 0, travelled[..., None], state.last),
        'travelled': travelled,
        'foremost': np.maximum(state.foremost, tip - (1.0 - share) * (tip - state.foremost)),
    }


def area_before(state, after, area, known) -> np.ndarray:
    """(6): [B, n] of `known`, and the area [B] before the step where `after` is cut and `state` is
    not, so that what is cut together has one value."""
    is_new = (after.profile < state.surface) & ~(state.profile < state.surface)
    return np.where(is_new, area[:, None], known)


def underside(u, before, after, radius) -> np.ndarray:
    """Lowest height [B, n] at places u [B, n] of a circle of a radius (a number or [B, 1]) that
    moves straight from one centre to another [B, 2]; infinite where it has not been. All in m.

    It is (1): the lower envelope of both end circles and, between their tangent points, of the
    common tangent.
    """
    height = np.full_like(u, np.inf)
    for centre in (before, after):
        depth = radius - np.abs(u - centre[:, :1])
        square = depth * (2 * radius - depth)  # rho^2 - (u - u_c)^2
        circle = centre[:, 1:] - np.sqrt(np.maximum(square, 0.0))
        height = np.where(square >= 0, np.minimum(height, circle), height)
    step = after - before
    length = np.hypot(step[:, :1], step[:, 1:])
    # Unit normal of the way, downwards: the tangent is the way moved by radius along it.
    sign = np.where(step[:, :1] < 0, -1.0, 1.0)
    normal = sign * np.stack([step[:, 1], -step[:, 0]], axis=1) / np.maximum(length, TINY)
    # Its left end, and how far each place lies along it, in [0, 1].
    left = before + radius * normal
    along = (u - left[:, :1]) * np.sign(step[:, :1])
    width = np.abs(step[:, :1])
    share = along / np.maximum(width, TINY)
    tangent = left[:, 1:] + np.clip(share, 0.0, 1.0) * step[:, 1:]
    between = (along >= 0) & (along <= width) & (width > 0)
    return np.where(between, np.minimum(height, tangent), height)


def swept_area(grid: SweptGrid, state: SweptBed) -> np.ndarray:
    """[B] area (m2) between the untouched surface and the deepest cut: (4)."""
    return grid.spacing * np.sum(state.surface - state.profile, axis=1)


def profile_at(grid: SweptGrid, state: SweptBed, u) -> np.ndarray:
    """Deepest cut so far at places u [B, P] (m), linear between bins; height in m."""
    return channels_at(grid, state.profile[..., None], u - state.origin[:, None])[..., 0]


def channels_at(grid: SweptGrid, values, offset) -> np.ndarray:
    """Values [B, n, C] of bins at offsets [B, P] from the first position (m), linear between bins;
    beyond the last ones, the last ones. [B, P, C]."""
    last = values.shape[1] - 1
    place = np.clip((offset - grid.offsets[0]) / grid.spacing, 0.0, last)
    low = np.minimum(place.astype(np.int64), last - 1)
    share, row = (place - low)[..., None], np.arange(len(values))[:, None]
    return (1.0 - share) * values[row, low] + share * values[row, low + 1]
