"""A whole training step once more in numpy and float64: windows, noise, features, network, target,
loss, gradient by finite differences, clipping, Adam and the moving average.

For a prescribed body in models of our style without a context, one message-passing step. It shares
with the package the stored statistics, the weights, the list of edges and the random numbers that a
seed gives; what is done with them is written from the equations.
"""

import numpy as np
import tensorflow as tf

H = 6
WINDOWS, NOISE = 1, 2  # random streams of a (seed, step)
ADAM = {'first': 0.9, 'second': 0.999, 'epsilon': 1e-7}  # Kingma & Ba 2015, as Keras sets them


def _norm(x, scale, offset):
    mean, var = x.mean(-1, keepdims=True), x.var(-1, keepdims=True)
    return (x - mean) / np.sqrt(var + 1e-5) * scale + offset


class TrainingTwin:
    """One training step of a model on one group of runs.

    Args:
      model: `Model` before the step.
      group: its training runs.
    """

    def __init__(self, model, group):
        s = model.simulator
        self.s, self.config, self.group = s.statistics, s.config, group
        self.n, self.r = group.n_rigid, s.scene.n_modes
        layout = model.layout(group.n_rigid)
        self.senders, self.receivers = layout.senders, layout.receivers
        self.names = [v.name.split(':')[0] for v in s.trainable_variables]
        self.shapes = [tuple(v.shape) for v in s.trainable_variables]
        self.weights = np.concatenate([v.numpy().ravel() for v in s.trainable_variables])
        self.weights = self.weights.astype(float)
        # Force, and torque: recorded [S, T, 3], mean and spread.
        self.loads = [(group.force, self.s.force_mean, self.s.force_std)]
        if self.config.predict_torque:
            self.loads.append((group.torque, self.s.torque_mean, self.s.torque_std))
        self.node_class = np.array([0] * self.n + list(range(1, self.r + 1)))

    def named(self, flat):
        """Weights by name from one flat array."""
        ends = np.cumsum([int(np.prod(shape)) for shape in self.shapes])
        parts = np.split(flat, ends[:-1])
        return {n: p.reshape(s) for n, p, s in zip(self.names, parts, self.shapes)}

    def windows(self, step, length, size):
        """Positions [B, H + length, V, 3] and normalised loads [B, H + length, 3 or 6] of a step's
        windows, and each one's run."""
        runs, frames = self.group.position.shape[:2]
        starts = frames - (H + length) + 1
        seed = [self.config.seed * 8 + WINDOWS, step]
        pick = tf.random.stateless_uniform([size], seed, maxval=runs * starts, dtype=tf.int32)
        run, start = np.divmod(pick.numpy(), starts)
        index = start[:, None] + np.arange(H + length)
        position = self.group.position[run[:, None], index]
        loads = [(load[run[:, None], index] - mean) / std for load, mean, std in self.loads]
        return position, np.concatenate(loads, axis=-1), run

    def noise(self, step, size, scale):
        """Noise of the velocities [B, H - 1, V, 3]: a random walk over the frames whose last value
        has the standard deviation `noise_std` of the node's own velocity; none on the body, whose
        motion is given."""
        shape = [size, self.n + self.r, H - 1, 3]
        draws = tf.random.stateless_normal(shape, [self.config.seed * 8 + NOISE, step]).numpy()
        walk = np.zeros((size, H - 1, self.n + self.r, 3))
        total = np.zeros((size, self.n + self.r, 3))
        for frame in range(H - 1):
            total = total + draws[:, :, frame]
            walk[:, frame] = total
        std = self.config.noise_std * scale * self.s.velocity_std[self.node_class] / (H - 1) ** 0.5
        walk = walk * std
        walk[:, :, : self.n] = 0.0
        return walk

    def rate(self, coming):
        """[B] displacement of the body [B, R, 3] over its mean in training."""
        if not self.config.rate_scaled:
            return np.ones(len(coming))
        return np.maximum(
            np.sqrt((coming**2).sum(-1).mean(-1)) / self.s.body_speed[0], 0.05
        )  # fmt: skip

    def network(self, weights, position, velocity, coming):
        """Normalised target [B, V, 3] and loads [B, 3 or 6].

        Args:
          weights: by name.
          position: [B, V, 3] of the newest frame, noise included.
          velocity: [B, H - 1, V, 3], newest last.
          coming: [B, R, 3] displacement of the body in the coming frame.
        """
        s, k, c = self.s, self.node_class, self.config
        rate = self.rate(coming)[:, None, None]
        history = velocity[:, H - 1 - c.velocity_inputs :] / rate[:, None]
        parts = [(v - s.velocity_mean[k]) / s.velocity_std[k] for v in history.swapaxes(0, 1)]
        parts.append((position - s.origin[k]) / s.position_std[k])
        for before, after in zip(history.swapaxes(0, 1)[:-1], history.swapaxes(0, 1)[1:]):
            change = after - before - s.acceleration_mean[k]
            parts.append(change / s.acceleration_std[k])
        if c.rate_scaled:
            ones = np.ones((1, len(k), 1))
            parts += [np.log(rate) * ones, rate * ones]
        known = np.zeros_like(position)
        known[:, : self.n] = (coming / rate - s.velocity_mean[0]) / s.velocity_std[0]
        parts.append(known)
        table = weights['learned_simulator/embedding'][k]
        parts.append(np.broadcast_to(table, (len(position), *table.shape)))
        pair = k[self.receivers], k[self.senders]
        d = position[:, self.senders] - position[:, self.receivers]
        d = (d - s.displacement_mean[pair]) / s.displacement_std[pair]
        length = np.maximum(np.linalg.norm(d, axis=-1, keepdims=True), 1e-6)

        def mlp(prefix, x, name='mlp'):
            w = {n[len(prefix) :]: v for n, v in weights.items() if n.startswith(prefix)}
            for i in range(c.hidden_layers + 1):
                x = x @ w[f'{name}/linear_{i}/w'] + w[f'{name}/linear_{i}/b']
                x = np.maximum(x, 0) if i < c.hidden_layers else x
            if name == 'decoder':
                return x
            return _norm(x, w['layer_norm/scale'], w['layer_norm/offset'])

        p = 'learned_simulator/encode_process_decode/'
        nodes = mlp(p + 'encoder/node_model/', np.concatenate(parts, -1))
        edges = mlp(p + 'encoder/edge_model/', np.concatenate([d, length], -1))
        ends = [edges, nodes[:, self.receivers], nodes[:, self.senders]]
        messages = mlp(p + 'processor_0/edge_block/', np.concatenate(ends, -1))
        received = np.zeros_like(nodes)
        for edge, receiver in enumerate(self.receivers):
            received[:, receiver] += messages[:, edge] / (self.receivers == receiver).sum()
        update = mlp(p + 'processor_0/node_block/', np.concatenate([received, nodes], -1))
        out = mlp(p, nodes + update, 'decoder')
        return out[..., :3], out[..., 3:].mean(axis=1)

    def _noisy(self, position, noise):
        """Newest position and velocities of windows, with the noise of both."""
        velocity = np.diff(position[:, :H], axis=1)
        return position[:, H - 1] + noise.sum(axis=1), velocity + noise

    def _weights_of_loss(self, run):
        """Of the modes' components [r, 3], and of each window's squared errors of the loads' axes
        [B, 3 or 6]."""
        weights = []
        for load, _, std in self.loads:
            size = np.sqrt((load**2).sum(-1).mean(1))
            size = np.maximum(size, 0.02 * size.max())[run]
            weights += [(std[0] / size) ** 2] * 3
        quiet = self.s.velocity_std[1:] / self.s.velocity_std[1:].max()
        return quiet, np.stack(weights, axis=-1)

    def single_loss(self, weights, step):
        """The loss of a step of the single-step stage."""
        c, s, size = self.config, self.s, self.config.batch_size
        position, load, run = self.windows(step, 1, size)
        now, velocity = self._noisy(position, self.noise(step, size, 1.0))
        coming = position[:, H, : self.n] - position[:, H - 1, : self.n]
        predicted, predicted_load = self.network(weights, now, velocity, coming)
        moves = position[:, H] - position[:, H - 1]
        if c.mode_order == 2:  # the target corrects the noise of the last velocity
            moves = moves - velocity[:, -1]
        target = moves / self.rate(coming)[:, None, None]
        target = (target - s.target_mean[self.node_class]) / s.target_std[self.node_class]
        quiet, load_weight = self._weights_of_loss(run)
        error = (predicted - target)[:, self.n :] ** 2 * quiet
        load_error = (predicted_load - load[:, H]) ** 2
        # A weighted mean over the modes' components, times D.
        motion = error.sum((1, 2)).mean() / quiet.mean(axis=1).sum()
        return motion + (load_error * load_weight).sum(-1).mean()

    def unrolled_loss(self, weights, step):
        """The loss of a step of the unrolled stage."""
        c, s, size = self.config, self.s, self.config.unroll_batch_size
        count = c.unroll_length
        position, load, run = self.windows(step, count, size)
        now, velocity = position[:, H - 1], np.diff(position[:, :H], axis=1)
        quiet, load_weight = self._weights_of_loss(run)
        k, motion, load_error = self.node_class, 0.0, 0.0
        for frame in range(count):
            coming = position[:, H + frame, : self.n] - position[:, H + frame - 1, : self.n]
            out, out_load = self.network(weights, now, velocity, coming)
            moves = (out * s.target_std[k] + s.target_mean[k]) * self.rate(coming)[:, None, None]
            if c.mode_order == 2:
                moves = moves + velocity[:, -1]
            moves[:, : self.n] = coming
            now = now + moves
            now[:, : self.n] = position[:, H + frame, : self.n]
            velocity = np.concatenate([velocity[:, 1:], moves[:, None]], axis=1)
            error = (now - position[:, H + frame])[:, self.n :] / s.velocity_std[1:]
            # The error of frame f is the sum of f steps' errors.
            weight = 1 / (frame + 1) / quiet.mean(axis=1).sum() / count
            motion += (error**2 * quiet).sum((1, 2)) * weight
            load_error += (out_load - load[:, H + frame]) ** 2 / count
        return (motion + (load_error * load_weight).sum(-1)).mean()

    def gradient(self, loss, step, width=1e-6):
        """Of a loss with respect to all weights, flat, by central differences."""
        slopes = np.zeros_like(self.weights)
        for i in range(len(slopes)):
            ends = []
            for sign in (1, -1):
                moved = self.weights.copy()
                moved[i] += sign * width
                ends.append(loss(self.named(moved), step))
            slopes[i] = (ends[0] - ends[1]) / (2 * width)
        return slopes

    def after_first_step(self, gradient, learning_rate):
        """Weights and their averages, flat, after the first step of a training."""
        gradient = gradient / max(np.linalg.norm(gradient), 1.0)
        first, second = ADAM['first'], ADAM['second']
        mean, square = (1 - first) * gradient, (1 - second) * gradient**2
        rate = learning_rate * np.sqrt(1 - second) / (1 - first)
        weights = self.weights - rate * mean / (np.sqrt(square) + ADAM['epsilon'])
        keep = min(self.config.weight_average, 1 / 10)  # (1 + step) / (10 + step) of step 0
        return weights, keep * self.weights + (1 - keep) * weights
