"""`StateMLP`: a plain multilayer perceptron on the subspace state.

After Holden et al. 2019 (Subspace Neural Physics, SCA): the scores of all modes, their velocities
and the motion of the body go in, the next displacement of all modes and the force come out.

    python -m learning_to_simulate.train --model=mlp --data_path=... --model_path=...
"""

import sonnet as snt
import tensorflow as tf

from learning_to_simulate.subspace.whole_state import WholeStateSimulator


class StateMLP(snt.Module):
    """`hidden_layers` ReLU layers of `latent_size`, LayerNorm, and a linear output.

    Args:
      config: `TrainConfig`.
      output_size: values of the output.
    """

    def __init__(self, config, output_size, name='state_mlp'):
        super().__init__(name=name)
        self._hidden = snt.nets.MLP(
            [config.latent_size] * config.hidden_layers, activate_final=True, name='hidden'
        )
        self._norm = snt.LayerNorm(axis=-1, create_scale=True, create_offset=True)
        self._output = snt.Linear(output_size, name='output')

    def __call__(self, history, state):
        """Maps velocities [B, T, V D] and the rest of the state [B, F] to [B, output_size]."""
        flat = tf.reshape(history, [history.shape[0], -1])
        hidden = self._hidden(tf.concat([flat, state], axis=-1))
        return self._output(self._norm(hidden))

    def zero_decoder(self):
        """Sets the last layer to zero: every output is 0 until it is trained."""
        for variable in self._output.trainable_variables:
            variable.assign(tf.zeros_like(variable))


def simulator(*arguments):
    """A `WholeStateSimulator` of an MLP; arguments as of `LearnedSimulator`."""
    return WholeStateSimulator(StateMLP, *arguments)
