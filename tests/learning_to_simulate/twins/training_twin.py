"""A whole training step once more in numpy and float64: windows, noise, target, loss, gradient by
finite differences, clipping, Adam and the moving average; features and network are of `Twin`.

For a prescribed body in models of our style without a context. It shares with the package the
stored statistics, the weights, the list of edges and the random numbers that a seed gives; what is
done with them is written from the equations.
"""

import numpy as np
import tensorflow as tf

from tests.learning_to_simulate.twins.numpy_twin import H, Twin

WINDOWS, NOISE = 1, 2  # random streams of a (seed, step)
ADAM = {'first': 0.9, 'second': 0.999, 'epsilon': 1e-7}  # Kingma & Ba 2015, as Keras sets them


class TrainingTwin(Twin):
    """One training step of a `Model`, as it is before the step, on one group of runs."""

    def __init__(self, model, group):
        super().__init__(model, group.n_rigid)
        self.group = group
        self._named = self.weights
        self.flat = np.concatenate([v.ravel() for v in self.weights.values()])

    def at(self, flat, loss, step):
        """A loss of a step with other weights, all in one array."""
        ends = np.cumsum([v.size for v in self._named.values()])
        parts = np.split(flat, ends[:-1])
        shapes = self._named.items()
        self.weights = {n: p.reshape(v.shape) for (n, v), p in zip(shapes, parts, strict=True)}
        return loss(step)

    def windows(self, step, length, size):
        """Positions [B, H + length, V, 3] and normalised forces [B, H + length, 3] of a step's
        windows, and each one's run."""
        runs, frames = self.group.position.shape[:2]
        starts = frames - (H + length) + 1
        seed = [self.config.seed * 8 + WINDOWS, step]
        pick = tf.random.stateless_uniform([size], seed, maxval=runs * starts, dtype=tf.int32)
        run, start = np.divmod(pick.numpy(), starts)
        index = start[:, None] + np.arange(H + length)
        position = self.group.position[run[:, None], index]
        force = self.group.force[run[:, None], index]
        return position, (force - self.s.force_mean) / self.s.force_std, run

    def noise(self, step, size):
        """Noise of the velocities [B, H - 1, V, 3]: a random walk over the frames whose last value
        has the standard deviation `noise_std` of the node's own velocity; none on the body, whose
        motion is given."""
        shape = [size, self.n + self.r, H - 1, 3]
        draws = tf.random.stateless_normal(shape, [self.config.seed * 8 + NOISE, step]).numpy()
        walk, total = [], 0.0
        for frame in range(H - 1):
            total = total + draws[:, :, frame]
            walk.append(total)
        std = self.config.noise_std * self.s.velocity_std[self.k] / (H - 1) ** 0.5
        walk = np.stack(walk, axis=1) * std
        walk[:, :, : self.n] = 0.0
        return walk

    def _loss(self, motion, load_errors, run):
        """Total of errors of the modes [B, f, r, 3] and of the force's axes [B, f, 3], both
        squared, over f frames."""
        size = np.sqrt((self.group.force**2).sum(-1).mean(1))
        size = np.maximum(size, 0.02 * size.max())[run]
        weight = (self.s.force_std[0] / size) ** 2
        quiet = self.s.velocity_std[1:] / self.s.velocity_std[1:].max()
        # A weighted mean over the modes' components, times D; the error of frame f is the sum of f
        # steps' errors.
        of_frame = (motion * quiet).sum((2, 3)) / quiet.mean(axis=1).sum()
        of_load = load_errors.sum(-1) * weight[:, None]
        return (of_frame / np.arange(1, motion.shape[1] + 1)).mean() + of_load.mean()

    def single_loss(self, step):
        """The loss of a step of the single-step stage."""
        s, size = self.s, self.config.batch_size
        position, load, run = self.windows(step, 1, size)
        noise = self.noise(step, size)
        now = position[:, H - 1] + noise.sum(axis=1)
        velocity = np.diff(position[:, :H], axis=1) + noise
        moves = position[:, H] - position[:, H - 1]
        coming = moves[:, : self.n]
        predicted, predicted_load = self.network(now, velocity, coming)
        if self.config.mode_order == 2:  # the target corrects the noise of the last velocity
            moves = moves - velocity[:, -1]
        target = moves / self.rate(coming)
        target = (target - s.target_mean[self.k]) / s.target_std[self.k]
        error, load_error = (predicted - target)[:, None, self.n :], predicted_load - load[:, H]
        return self._loss(error**2, load_error[:, None] ** 2, run)

    def unrolled_loss(self, step):
        """The loss of a step of the unrolled stage."""
        count = self.config.unroll_length
        position, load, run = self.windows(step, count, self.config.unroll_batch_size)
        now, velocity = position[:, H - 1], np.diff(position[:, :H], axis=1)
        motion, loads = [], []
        for frame in range(H, H + count):
            coming = position[:, frame, : self.n] - position[:, frame - 1, : self.n]
            target, of_frame = self.network(now, velocity, coming)
            moves = self.moves(target, velocity, coming)
            moves[:, : self.n] = coming
            now = now + moves
            now[:, : self.n] = position[:, frame, : self.n]
            velocity = np.concatenate([velocity[:, 1:], moves[:, None]], axis=1)
            motion.append((now - position[:, frame])[:, self.n :] / self.s.velocity_std[1:])
            loads.append(of_frame - load[:, frame])
        return self._loss(np.stack(motion, 1) ** 2, np.stack(loads, 1) ** 2, run)

    def gradient(self, loss, step, width=1e-6):
        """Of a loss with respect to all weights, flat, by central differences."""
        slopes = np.zeros_like(self.flat)
        for i in range(len(slopes)):
            ahead, back = self.flat.copy(), self.flat.copy()
            ahead[i] += width
            back[i] -= width
            slopes[i] = (self.at(ahead, loss, step) - self.at(back, loss, step)) / (2 * width)
        return slopes

    def after_first_step(self, gradient, learning_rate):
        """Weights and their averages, flat, after the first step of a training."""
        gradient = gradient / max(np.linalg.norm(gradient), 1.0)
        first, second = ADAM['first'], ADAM['second']
        mean, square = (1 - first) * gradient, (1 - second) * gradient**2
        rate = learning_rate * np.sqrt(1 - second) / (1 - first)
        weights = self.flat - rate * mean / (np.sqrt(square) + ADAM['epsilon'])
        keep = min(self.config.weight_average, 1 / 10)  # (1 + step) / (10 + step) of step 0
        return weights, keep * self.flat + (1 - keep) * weights
