"""`Trainer`: compiled training steps over runs held in memory.

Two stages: single steps with noise on the history, then N-step rollouts with gradients through
them. A step is a function of (weights, optimiser, seed, step): a training that was killed and
resumed gives the same weights. Windows are cut by index out of the runs.
"""

import copy
from typing import NamedTuple

import numpy as np
import tensorflow as tf

from learning_to_simulate.axes import up_vector
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace import noise_utils
from learning_to_simulate.subspace.edge_gates import EdgeGates
from learning_to_simulate.subspace.learned_simulator import SimulatorState, initial_state
from learning_to_simulate.subspace.rigid_body import known_motion
from learning_to_simulate.training.schedule import GradientTraining, check_window, mean_of

CLIP_NORM = 1.0  # largest norm of the gradient of all weights
# Independent random streams of one (seed, step).
_WINDOW_STREAM, _NOISE_STREAM, _GROUP_STREAM, _EVALUATION_STREAM, _GATE_STREAM = 1, 2, 3, 4, 5
# The force error of a run is counted in units of the run's own force, because that is how it is
# judged (relative L2); a run with less than this share of the largest force counts as if it had it.
FORCE_FLOOR = 0.02


class Trainer(GradientTraining):
    """Holds the data, the optimiser and one compiled step per group and stage, of a
    `subspace_model.Model` whose variables exist; ValueError if a run is shorter than the training
    windows."""

    def __init__(self, model, groups):
        config = model.simulator.config
        super().__init__(model.simulator, None if config.is_published else CLIP_NORM)
        check_window(groups, H + (config.unroll_length if config.unroll_steps else 1))
        self._model = model
        self._tensors = [GroupTensors(g, model.layout(g.n_rigid), self.simulator) for g in groups]
        runs = np.array([t.n_run for t in self._tensors], float)
        self._share = np.cumsum(runs / runs.sum())
        if config.gate_weight > 0:
            self.gates = EdgeGates(self.simulator.scene.n_modes)
        self._steps = {}

    def fix_edges(self, mode_mask) -> None:
        """Goes on with the edges of a bool [receiver, sender] mask [r, r]."""
        self._model.fix_mode_edges(mode_mask)
        self._tensors = [t.with_layout(self._model.layout(t.layout.n_rigid)) for t in self._tensors]
        self._steps = {}

    def step(self, step: int) -> dict[str, tf.Tensor]:
        group = self._group_of(step)
        is_gated = self.gates is not None and step < self.config.gate_steps
        key = group, step >= self.config.single_steps, is_gated
        if key not in self._steps:
            self._steps[key] = self._compile(self._tensors[group], *key[1:])
        return self._steps[key](tf.constant(step, tf.int32))

    def _group_of(self, step):
        draw = self.generator(_GROUP_STREAM, step).random()
        return min(int(np.searchsorted(self._share, draw, side='right')), len(self._tensors) - 1)

    def _seed(self, stream, step):
        return tf.stack([self.config.seed * 8 + stream, step])

    def batch_of(self, step: int) -> list[tuple[int, int]]:
        """(record of the training split, first frame) of each window of training step `step`."""
        config, tensors = self.config, self._tensors[self._group_of(step)]
        size, length = config.batch_size, 1
        if step >= config.single_steps:
            size, length = config.unroll_batch_size, config.unroll_length

        # Compiled as in the training step: its draws need not be eager ones.
        @tf.function(jit_compile=True, autograph=False)
        def picks(step):
            return tensors.picks(size, H + length, self._seed(_WINDOW_STREAM, step))

        run, start = (values.numpy() for values in picks(tf.constant(step, tf.int32)))
        return list(zip(tensors.record[run].tolist(), start.tolist()))

    def _compile(self, tensors, unrolled, gated):
        config, gates = self.config, self.gates if gated else None

        @tf.function(jit_compile=True, autograph=False)
        def train_step(step):
            windows, noise = self._seed(_WINDOW_STREAM, step), self._seed(_NOISE_STREAM, step)
            runs, trained = tensors, self.simulator.trainable_variables
            with tf.GradientTape() as tape:
                if gates:
                    seed, trained = self._seed(_GATE_STREAM, step), [*trained, gates.log_alpha]
                    runs = tensors.with_layout(gates.gated(tensors.layout, config.batch_size, seed))
                if unrolled:
                    values = self._unrolled_losses(runs, config.unroll_batch_size, windows)
                else:
                    values = self._single_step_losses(runs, config.batch_size, windows, noise)
                if gates:
                    values = gates.with_price(values, config, step)
            gradients = list(tape.gradient(values['loss'], trained))
            if gates:
                gates.optimizer.apply_gradients([(gradients.pop(), gates.log_alpha)])
            self.apply(gradients, step)
            return values

        return train_step

    def one_step_errors(self, n_batch: int = 50) -> dict[str, float]:
        """Mean one-step losses without noise over `n_batch` batches of 64 random windows of every
        group, and the position error in m²."""
        rows = []
        for index, tensors in enumerate(self._tensors):

            @tf.function(jit_compile=True, autograph=False)
            def errors(i, tensors=tensors, index=index):
                seed = tf.stack([_EVALUATION_STREAM + index, i])
                return self._single_step_losses(tensors, 64, seed, None)

            rows += [errors(tf.constant(i)) for i in range(n_batch)]
        return mean_of(rows)

    def _noisy_state(self, offset, velocity, layout, seed):
        """State after the first H frames of windows, with random-walk noise on the nodes that move
        freely."""
        state = initial_state(offset[:, :H], velocity[:, 1:H])
        config, scene, s = self.config, self.simulator.scene, self.simulator.statistics
        if config.noise_std == 0 or seed is None:
            return state
        std = np.full(layout.velocity_std.shape, config.noise_std, np.float32)
        if not config.is_published:
            std *= layout.velocity_std
        noise = noise_utils.random_walk_velocity_noise(
            state.velocity.shape, std * (layout.moving > 0), seed
        )
        if scene.rigid_motion == RigidMotion.DRIVEN:
            # One degree of freedom: every rigid particle carries the same noise, on the scale of
            # the height.
            factor = 1.0
            if not config.is_published:
                factor = s.height_velocity_std[0] / layout.velocity_std[0, scene.up_axis]
            up = up_vector(self.simulator.dim, scene.up_axis)
            body = tf.tile(noise[:, :1] * up * np.float32(factor), [1, layout.n_rigid, 1, 1])
            noise = tf.concat([body, noise[:, layout.n_rigid :]], axis=1)
        # The last position has moved by what all velocities have.
        return SimulatorState(state.offset + tf.reduce_sum(noise, axis=2), state.velocity + noise)

    def _known(self, windows, layout, frame):
        body = (x[:, frame, : layout.n_rigid] for x in (windows.offset, windows.velocity))
        known = known_motion(*body, self.simulator.scene)
        if windows.path is None:
            return known
        return known._replace(path=windows.path[:, frame], start=windows.start)

    def _single_step_losses(self, tensors, batch_size, window_seed, noise_seed):
        simulator, layout = self.simulator, tensors.layout
        w = tensors.windows(batch_size, H + 1, window_seed)
        state = self._noisy_state(w.offset, w.velocity, layout, noise_seed)
        known = self._known(w, layout, H)
        moved = w.velocity[:, H] if self.config.mode_order else w.offset[:, H] - state.offset
        target = simulator.normalized_target(moved, state, known, layout)
        predicted, force = simulator.predict(state, known, w.context_at(H), layout)
        error = predicted - target
        values = training_loss(
            error[:, None], layout.loss_weight, None if force is None else force[:, None],
            None if w.force is None else w.force[:, H:], w.force_weight,
        )  # fmt: skip
        # Of the displacement, m: what is normalised is multiplied back.
        error = error * layout.target_std * simulator.rate(known) * layout.moving
        return values | {'one_step_position_mse': tf.reduce_mean(error[:, layout.n_rigid :] ** 2)}

    def _unrolled_losses(self, tensors, batch_size, window_seed):
        n, layout, simulator = self.config.unroll_length, tensors.layout, self.simulator
        w = tensors.windows(batch_size, H + n, window_seed)
        state = initial_state(w.offset[:, :H], w.velocity[:, 1:H])
        offsets, stepped, force = [], [], None
        for k in range(H, H + n):
            known = self._known(w, layout, k)
            state, of_frame = simulator.step(state, known, w.context_at(k), layout)
            offsets.append(state.offset)
            stepped.append(of_frame)
        if w.force is not None:
            force = (tf.stack(stepped, 1) - simulator.force_mean) / simulator.force_std
        # Errors are counted in units of each node's own velocity scale.
        scale, height = layout.velocity_std.copy(), simulator.statistics.height_velocity_std
        if height is not None:
            scale[: layout.n_rigid, simulator.scene.up_axis] = height[0]
        error = (tf.stack(offsets, 1) - w.offset[:, H:]) / scale
        true_force = None if w.force is None else w.force[:, H:]
        return training_loss(error, layout.loss_weight, force, true_force, w.force_weight)


