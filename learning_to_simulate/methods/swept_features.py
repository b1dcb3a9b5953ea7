"""What a tool has swept so far: functions of its known motion alone, updated frame by frame.

The tool is reduced to a circle that moves in the plane of travel: its lowest edge (a blade's round
edge) or its rim (a wheel). Bins along the way of travel remember how deep the circle has been and
how far the tool has travelled since it was last there. One frame costs the same however long the
path is, and two calls in a row equal one call over the joined path.

Coordinates: u (m) along the way of travel, y (m) upwards. Bins are counted from the first position
of the tool, so shifting path and bed together changes nothing but the coordinates.

`xp` is numpy, or `tensors` in a TensorFlow graph: shapes are static there, and nothing is refused.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

# Less than any length, m, and a number in float32.
TINY = 1e-37


@dataclasses.dataclass(frozen=True)
class SweptGrid:
    """Bins along the way of travel, and the circle that sweeps them.

    Attributes:
      radius: of the tool's underside, m; a blade's edge has half its thickness.
      spacing: of the bins, m.
      behind, ahead: how far the bins reach behind and ahead of the tool's first position, m.
      forget: distance since the last passage is cut here, m; soil that was never passed has it.

    Raises:
      ValueError: a length that is not positive, or a circle narrower than two bins: it could pass
        between their centres.
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
      foremost: [B] largest u of the centre while the circle was below the surface, m; the first
        position until then.
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
        """u [B] of the centre, m."""
        return self.position[:, 0]


class Finer(NamedTuple):
    """What the differences of float32 positions do not tell of a motion, from one who knows.

    Attributes:
      step: [B, 2] position after it minus before it, m.
      edge: two of [B, n], how far the bins lie within the circle before and after it, along the
        way: its radius minus their distance from the centre, m.
    """

    step: np.ndarray
    edge: tuple[np.ndarray, np.ndarray]


def start(grid: SweptGrid, position, surface, xp=np) -> SweptBed:
    """The state before any motion: the circle has been where it is now.

    Args:
      grid: the bins.
      position: [B, 2] first u and y of the centre, m.
      surface: height of the bed, m: a number, [B] or, where the bed is not flat, [B, n] at
        `position[:, :1] + grid.offsets`. In a graph [B, n].
      xp: numpy or `tensors`.

    Raises:
      ValueError: shapes that do not fit, or values that are not finite.
    """
    if xp is np:
        position = _checked(position, (None, 2), 'position')
        surface = _checked_surface(surface, len(position), len(grid.offsets))
    zero = xp.zeros_like(position[:, 0])
    state = SweptBed(
        origin=position[:, 0],
        surface=surface,
        profile=surface,
        last=xp.full_like(surface, -grid.forget),
        position=position,
        velocity=xp.zeros_like(position),
        travelled=zero,
        foremost=position[:, 0],
    )
    return _cut(grid, state, position, None, xp, None)


def _checked_surface(surface, n_tool, n_bin):
    """float64 [B, n] of a bed in one of its forms."""
    surface = np.asarray(surface, np.float64)
    if surface.shape not in ((), (n_tool,), (n_tool, n_bin)):
        raise ValueError(
            f'surface has shape {surface.shape}, a number, [{n_tool}] or [{n_tool}, {n_bin}] was '
            f'expected'
        )
    if not np.isfinite(surface).all():
        raise ValueError('surface holds NaN or infinite heights')
    if surface.ndim == 1:
        surface = surface[:, None]
    return np.broadcast_to(surface, (n_tool, n_bin)).copy()


def advance(grid: SweptGrid, state: SweptBed, position, dt, xp=np, finer=None) -> SweptBed:
    """Moves the tools in a straight line to their next positions.

    Args:
      grid: the bins of `start`.
      state: before the frame; it is not changed.
      position: [B, 2] next u and y of the centre, m.
      dt: duration of the frame, s.
      xp: numpy or `tensors`.
      finer: `Finer`, where positions are float32.

    Raises:
      ValueError: a position that is not finite, or whose underside reaches beyond the bins.
    """
    if xp is np:
        position = _checked(position, state.position.shape, 'position')
        _refuse_outside(grid, state, position)
    return _cut(grid, state, position, dt, xp, finer)


def leaves_bins(grid: SweptGrid, state: SweptBed, position):
    """Bool [B]: tools whose underside reaches beyond the bins at a position [B, 2]."""
    low, high = grid.offsets[[0, -1]]
    offset = position[:, 0] - state.origin
    return (offset - grid.radius < low) | (offset + grid.radius > high)


def _refuse_outside(grid, state, position):
    outside = leaves_bins(grid, state, position)
    if outside.any():
        tool = int(np.argmax(outside))
        low, high = grid.offsets[[0, -1]]
        offset = position[:, 0] - state.origin
        raise ValueError(
            f'tool {tool} is {offset[tool]:.3g} m from its first position; with its radius of '
            f'{grid.radius:.3g} m the bins from {low:.3g} to {high:.3g} m do not hold it'
        )


