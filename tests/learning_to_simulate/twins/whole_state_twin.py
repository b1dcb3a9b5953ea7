"""The networks without a graph once more in plain numpy and float64, from their papers' equations.

Body of a step (statistics, rates, integration) is that of `numpy_twin`, which is as independent.
"""

import numpy as np
from scipy.special import expit
from scipy.stats import norm

from tests.learning_to_simulate.twins.numpy_twin import H, Twin, _norm


def _gelu(x):
    return x * norm.cdf(x)


class WholeStateTwin(Twin):
    """One step of a `Model` with an MLP or a mixer; see `Twin`."""

    def _linear(self, name, x):
        return x @ self._weight(f'{name}/w') + self._weight(f'{name}/b')

    def _weight(self, name):
        (value,) = [v for k, v in self.weights.items() if k.endswith('/' + name)]
        return value

    def _layer_norm(self, prefix, x):
        return _norm(x, self._weight(f'{prefix}scale'), self._weight(f'{prefix}offset'))

    def step(self, history, next_body, context):
        """As `Twin.step`."""
        s, c, n = self.s, self.config, self.n_rigid
        velocity = np.diff(history, axis=0)
        driven = self.scene.rigid_motion == 'driven'
        known = self.scene.rigid_motion in ('driven', 'prescribed')
        up = self.scene.up_axis
        coming = next_body - history[-1, :n]
        if driven:
            coming[:, up] -= coming[:, up].mean()
        rate = 1.0
        if self.rated:
            rate = max(np.sqrt((coming**2).sum(1).mean()) / s.body_speed[0], 0.05)
        k = [self._class(i) for i in range(history.shape[1])]
        v = velocity[-c.velocity_inputs :] / rate
        frames = ((v - s.velocity_mean[k]) / s.velocity_std[k]).reshape(len(v), -1)
        state = [((history[-1] - s.origin[k]) / s.position_std[k]).ravel()]
        if c.velocity_inputs > 1:
            a = (np.diff(v, axis=0) - s.acceleration_mean[k]) / s.acceleration_std[k]
            state.append(np.moveaxis(a, 0, 1).ravel())
        if self.rated:
            state.append([np.log(rate), rate])
        if known:
            state.append(((coming / rate - s.velocity_mean[0]) / s.velocity_std[0]).ravel())
        if driven:
            height = np.zeros(H)
            height[0] = (history[-1, :n, up] - s.origin[0, up]).mean() / s.height_std[0]
            height[1:] = velocity[:, :n, up].mean(1) / s.height_velocity_std[0]
            state.append(height)
        if context is not None:
            state.append((context - s.context_mean) / s.context_std)
            state.append((np.log(context) - s.log_context_mean) / s.log_context_std)
        network = self._mlp_output if c.model == 'mlp' else self._mixer_output
        rows = network(frames, np.concatenate(state)).reshape(-1, 3)
        n_body = {'prescribed': 0, 'driven': 1}.get(str(self.scene.rigid_motion), n)
        body = {0: np.zeros((n, 3)), 1: np.tile(rows[:1], (n, 1))}.get(n_body, rows[:n_body])
        out = np.concatenate([body, rows[n_body : n_body + self.r]])
        first, n_force = n_body + self.r, s.force_mean.size // 3  # of each body
        load = rows[first : first + n_force].ravel() * s.force_std + s.force_mean
        if c.predict_torque:
            load = np.append(load, rows[first + 1] * s.torque_std + s.torque_mean)
        load = load * self._share(history[-1], next_body)
        return self._integrate(history, velocity, out, next_body, rate, driven), load

    def _mlp_output(self, frames, state):
        x = np.concatenate([frames.ravel(), state])
        for i in range(self.config.hidden_layers):
            x = np.maximum(self._linear(f'hidden/linear_{i}', x), 0)
        return self._linear('output', self._layer_norm('state_mlp/layer_norm/', x))

    def _mixer_output(self, frames, state):
        x = self._linear('embed_history', frames)
        x = np.vstack([x, self._linear('embed_state', state)])
        for m in range(self.config.message_passing_steps):
            b = f'block_{m}/'
            x = x + self._gate(
                f'{b}excitation_space/',
                self._mix(f'{b}space', self._layer_norm(f'{b}norm_space/', x)),
            )
            mixed = self._mix(f'{b}time', self._layer_norm(f'{b}norm_time/', x).T).T
            x = x + self._gate(f'{b}excitation_time/', mixed)
        return self._linear('output', self._layer_norm('motion_mixer/layer_norm/', x).ravel())

    def _mix(self, name, x):
        return self._linear(f'{name}/linear_1', _gelu(self._linear(f'{name}/linear_0', x)))

    def _gate(self, prefix, x):
        squeezed = np.maximum(self._linear(f'{prefix}squeeze', x.mean(0)), 0)
        gated = x * expit(self._linear(f'{prefix}excite', squeezed))
        if self.config.model == 'mixer_scse':
            gated = gated + x * expit(self._linear(f'{prefix}frame', x))
        return gated
