"""Networks of several members that are evaluated together."""

import numpy as np
import tensorflow as tf


class Members(tf.Module):
    """M multilayer perceptrons of one shape, evaluated together; `sizes` are of all layers, inputs
    and outputs included."""

    def __init__(self, members: int, sizes, seed: int, name: str):
        super().__init__(name=name)
        rng = np.random.Generator(np.random.Philox(key=seed))
        self.layers = []
        for i, (n_in, n_out) in enumerate(zip(sizes[:-1], sizes[1:], strict=True)):
            # The last layer begins near 0: so does the motion of the soil.
            scale = (0.1 if i == len(sizes) - 2 else 1.0) / np.sqrt(n_in)
            weight = scale * rng.standard_normal((members, n_in, n_out))
            self.layers.append(
                (
                    tf.Variable(weight, dtype=tf.float32, name=f'weight_{i}'),
                    tf.Variable(tf.zeros([members, 1, n_out]), name=f'bias_{i}'),
                )
            )

    def __call__(self, inputs, members: int | None = None):
        """Outputs [M, R, O] for inputs [R, I], the same for all; of the first members only."""
        values = inputs[None]
        for i, (weight, bias) in enumerate(self.layers):
            weight, bias = weight[:members], bias[:members]
            if i == 0:  # one product for all members: their weights side by side
                flat = tf.reshape(tf.transpose(weight, [1, 0, 2]), [weight.shape[1], -1])
                side = tf.reshape(inputs @ flat, [-1, weight.shape[0], weight.shape[2]])
                values = tf.transpose(side, [1, 0, 2]) + bias
            else:
                values = tf.matmul(tf.nn.silu(values), weight) + bias
        return values
