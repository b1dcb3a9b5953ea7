"""Training losses."""

import tensorflow as tf

from learning_to_simulate import loads


def one_step_loss(target, predicted_target, load, predicted_load, moving, load_weights=(1.0,)):
    """Loss of Usmani & Skonieczny 2023, eq. 13: error of the moving nodes plus error of the force,
    and of the torque where it is predicted.

    Args:
      target, predicted_target: [B, V, D], normalised.
      load, predicted_load: [B, F], normalised, or None; equal parts for the names of `loads`.
      moving: [V, D], 1 for components that the network decides, 0 for given ones.
      load_weights: for each of the parts, [B] or 1, of each graph's squared error.

    Returns:
      dict of scalars: `loss`, `loss_mse` (sum of squares per moving node), `loss_force_mse` and
      `loss_torque_mse`, as far as there are weights.
    """
    dim = target.shape[-1]
    n_moving = tf.reduce_sum(moving) / dim
    motion = tf.reduce_sum((predicted_target - target) ** 2 * moving, axis=[1, 2]) / n_moving
    return _total(tf.reduce_mean(motion), _load_errors(load, predicted_load, load_weights))


def unrolled_loss(
    offsets, predicted_offsets, load, predicted_load, moving, scale, load_weights=(1.0,)
):
    """Loss over N rolled-out frames; frame k weighs 1 / k, because its error is the sum of k
    steps'.

    Args:
      offsets, predicted_offsets: [B, N, V, D], m.
      load, predicted_load: [B, N, F], normalised, or None.
      moving: [V, D] as in `one_step_loss`.
      load_weights: as in `one_step_loss`.
      scale: [V, D], m; errors are counted in units of it (each node's own velocity scale).

    Returns:
      dict of scalars as in `one_step_loss`.
    """
    n_step, dim = offsets.shape[1], offsets.shape[-1]
    n_moving = tf.reduce_sum(moving) / dim
    error = ((predicted_offsets - offsets) / scale) ** 2 * moving
    weight = 1.0 / tf.range(1, n_step + 1, dtype=error.dtype)
    motion = tf.reduce_sum(error, axis=[2, 3]) * weight / n_moving
    return _total(tf.reduce_mean(motion), _load_errors(load, predicted_load, load_weights))


def _load_errors(load, predicted_load, weights):
    """Name of each load -> its error."""
    if load is None:
        return {}
    parts = (tf.split(x, len(weights), axis=-1) for x in (load, predicted_load))
    return {
        name: _load_error(*one) for name, *one in zip(loads.NAMES, *parts, weights, strict=False)
    }


def _load_error(load, predicted_load, weight):
    error = tf.reduce_sum((predicted_load - load) ** 2, axis=-1)
    return tf.reduce_mean(tf.reduce_mean(tf.reshape(error, [error.shape[0], -1]), axis=1) * weight)


def _total(motion, of_loads):
    parts = {f'loss_{name}_mse': error for name, error in of_loads.items()}
    return {'loss': sum(of_loads.values(), motion), 'loss_mse': motion, **parts}
