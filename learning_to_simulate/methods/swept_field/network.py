"""Both networks of a swept field, all members at once."""

import numpy as np
import tensorflow as tf

OUTPUTS = 3
# Motion across grows over so much distance from the middle plane, where it is odd, m.
ACROSS = 0.05


class Members(tf.Module):
    """M multilayer perceptrons of one shape, evaluated together.

    Args:
      members: M.
      sizes: of all layers, inputs and outputs included.
      seed: of the first weights.
      name: of the variables.
    """

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


class FieldNetwork(tf.Module):
    """Displacement of particles, force and torque on the tool.

    Args:
      config: `SweptFieldConfig`.
      inputs: `inputs.Inputs`.
      sizes: number of inputs of the particles' and of the force's network.
    """

    def __init__(self, config, inputs, sizes: tuple[int, int]):
        super().__init__(name='field')
        self.inputs, self.sizes = inputs, tuple(sizes)
        hidden = [config.latent_size] * config.hidden_layers
        m = config.members
        self.soil = Members(m, [sizes[0], *hidden, OUTPUTS], 2 * config.seed, 'soil')
        hidden = [config.force_latent_size] * 2
        outputs = inputs.outputs
        self.load = Members(m, [sizes[1], *hidden, outputs], 2 * config.seed + 1, 'load')

    def displacement(self, bins, scalars, rest, members: int | None = None):
        """Displacement [M, B, P, 3] (m; along the way, up, across) of particles; see
        `inputs.Inputs.gate`."""
        gate = self.inputs.gate(bins, scalars, rest)
        seen = self.inputs.particles(bins, scalars, rest)
        flat = tf.reshape(seen, [-1, self.sizes[0]])
        moved = self.soil(flat, members)
        shape = tf.concat([[tf.shape(moved)[0]], tf.shape(rest)], axis=0)
        moved = tf.reshape(moved, shape) * gate[None, ..., None]
        # Odd across the middle plane: the network sees the distance from it only.
        across = tf.clip_by_value(rest[..., 2:] / ACROSS, -1.0, 1.0)
        odd = tf.concat([tf.ones_like(rest[..., :2]), across], axis=-1)
        return self.inputs.displacement * moved * odd[None]

    def force(self, bins, scalars, members: int | None = None):
        """Force along the way and up (N), torque in their plane (N m), of a wheel the change of its
        height (m): [M, B, 3 or 4]."""
        share = self.load_share(bins, scalars)
        return self.load_of(self.inputs.force(bins, scalars), share, members)

    def load_share(self, bins, scalars):
        """[B, k] that outputs of the load are multiplied by; see `inputs.Inputs.load_share`."""
        return self.inputs.load_share(bins, scalars)

    def load_of(self, seen, share, members: int | None = None):
        """`force` from its inputs [B, I] and `load_share` [B, k]."""
        return self.inputs.load_of(self.load(seen, members), share)
