"""Random-walk noise on the input velocities (Sanchez-Gonzalez et al. 2020, section 4.2)."""

import tensorflow as tf


def random_walk_velocity_noise(shape, last_step_std, seed):
    """Noise float32 [B, V, H - 1, D] for the velocity history of a window, a random walk over the
    frames.

    The walk's last step has a standard deviation [V, D] (m/frame; 0 leaves a node as it is); the
    noise of the positions is the running sum of that of the velocities, so the history stays
    consistent. The same seed, int32 [2], gives the same noise.
    """
    # The noise of frame k is the sum of k steps, of std sigma sqrt(k / n): sigma in the last one.
    n_velocities = shape[2]
    steps = tf.random.stateless_normal(shape, seed)
    return tf.cumsum(steps, axis=2) * (last_step_std / n_velocities**0.5)[..., tf.newaxis, :]
