"""Random-walk noise on the input velocities (Sanchez-Gonzalez et al. 2020, section 4.2)."""

import tensorflow as tf


def random_walk_velocity_noise(shape, last_step_std, seed):
    """Noise for the velocity history of a window, a random walk over the input frames.

    The walk's last step has the given standard deviation; the noise of the positions is the running
    sum of the noise of the velocities (`position_noise`), so the history stays consistent.

    Args:
      shape: [B, V, H - 1, D] of the velocity history.
      last_step_std: [V, D] (or broadcastable to [B, V, D]), m/frame; 0 leaves a node as it is.
      seed: int32 [2], stateless: the same seed gives the same noise.

    Returns:
      float32 noise of `shape`.
    """
    # The noise of frame k is the sum of k steps, of std sigma sqrt(k / n): sigma in the last one.
    n_velocities = shape[2]
    steps = tf.random.stateless_normal(shape, seed)
    return tf.cumsum(steps, axis=2) * (last_step_std / n_velocities**0.5)[..., tf.newaxis, :]


def position_noise(velocity_noise):
    """Noise of the last input position, [B, V, D], that goes with `velocity_noise` [B, V, H - 1,
    D]."""
    return tf.reduce_sum(velocity_noise, axis=2)