class Windows(NamedTuple):
    """B windows of K frames."""

    offset: tf.Tensor  # [B, K, V, D]
    velocity: tf.Tensor  # [B, K, V, D]
    force: tf.Tensor | None  # [B, K, F], normalised
    context: tf.Tensor | None  # [B, K, C]
    force_weight: tf.Tensor | None  # [B], see `training_loss`
    path: tf.Tensor | None  # [B, K, P] and [B, r, D] of `KnownMotion`
    start: tf.Tensor | None

    def context_at(self, frame):
        """[B, C] or None."""
        return None if self.context is None else self.context[:, frame]


class GroupTensors:
    """Runs of one group as float32 tensors: offsets from the origin, velocities, force, context."""

    def __init__(self, group, layout, simulator):
        self.layout = layout
        self.n_run, self.n_frame = group.position.shape[:2]
        self.record = group.record

        def flat(values):  # one row per frame of all runs
            return tf.constant(values.reshape(-1, *values.shape[2:]), tf.float32)

        # Differences in float64 before the cast: see the note on state in `learned_simulator`.
        offset = group.position - layout.origin
        self.offset, self.velocity = flat(offset), flat(group.velocity)
        self.force = self.force_weight = None
        if simulator.scene.has_force:
            mean, std = simulator.statistics.force_mean, simulator.statistics.force_std
            self.force = flat((group.force - mean) / std)
            # (std / rms of the run)^2 turns squared errors over `std` into relative ones.
            weight = np.ones(self.n_run)
            if not simulator.config.is_published:
                size = np.sqrt((group.force**2).sum(axis=-1).mean(axis=1))
                floor = FORCE_FLOOR * size.max() or std[0]  # all zero: no weights
                weight = (std[0] / np.maximum(size, floor)) ** 2
            self.force_weight = tf.constant(weight, tf.float32)
        self.context = self.path = self.start = None
        if simulator.statistics.context_mean is not None:
            self.context = flat(group.context_by_frame)
        if layout.memory is not None:
            self.path = flat(layout.memory.read(group.position[:, :, : group.n_rigid]))
            self.start = tf.constant(offset[:, H - 1, group.n_rigid :], tf.float32)

    def with_layout(self, layout):
        other = copy.copy(self)
        other.layout = layout
        return other

    def picks(self, batch_size, length, seed):
        """Run and first frame of `batch_size` windows of `length` frames, a function of `seed`
        int32 [2]."""
        n_start = self.n_frame - length + 1
        # One number draws both: the window's run and its first frame.
        pick = tf.random.stateless_uniform(
            [batch_size], seed, maxval=self.n_run * n_start, dtype=tf.int32
        )
        return pick // n_start, pick % n_start

    def windows(self, batch_size, length, seed) -> Windows:
        run, start = self.picks(batch_size, length, seed)
        frames = (run * self.n_frame + start)[:, None] + tf.range(length)

        def gather(values, index):
            return None if values is None else tf.gather(values, index)

        return Windows(
            gather(self.offset, frames), gather(self.velocity, frames), gather(self.force, frames),
            gather(self.context, frames), gather(self.force_weight, run), gather(self.path, frames),
            gather(self.start, run),
        )  # fmt: skip


