"""The simulator once more in plain numpy and float64, written from the equations and edge by edge.

It shares no code with the package but the stored statistics and weights.
"""

import numpy as np

H = 6


def _norm(x, scale, offset):
    mean, var = x.mean(-1, keepdims=True), x.var(-1, keepdims=True)
    return (x - mean) / np.sqrt(var + 1e-5) * scale + offset


class Twin:
    """One step of a `Model` for one run.

    Args:
      model: the model.
      n_rigid: R.
    """

    def __init__(self, model, n_rigid):
        s = model.simulator
        self.s, self.config, self.scene = s.statistics, s.config, s.scene
        self.n_rigid, self.r = n_rigid, s.scene.n_modes
        layout = model.layout(n_rigid)
        self.edges = list(zip(layout.senders.tolist(), layout.receivers.tolist()))
        self.weights = {
            v.name.split(':')[0]: v.numpy().astype(float) for v in s.trainable_variables
        }
        self.types = s.particle_types
        self.rated = self.config.rate_scaled and self.scene.rigid_motion in ('prescribed', 'driven')

    def _mlp(self, prefix, x, name='mlp'):
        w = {k[len(prefix) :]: v for k, v in self.weights.items() if k.startswith(prefix)}
        for i in range(3):
            x = x @ w[f'{name}/linear_{i}/w'] + w[f'{name}/linear_{i}/b']
            x = np.maximum(x, 0) if i < 2 else x
        return x if name == 'decoder' else _norm(x, w['layer_norm/scale'], w['layer_norm/offset'])

    def _class(self, node):
        return 0 if node < self.n_rigid else 1 + node - self.n_rigid

    def _row(self, node):
        """Row of the embedding by class; those of further bodies come behind those of the modes."""
        counts = [count for _, count in self.scene.bodies]
        body = sum(node >= end for end in np.cumsum(counts[:-1])) if node < self.n_rigid else 0
        return self.r + body if body else self._class(node)

    def step(self, history, next_body, context):
        """The next positions and the force, and behind it the torque where that is predicted.

        Args:
          history: [H, V, 3] absolute positions.
          next_body: [R, 3] true rigid positions of the coming frame.
          context: [C] or None.
        """
        s, c, n_node = self.s, self.config, history.shape[1]
        velocity = np.diff(history, axis=0)
        body_now, up = history[-1, : self.n_rigid], self.scene.up_axis
        coming = next_body - body_now
        driven = self.scene.rigid_motion == 'driven'
        shape_change = coming.copy()
        if driven:
            shape_change[:, up] -= coming[:, up].mean()
        rate = 1.0
        if self.rated:
            rate = max(np.sqrt((shape_change**2).sum(1).mean()) / s.body_speed[0], 0.05)
        nodes = []
        for i in range(n_node):
            k = self._class(i)
            v = velocity[-c.velocity_inputs :, i] / rate
            row = [((v - s.velocity_mean[k]) / s.velocity_std[k]).ravel()]
            if c.style == 'ours':
                row.append((history[-1, i] - s.origin[k]) / s.position_std[k])
                if c.velocity_inputs > 1:
                    a = np.diff(v, axis=0)
                    row.append(((a - s.acceleration_mean[k]) / s.acceleration_std[k]).ravel())
            if self.rated:
                row.append([np.log(rate), rate])
            if c.style == 'ours' and self.scene.rigid_motion in ('prescribed', 'driven'):
                known = np.zeros(3)
                if k == 0:
                    known = (shape_change[i] / rate - s.velocity_mean[0]) / s.velocity_std[0]
                row.append(known)
            if c.style == 'ours' and driven:
                height = np.zeros(H)
                if k == 0:
                    height[0] = (body_now[:, up] - s.origin[0, up]).mean() / s.height_std[0]
                    height[1:] = velocity[:, : self.n_rigid, up].mean(1) / s.height_velocity_std[0]
                row.append(height)
            table = self.weights['learned_simulator/embedding']
            row.append(
                table[self._row(i)] if c.style == 'ours' else table[self.types[0 if k == 0 else 1]]
            )
            if context is not None:
                row.append((context - s.context_mean) / s.context_std)
                if c.style == 'ours':
                    row.append((np.log(context) - s.log_context_mean) / s.log_context_std)
            nodes.append(np.concatenate(row))
        edges = []
        for sender, receiver in self.edges:
            pair = self._class(receiver), self._class(sender)
            d = history[-1, sender] - history[-1, receiver]
            d = (d - s.displacement_mean[pair]) / s.displacement_std[pair]
            edges.append(np.append(d, max(np.linalg.norm(d), 1e-6)))
        out = self._network(np.array(nodes), np.array(edges))
        mean, std = s.force_mean, s.force_std
        if c.predict_torque:
            mean, std = np.append(mean, s.torque_mean), np.append(std, s.torque_std)
        load = out[:, 3:].mean(0) * std + mean
        load = load * self._share(history[-1], next_body)
        return self._integrate(history, velocity, out[:, :3], next_body, rate, driven), load

    def _share(self, now, body):
        """What a body at [R, 3] may show of its force, with the modes of now."""
        s, up = self.s, self.scene.up_axis
        if s.contact is None:
            return 1.0
        (axis, clear), least = s.contact, np.inf
        offset = (now[self.n_rigid :] - s.origin[1:]).ravel()
        for place, height, *weights in s.surface:
            surface = height + offset @ weights
            for point in body:
                least = min(least, point[up] - surface + 0.5 * abs(point[int(axis)] - place))
        return float(np.clip((clear + 0.005 - least) / 0.005, 0, 1))

    def _network(self, nodes, edges):
        p = 'learned_simulator/encode_process_decode/'
        n = self._mlp(p + 'encoder/node_model/', nodes)
        e = self._mlp(p + 'encoder/edge_model/', edges)
        for m in range(self.config.message_passing_steps):
            block = p + f'processor_{m}/'
            inputs = [np.concatenate([e[k], n[r], n[s]]) for k, (s, r) in enumerate(self.edges)]
            messages = self._mlp(block + 'edge_block/', np.array(inputs))
            received = np.zeros_like(n)
            for i in range(len(n)):
                arriving = [messages[k] for k, (_, r) in enumerate(self.edges) if r == i]
                if arriving:
                    total = np.sum(arriving, axis=0)
                    received[i] = total / len(arriving) if self.config.style == 'ours' else total
            update = self._mlp(block + 'node_block/', np.concatenate([received, n], -1))
            n, e = n + update, e + messages
        return self._mlp(p, n, 'decoder')

    def _integrate(self, history, velocity, out, next_body, rate, driven):
        position, up = history[-1].copy(), self.scene.up_axis
        moves = np.empty_like(position)
        for i in range(len(position)):
            k = self._class(i)
            order = self.config.rigid_order if k == 0 else self.config.mode_order
            moves[i] = (out[i] * self.s.target_std[k] + self.s.target_mean[k]) * rate
            if order == 2:
                moves[i] += velocity[-1, i]
        body = slice(0, self.n_rigid)
        if self.scene.rigid_motion == 'prescribed':
            moves[body] = next_body - position[body]
        elif driven:
            moves[body] = moves[body, up].mean() * np.eye(3)[up]
            shape = next_body.copy()
            shape[:, up] += position[body, up].mean() - next_body[:, up].mean()
            moves[body] += shape - position[body]
        return position + moves