def _cut(grid, state, position, dt, xp, finer):
    """The state after the circle's centre has gone straight to `position`."""
    step, edge = (position - state.position, None) if finer is None else finer
    length = xp.hypot(step[:, 0], step[:, 1])
    travelled = state.travelled + length
    bins = state.origin[:, None] + grid.offsets
    height = underside(bins, state.position, position, grid.radius, xp, edge)
    passed = height < state.surface
    foremost = xp.where(
        xp.any(passed, axis=1), xp.maximum(state.foremost, position[:, 0]), state.foremost
    )
    return state._replace(
        profile=xp.minimum(state.profile, height),
        last=xp.where(passed, travelled[:, None], state.last),
        position=position,
        velocity=state.velocity if dt is None else step / dt,
        travelled=travelled,
        foremost=foremost,
    )


def underside(u, before, after, radius, xp=np, edge=None):
    """Lowest height [B, n] at places u [B, n] of a circle that moves straight from one centre to
    another [B, 2]; infinite where it has not been. All in m; `edge` as of `Finer`.

    It is the lower envelope of both end circles and, between their tangent points, of the tangent.
    """
    height = xp.full_like(u, np.inf)
    # The edge of the circle is upright: a bin there falls by half a circle, or not at all.
    edge = tuple(within(u, x[:, :1], radius, xp) for x in (before, after)) if edge is None else edge
    for centre, depth in zip((before, after), edge, strict=True):
        square = depth * (2 * radius - depth)
        inside = square >= 0
        height = xp.where(
            inside, xp.minimum(height, centre[:, 1:] - xp.sqrt(xp.maximum(square, 0.0))), height
        )
    step = after - before
    length = xp.hypot(step[:, :1], step[:, 1:])
    # Unit normal of the way, downwards: the tangent is the way moved by radius along it.
    one = xp.ones_like(length)
    sign = xp.where(step[:, :1] < 0, -one, one)
    normal = sign * xp.stack([step[:, 1], -step[:, 0]], axis=1) / xp.maximum(length, TINY)
    left = before + radius * normal
    along = (u - left[:, :1]) * xp.sign(step[:, :1])
    width = xp.abs(step[:, :1])
    share = along / xp.maximum(width, TINY)
    tangent = left[:, 1:] + xp.clip(share, 0.0, 1.0) * step[:, 1:]
    between = (along >= 0) & (along <= width) & (width > 0)
    return xp.where(between, xp.minimum(height, tangent), height)


def within(u, centre, radius, xp=np):
    """How far places u lie within a circle along the way, see `Finer.edge`, m."""
    return radius - xp.abs(u - centre)


def profile_at(grid: SweptGrid, state: SweptBed, u) -> np.ndarray:
    """Deepest cut so far at places u [B, ...] (m), linear between bins; height in m."""
    return _interpolated(grid, state.origin, state.profile, u)


def surface_at(grid: SweptGrid, state: SweptBed, u) -> np.ndarray:
    """Height (m) of the untouched bed at places u [B, ...] (m), linear between bins."""
    return _interpolated(grid, state.origin, state.surface, u)


def since_at(grid: SweptGrid, state: SweptBed, u) -> np.ndarray:
    """Distance (m) that the tool has travelled since it last was at u [B, ...], in the next bin;
    at most `grid.forget`."""
    since = np.minimum(state.travelled[:, None] - state.last, grid.forget)
    index = np.rint(_bin(grid, state.origin, u)).astype(np.int64)
    return _gathered(since, index)


def swept_area(grid: SweptGrid, state: SweptBed, xp=np):
    """[B] area (m2) between the untouched surface and the deepest cut."""
    return grid.spacing * xp.sum(state.surface - state.profile, axis=1)


def _bin(grid, origin, u):
    """Where u [B, ...] lies among the bins, in bins; beyond the last ones, the last ones."""
    u = np.asarray(u, np.float64)
    position = (u - origin.reshape(-1, *[1] * (u.ndim - 1)) - grid.offsets[0]) / grid.spacing
    return np.clip(position, 0.0, len(grid.offsets) - 1.0)


def _gathered(values, index):
    """values [B, n] at index [B, ...]."""
    flat = index.reshape(len(values), -1)
    return np.take_along_axis(values, flat, axis=1).reshape(index.shape)


def _interpolated(grid, origin, values, u):
    place = _bin(grid, origin, u)
    low = np.minimum(place.astype(np.int64), len(grid.offsets) - 2)
    share = place - low
    return (1.0 - share) * _gathered(values, low) + share * _gathered(values, low + 1)


def _checked(values, shape, name):
    values = np.asarray(values, np.float64)
    if values.ndim != len(shape) or any(
        want not in (None, have) for want, have in zip(shape, values.shape, strict=True)
    ):
        raise ValueError(f'{name} has shape {values.shape}, {list(shape)} was expected')
    if not np.isfinite(values).all():
        tool = int(np.argwhere(~np.isfinite(values))[0][0])
        raise ValueError(f'{name} of tool {tool} is not finite: {values[tool]}')
    return values