def training_loss(error, moving, force, true_force, force_weight) -> dict[str, tf.Tensor]:
    """Loss over N frames: Usmani & Skonieczny 2023, eq. 13, for N = 1.

    Args:
      error: [B, N, V, D], of the nodes in units of their scale.
      moving: [V, D], weights of the components; 0 for given ones.
      force, true_force: [B, N, F], normalised, or None.
      force_weight: [B] or 1, of each graph's squared error.

    Returns:
      dict of scalars: `loss`, `loss_mse` (sum of squares per moving node) and, of a force,
      `loss_force_mse`.
    """
    n_step, dim = error.shape[1], error.shape[-1]
    # L = mean over graphs and frames k of 1/k sum over nodes of |error|^2 / moving nodes
    # + weight |F - F^|^2. The error of frame k is the sum of k steps' errors.
    n_moving = tf.reduce_sum(moving) / dim
    weight = 1.0 / tf.range(1, n_step + 1, dtype=error.dtype)
    motion = tf.reduce_mean(tf.reduce_sum(error**2 * moving, axis=[2, 3]) * weight / n_moving)
    if true_force is None:
        return {'loss': motion, 'loss_mse': motion}
    of_graph = tf.reduce_mean(tf.reduce_sum((force - true_force) ** 2, axis=-1), axis=1)
    of_force = tf.reduce_mean(of_graph * force_weight)
    return {'loss': motion + of_force, 'loss_mse': motion, 'loss_force_mse': of_force}
