"""`ParticleTrainer`: single steps with random-walk noise on windows of particle runs."""

import numpy as np
import tensorflow as tf

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.full_space.simulator import history_of
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.training.schedule import GradientTraining

_WINDOW_STREAM, _EVALUATION_STREAM = 11, 12


class ParticleTrainer(GradientTraining):
    """Holds one `RunGroup` of particles, the optimiser and one compiled step; batches are made on
    the host, and dealt to the processes that train together (`share`; None for this one alone).

    Raises:
      ValueError: runs shorter than a window, or batches that cannot be dealt to the processes.
    """

    def __init__(self, model, group, share=None):
        super().__init__(model.simulator, clip_norm=1.0)
        self._group, self._share = group, share
        if self._group.position.shape[1] <= H:
            raise ValueError(
                f'runs of {self._group.position.shape[1]} frames are shorter than the training '
                f'window of {H + 1} frames'
            )
        if share:
            share.refuse_batch(self.config.batch_size)
        self._compiled = tf.function(self._train_step, autograph=False, reduce_retracing=True)

    def step(self, step: int) -> dict[str, tf.Tensor]:
        rng = self.generator(_WINDOW_STREAM, step)
        windows = self._windows(rng, self.config.batch_size)
        # Every process draws all noise, so that a sample has the same wherever it is made.
        drawn = [(run, start, self._walk(rng)) for run, start in windows]
        if self._share:
            drawn = drawn[self._share.index :: self._share.count]
        batch = self._batch([self._sample(*sample) for sample in drawn])
        return self._compiled(tf.constant(step, tf.float32), *batch)

    def batch_of(self, step: int) -> list[tuple[int, int]]:
        """(record, first frame) of each window of training step `step`."""
        rng = self.generator(_WINDOW_STREAM, step)
        windows = self._windows(rng, self.config.batch_size)
        return [(int(self._group.record[run]), start) for run, start in windows]

    def one_step_errors(self, n_batch: int = 20) -> dict[str, float]:
        """Mean one-step losses without noise over random windows."""
        rows = []
        for i in range(n_batch):
            rng = self.generator(_EVALUATION_STREAM, i)
            samples = [self._sample(run, start) for run, start in self._windows(rng, 4)]
            rows.append({k: float(v) for k, v in self._losses(*self._batch(samples)).items()})
        return {k: float(np.mean([row[k] for row in rows])) for k in rows[0]}

    def _windows(self, rng, size):
        n_run, n_frame = self._group.position.shape[:2]
        picks = rng.integers(n_run * (n_frame - H), size=size)
        return [divmod(int(pick), n_frame - H) for pick in picks]

    def _walk(self, rng):
        if not self.config.noise_std:
            return None
        return rng.normal(size=(H - 1, *self._group.position.shape[2:]))

    def _sample(self, run, start, walk=None):
        """Graph, target [V, D], weight [V, D] of its error, force [D] of one window; the random
        walk of the noise reaches `noise_std` in the last velocity (SG 2020, B.1)."""
        group, simulator, config = self._group, self.simulator, self.config
        s, scene, n = simulator.statistics, simulator.scene, self._group.n_rigid
        end = start + H - 1
        position, velocity = history_of(group, run, end)
        coming = group.position[run, end + 1] - position
        given = simulator.given_motion(coming[:n])
        rate = simulator.rate(given)
        if walk is not None:
            std = config.noise_std * rate * s.velocity_std[1]
            walk = walk.cumsum(axis=0) * std / np.sqrt(len(velocity))
            walk[:, :n] = 0.0
            position, velocity = position + walk.sum(axis=0), velocity + walk
        context = group.context_at(end + 1, run)
        graph = simulator.inputs(position, velocity, given, context, n)
        base, std = simulator.base_and_std(velocity)
        target = (coming - base) / (rate * std)
        weight = np.full(target.shape, 1.0 / (len(target) - n))
        weight[:n] = 0.0
        if scene.rigid_motion == RigidMotion.DRIVEN:
            up = scene.up_axis
            height = (coming[:n, up] - velocity[-1, :n, up]).mean() / s.height_std[0]
            target[:n, up], weight[:n, up] = height, 1.0 / n
        force = np.zeros(simulator.dim)
        if scene.has_force:
            force = (group.force[run, end + 1] - s.force_mean) / s.force_std
        return graph, target, weight, force

    def _batch(self, samples):
        """Graphs side by side as one, with the index of the body's particles [B, R]."""
        graphs, targets, weights, forces = zip(*samples)
        n_node, n = len(targets[0]), self._group.n_rigid or len(targets[0])
        first = np.arange(len(samples)) * n_node
        ends = [
            np.concatenate([graph[i] + shift for graph, shift in zip(graphs, first)])
            for i in (2, 3)
        ]
        values = (*(np.concatenate([g[i] for g in graphs]) for i in (0, 1)), *ends)
        values += (np.concatenate(targets), np.concatenate(weights), np.stack(forces))
        types = (tf.float32, tf.float32, tf.int32, tf.int32, tf.float32, tf.float32, tf.float32)
        tensors = [tf.constant(v, t) for v, t in zip(values, types)]
        return (*tensors, tf.constant(first[:, None] + np.arange(n), tf.int32))

    def _losses(self, nodes, edges, senders, receivers, target, weight, force, body):
        predicted, forces = self.simulator.decode(nodes, edges, senders, receivers)
        n_graph = tf.cast(tf.shape(force)[0], tf.float32)
        motion = tf.reduce_sum((predicted - target) ** 2 * weight) / n_graph
        if forces is None:
            return {'loss': motion, 'loss_mse': motion}
        pooled = tf.reduce_mean(tf.gather(forces, body), axis=1)
        error = tf.reduce_sum((pooled - force) ** 2) / n_graph
        return {'loss': motion + error, 'loss_mse': motion, 'loss_force_mse': error}

    def _train_step(self, step, *batch):
        variables = self.simulator.trainable_variables
        with tf.GradientTape() as tape:
            values = self._losses(*batch)
        gradients = tape.gradient(values['loss'], variables)
        if self._share:
            gradients, values = self._share.mean((gradients, values))
        self.optimizer.apply_gradients(zip(gradients, variables, strict=True))
        self.averaging.update(step)
        return values
