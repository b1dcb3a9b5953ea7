"""The simulator once more in plain numpy and float64, written from the equations.

It shares no code with the package but the stored statistics and weights; networks without a graph
are from their papers' equations. B is a batch of graphs.
"""

import numpy as np
from scipy.special import expit
from scipy.stats import norm

H = 6


def _norm(x, scale, offset):
    mean, var = x.mean(-1, keepdims=True), x.var(-1, keepdims=True)
    return (x - mean) / np.sqrt(var + 1e-5) * scale + offset


class Twin:
    """One step of a `Model`.

    Args:
      model: the model.
      n_rigid: R.
    """

    def __init__(self, model, n_rigid):
        s = model.simulator
        self.s, self.config, self.scene = s.statistics, s.config, s.scene
        self.n, self.r, self.up = n_rigid, s.scene.n_modes, s.scene.up_axis
        layout = model.layout(n_rigid)
        self.senders, self.receivers = layout.senders, layout.receivers
        self.weights = {
            v.name.split(':')[0]: v.numpy().astype(float) for v in s.trainable_variables
        }
        self.k = np.array([0] * n_rigid + list(range(1, self.r + 1)))  # classes
        self.is_ours, self.driven = self.config.style == 'ours', self.scene.rigid_motion == 'driven'
        self.known = self.driven or self.scene.rigid_motion == 'prescribed'
        # Rows of the embedding; those of further bodies come behind those of the modes.
        counts = [count for _, count in self.scene.bodies]
        body = np.searchsorted(np.cumsum(counts), np.arange(n_rigid), side='right') if counts else 0
        self.rows = self.k.copy()
        self.rows[:n_rigid] += np.where(np.asarray(body) > 0, self.r + body, 0)
        if not self.is_ours:
            self.rows = np.where(self.k == 0, *s.particle_types)

    def given(self, body):
        """Positions or moves [B, R, 3] of a body, less the mean height that is not given."""
        body = body.copy()
        if self.driven:
            body[..., self.up] -= body[..., self.up].mean(-1, keepdims=True)
        return body

    def rate(self, coming):
        """[B, 1, 1] given displacement of the body [B, R, 3] over its mean in training."""
        if not (self.config.rate_scaled and self.known):
            return np.ones((len(coming), 1, 1))
        speed = np.sqrt((self.given(coming) ** 2).sum(-1).mean(-1)) / self.s.body_speed[0]
        return np.maximum(speed, 0.05)[:, None, None]

    def inputs(self, position, velocity, coming, context):
        """Name -> values [B, V, w] of nodes, [B, R, w] of the body, or [B, 1, w] of the scene.

        Args:
          position: [B, V, 3] of the newest frame, noise included.
          velocity: [B, H - 1, V, 3], newest last.
          coming: [B, R, 3] displacement of the body in the coming frame.
          context: [B, C] or None.
        """
        s, k, c, n = self.s, self.k, self.config, self.n
        rate = self.rate(coming)
        v = (velocity[:, H - 1 - c.velocity_inputs :] / rate[:, None]).swapaxes(0, 1)
        found = {'velocity': np.concatenate((v - s.velocity_mean[k]) / s.velocity_std[k], -1)}
        if self.is_ours:
            found['offset'] = (position - s.origin[k]) / s.position_std[k]
            if c.velocity_inputs > 1:
                a = (np.diff(v, axis=0) - s.acceleration_mean[k]) / s.acceleration_std[k]
                found['acceleration'] = np.concatenate(a, -1)
        if c.rate_scaled and self.known:
            found['rate'] = np.concatenate([np.log(rate), rate], -1)
        if self.is_ours and self.known:
            found['coming'] = (self.given(coming) / rate - s.velocity_mean[0]) / s.velocity_std[0]
        if self.is_ours and self.driven:
            height = (position[:, :n, self.up] - s.origin[0, self.up]).mean(-1) / s.height_std[0]
            change = velocity[:, :, :n, self.up].mean(-1) / s.height_velocity_std[0]
            height = np.concatenate([height[:, None], change], -1)[:, None]
            found['height'] = np.repeat(height, n, axis=1)
        if 'learned_simulator/embedding' in self.weights:
            table = self.weights['learned_simulator/embedding'][self.rows]
            found['embedding'] = np.broadcast_to(table, (len(position), *table.shape))
        if context is not None:
            values = [(context - s.context_mean) / s.context_std]
            if self.is_ours and s.log_context_mean is not None:  # no load of 0 in the data
                values.append((np.log(context) - s.log_context_mean) / s.log_context_std)
            found['context'] = np.concatenate(values, -1)[:, None]
        return found

    def network(self, position, velocity, coming, context=None):
        """Normalised target [B, V, 3] and loads [B, F]; arguments of `inputs`."""
        found = self.inputs(position, velocity, coming, context)
        nodes = np.zeros((*position.shape[:2], sum(x.shape[-1] for x in found.values())))
        start = 0
        for x in found.values():
            n = self.n if x.shape[1] == self.n and x.shape[1] != 1 else nodes.shape[1]
            nodes[:, :n, start : start + x.shape[-1]] = x
            start += x.shape[-1]
        pair = self.k[self.receivers], self.k[self.senders]
        d = position[:, self.senders] - position[:, self.receivers]
        d = (d - self.s.displacement_mean[pair]) / self.s.displacement_std[pair]
        length = np.maximum(np.linalg.norm(d, axis=-1, keepdims=True), 1e-6)
        p = 'learned_simulator/encode_process_decode/'
        n = self._mlp(p + 'encoder/node_model/', nodes)
        e = self._mlp(p + 'encoder/edge_model/', np.concatenate([d, length], -1))
        for m in range(self.config.message_passing_steps):
            block = f'{p}processor_{m}/'
            ends = [e, n[:, self.receivers], n[:, self.senders]]
            messages = self._mlp(block + 'edge_block/', np.concatenate(ends, -1))
            received = np.zeros_like(n)
            for edge, receiver in enumerate(self.receivers):
                count = (self.receivers == receiver).sum() if self.is_ours else 1
                received[:, receiver] += messages[:, edge] / count
            update = self._mlp(block + 'node_block/', np.concatenate([received, n], -1))
            n, e = n + update, e + messages
        out = self._mlp(p, n, 'decoder')
        return out[..., :3], out[..., 3:].mean(axis=1)

    def _mlp(self, prefix, x, name='mlp'):
        w = {k[len(prefix) :]: v for k, v in self.weights.items() if k.startswith(prefix)}
        for i in range(self.config.hidden_layers + 1):
            x = x @ w[f'{name}/linear_{i}/w'] + w[f'{name}/linear_{i}/b']
            x = np.maximum(x, 0) if i < self.config.hidden_layers else x
        return x if name == 'decoder' else _norm(x, w['layer_norm/scale'], w['layer_norm/offset'])

    def moves(self, target, velocity, coming):
        """[B, V, 3] that a normalised target stands for."""
        order = np.where(self.k == 0, self.config.rigid_order, self.config.mode_order)[:, None]
        found = target * self.s.target_std[self.k] + self.s.target_mean[self.k]
        return found * self.rate(coming) + np.where(order == 2, velocity[:, -1], 0.0)

    def step(self, history, next_body, context):
        """The next positions [V, 3] and the force.

        Args:
          history: [H, V, 3] absolute positions.
          next_body: [R, 3] true rigid positions of the coming frame.
          context: [C] or None.
        """
        s, n, up = self.s, self.n, self.up
        position, velocity = history[-1], np.diff(history, axis=0)[None]
        coming = (next_body - position[:n])[None]
        context = None if context is None else context[None]
        target, load = self.network(position[None], velocity, coming, context)
        moves = self.moves(target, velocity, coming)[0]
        if self.driven:
            shape = self.given(next_body[None])[0] - self.given(position[None, :n])[0]
            moves[:n] = shape + moves[:n, up].mean() * np.eye(3)[up]
        elif self.known:
            moves[:n] = next_body - position[:n]
        force = load[0] * s.force_std + s.force_mean
        return position + moves, force * self._share(position, next_body)

    def _share(self, now, body):
        """What a body at [R, 3] may show of its force, with the modes of now."""
        if self.s.contact is None:
            return 1.0
        (axis, clear), least = self.s.contact, np.inf
        offset = (now[self.n :] - self.s.origin[1:]).ravel()
        for place, height, *weights in self.s.surface:
            surface = height + offset @ weights
            for point in body:
                least = min(least, point[self.up] - surface + 0.5 * abs(point[int(axis)] - place))
        return float(np.clip((clear + 0.005 - least) / 0.005, 0, 1))


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
