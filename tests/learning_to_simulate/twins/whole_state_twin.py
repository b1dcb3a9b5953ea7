"""The networks without a graph once more in numpy and float64, from their papers' equations."""

import numpy as np
from scipy.special import expit
from scipy.stats import norm

from tests.learning_to_simulate.twins.numpy_twin import Twin, _norm


class WholeStateTwin(Twin):
    """One step of a `Model` with an MLP or a mixer; see `Twin`."""

    def network(self, position, velocity, coming, context=None):
        """As `Twin.network`."""
        s, n, found = self.s, self.n, self.inputs(position, velocity, coming, context)
        frames = found.pop('velocity').reshape(*position.shape[1:2], -1, 3).swapaxes(0, 1)
        if 'height' in found:
            found['height'] = found['height'][:, :1]
        state = np.concatenate([x.ravel() for x in found.values()])
        output = self.mlp_output if self.config.model == 'mlp' else self._mixer_output
        rows = output(frames.reshape(len(frames), -1), state).reshape(-1, 3)
        n_body = {'prescribed': 0, 'driven': 1}.get(str(self.scene.rigid_motion), n)
        body = {0: np.zeros((n, 3)), 1: np.tile(rows[:1], (n, 1))}.get(n_body, rows[:n_body])
        first = n_body + self.r
        n_load = s.force_mean.size // 3  # force of each body
        target = np.concatenate([body, rows[n_body:first]])
        return target[None], rows[first : first + n_load].reshape(1, -1)

    def _weight(self, name):
        (value,) = [v for k, v in self.weights.items() if k.endswith('/' + name)]
        return value

    def _linear(self, name, x):
        return x @ self._weight(f'{name}/w') + self._weight(f'{name}/b')

    def _layer_norm(self, prefix, x):
        return _norm(x, self._weight(f'{prefix}scale'), self._weight(f'{prefix}offset'))

    def mlp_output(self, frames, state):
        """Output of the MLP for velocities [T, V 3] and the rest of the state [F]."""
        x = np.concatenate([frames.ravel(), state])
        for i in range(self.config.hidden_layers):
            x = np.maximum(self._linear(f'hidden/linear_{i}', x), 0)
        return self._linear('output', self._layer_norm('state_mlp/layer_norm/', x))

    def _mixer_output(self, frames, state):
        x = self._linear('embed_history', frames)
        x = np.vstack([x, self._linear('embed_state', state)])
        for m in range(self.config.message_passing_steps):
            b = f'block_{m}/'
            mixed = self._mix(f'{b}space', self._layer_norm(f'{b}norm_space/', x))
            x = x + self._gate(f'{b}excitation_space/', mixed)
            mixed = self._mix(f'{b}time', self._layer_norm(f'{b}norm_time/', x).T).T
            x = x + self._gate(f'{b}excitation_time/', mixed)
        return self._linear('output', self._layer_norm('motion_mixer/layer_norm/', x).ravel())

    def _mix(self, name, x):
        hidden = self._linear(f'{name}/linear_0', x)
        return self._linear(f'{name}/linear_1', hidden * norm.cdf(hidden))  # GELU

    def _gate(self, prefix, x):
        squeezed = np.maximum(self._linear(f'{prefix}squeeze', x.mean(0)), 0)
        gated = x * expit(self._linear(f'{prefix}excite', squeezed))
        if self.config.model == 'mixer_scse':
            gated = gated + x * expit(self._linear(f'{prefix}frame', x))
        return gated
