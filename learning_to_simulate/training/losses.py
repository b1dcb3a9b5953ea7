"""Training losses."""

import tensorflow as tf


def one_step_loss(target, predicted_target, force, predicted_force, moving, force_weight=1.0):
    """Loss of Usmani & Skonieczny 2023, eq. 13: error of the moving nodes plus error of the force.

    Args:
      target, predicted_target: [B, V, D], normalised.
      force, predicted_force: [B, D], normalised, or None.
      moving: [V, D], 1 for components that the network decides, 0 for given ones.
      force_weight: [B] or 1, of each graph's squared force error.

    Returns:
      dict of scalars: `loss`, `loss_mse` (sum of squares per moving node) and `loss_force_mse`.
    """
    dim = target.shape[-1]
    n_moving = tf.reduce_sum(moving) / dim
    motion = tf.reduce_sum((predicted_target - target) ** 2 * moving, axis=[1, 2]) / n_moving
    return _total(tf.reduce_mean(motion), _force_error(force, predicted_force, force_weight))


def unrolled_loss(
    offsets, predicted_offsets, forces, predicted_forces, moving, scale, force_weight=1.0
):
    """Loss over N rolled-out frames; frame k weighs 1 / k, because its error is the sum of k
    steps'.

    Args:
      offsets, predicted_offsets: [B, N, V, D], m.
      forces, predicted_forces: [B, N, D], normalised, or None.
      moving: [V, D] as in `one_step_loss`.
      force_weight: [B] or 1, as in `one_step_loss`.
      scale: [V, D], m; errors are counted in units of it (each node's own velocity scale).

    Returns:
      dict of scalars as in `one_step_loss`.
    """
    n_step, dim = offsets.shape[1], offsets.shape[-1]
    n_moving = tf.reduce_sum(moving) / dim
    error = ((predicted_offsets - offsets) / scale) ** 2 * moving
    weight = 1.0 / tf.range(1, n_step + 1, dtype=error.dtype)
    motion = tf.reduce_sum(error, axis=[2, 3]) * weight / n_moving
    return _total(tf.reduce_mean(motion), _force_error(forces, predicted_forces, force_weight))


def _force_error(force, predicted_force, weight):
    if force is None:
        return None
    error = tf.reduce_sum((predicted_force - force) ** 2, axis=-1)
    return tf.reduce_mean(tf.reduce_mean(tf.reshape(error, [error.shape[0], -1]), axis=1) * weight)


def _total(motion, force):
    if force is None:
        return {'loss': motion, 'loss_mse': motion}
    return {'loss': motion + force, 'loss_mse': motion, 'loss_force_mse': force}
