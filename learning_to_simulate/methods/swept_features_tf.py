"""`swept_features` as TensorFlow operations, for compiled steps and exports.

The same state (`SweptBed`, of tensors) and the same functions. Shapes are static but for the batch,
so a step compiles once. What numpy refuses (a path that leaves the bins, a position that is not
finite) a graph cannot: the caller checks poses before they enter it.
"""

import numpy as np
import tensorflow as tf

from learning_to_simulate.methods.swept_features import SweptBed, SweptGrid


def start(grid: SweptGrid, position, surface) -> SweptBed:
    """The state before any motion; see `swept_features.start`.

    Args:
      grid: the bins.
      position: [B, 2] tensor, m; its type is that of the state.
      surface: a number, [B] or [B, n], m.
    """
    position = tf.convert_to_tensor(position)
    surface = tf.convert_to_tensor(surface, position.dtype)
    n_bin, n_tool = len(grid.offsets), tf.shape(position)[0]
    if surface.shape.rank == 1:
        surface = surface[:, None]
    surface = tf.broadcast_to(surface, [n_tool, n_bin])
    state = SweptBed(
        origin=position[:, 0],
        surface=surface,
        profile=surface,
        last=tf.fill([n_tool, n_bin], tf.cast(-grid.forget, position.dtype)),
        position=position,
        velocity=tf.zeros_like(position),
        travelled=tf.zeros_like(position[:, 0]),
        foremost=position[:, 0],
    )
    return _cut(grid, state, position)


def advance(grid: SweptGrid, state: SweptBed, position, dt: float) -> SweptBed:
    """Moves the tools to their next positions [B, 2]; see `swept_features.advance`."""
    return _cut(grid, state, tf.convert_to_tensor(position, state.position.dtype), dt)


def _cut(grid, state, position, dt=None):
    step = position - state.position
    travelled = state.travelled + tf.norm(step, axis=1)
    bins = state.origin[:, None] + _constant(grid.offsets, position)
    height = underside(bins, state.position, position, grid.radius)
    passed = height < state.surface
    foremost = tf.where(
        tf.reduce_any(passed, axis=1), tf.maximum(state.foremost, position[:, 0]), state.foremost
    )
    return state._replace(
        profile=tf.minimum(state.profile, height),
        last=tf.where(passed, travelled[:, None], state.last),
        position=position,
        velocity=state.velocity if dt is None else step / _constant(dt, position),
        travelled=travelled,
        foremost=foremost,
    )


def underside(u, before, after, radius: float):
    """Lower envelope [B, n] of a moving circle; see `swept_features.underside`."""
    zero = tf.zeros_like(u)
    tiny = _constant(np.finfo(u.dtype.as_numpy_dtype).tiny, u)
    height = tf.fill(tf.shape(u), _constant(np.inf, u))
    for centre in (before, after):
        square = _constant(radius**2, u) - (u - centre[:, :1]) ** 2
        arc = centre[:, 1:] - tf.sqrt(tf.maximum(square, zero))
        height = tf.where(square >= 0, tf.minimum(height, arc), height)
    step = after - before
    length = tf.norm(step, axis=1, keepdims=True)
    sign = tf.where(step[:, :1] < 0, -tf.ones_like(length), tf.ones_like(length))
    normal = sign * tf.stack([step[:, 1], -step[:, 0]], axis=1) / tf.maximum(length, tiny)
    left = before + _constant(radius, u) * normal
    along = (u - left[:, :1]) * tf.sign(step[:, :1])
    width = tf.abs(step[:, :1])
    share = tf.clip_by_value(along / tf.maximum(width, tiny), 0.0, 1.0)
    tangent = left[:, 1:] + share * step[:, 1:]
    between = (along >= 0) & (along <= width) & (width > 0)
    return tf.where(between, tf.minimum(height, tangent), height)


def profile_at(grid: SweptGrid, state: SweptBed, u):
    """Deepest cut so far at places u [B, ...] (m), linear between bins; height in m."""
    return _interpolated(grid, state.origin, state.profile, u)


def surface_at(grid: SweptGrid, state: SweptBed, u):
    """Height (m) of the untouched bed at places u [B, ...] (m), linear between bins."""
    return _interpolated(grid, state.origin, state.surface, u)


def since_at(grid: SweptGrid, state: SweptBed, u):
    """Distance (m) travelled since the tool last was at u [B, ...]; at most `grid.forget`."""
    since = tf.minimum(state.travelled[:, None] - state.last, _constant(grid.forget, state.last))
    index = tf.cast(tf.round(_bin(grid, state.origin, u)), tf.int32)
    return tf.gather(since, index, batch_dims=1)


def swept_area(grid: SweptGrid, state: SweptBed):
    """[B] area (m2) between the untouched surface and the deepest cut."""
    return _constant(grid.spacing, state.profile) * tf.reduce_sum(
        state.surface - state.profile, axis=1
    )


def _constant(value, like):
    return tf.constant(value, like.dtype)


def _bin(grid, origin, u):
    """Where u lies among the bins, in bins; beyond the last ones, the last ones."""
    u = tf.convert_to_tensor(u, origin.dtype)
    origin = tf.reshape(origin, [-1, *[1] * (u.shape.rank - 1)])
    # The first offset is a whole number of spacings: subtracting it in bins loses no digits.
    first = _constant(round(grid.offsets[0] / grid.spacing), u)
    place = (u - origin) / _constant(grid.spacing, u) - first
    return tf.clip_by_value(place, 0.0, len(grid.offsets) - 1.0)


def _interpolated(grid, origin, values, u):
    place = _bin(grid, origin, u)
    low = tf.minimum(tf.cast(place, tf.int32), len(grid.offsets) - 2)
    share = place - tf.cast(low, place.dtype)
    at = tf.gather(values, low, batch_dims=1)
    return at + share * (tf.gather(values, low + 1, batch_dims=1) - at)
