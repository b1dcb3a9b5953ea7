"""`Trainer`: compiled training steps over runs held in memory.

Two stages: single steps with noise on the history, then N-step rollouts with gradients through
them. A step is a function of (weights, optimiser, seed, step): a training that was killed and
resumed gives the same weights. Windows are cut by index out of the runs.
"""

import copy

import numpy as np
import tensorflow as tf

from learning_to_simulate import loads
from learning_to_simulate.body_height import up_vector
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace import noise_utils
from learning_to_simulate.subspace.edge_gates import EdgeGates
from learning_to_simulate.subspace.learned_simulator import SimulatorState, initial_state
from learning_to_simulate.subspace.rigid_body import known_motion
from learning_to_simulate.training.schedule import TwoStageSchedule, WeightAverages

CLIP_NORM = 1.0  # largest norm of the gradient of all weights
# Independent random streams of one (seed, step).
_WINDOW_STREAM, _NOISE_STREAM, _GROUP_STREAM, _EVALUATION_STREAM, _GATE_STREAM = 1, 2, 3, 4, 5
# The force error of a run is counted in units of the run's own force, because that is how it is
# judged (relative L2); a run with less than this share of the largest force counts as if it had it.
# So is the torque error.
FORCE_FLOOR = 0.02


class Trainer:
    """Holds the data, the optimiser and one compiled step per group and stage.

    Args:
      model: `subspace_model.Model` whose variables exist.
      groups: list of `RunGroup`.

    Raises:
      ValueError: if a run is shorter than the training windows.
    """

    gates: EdgeGates | None = None  # while the config says that the edges are learned

    def __init__(self, model, groups):
        self.simulator, self.config = model.simulator, model.simulator.config
        longest = INPUT_SEQUENCE_LENGTH + (
            self.config.unroll_length if self.config.unroll_steps else 1
        )
        short = [g.position.shape[1] for g in groups if g.position.shape[1] < longest]
        if short:
            raise ValueError(
                f'runs of {min(short)} frames are shorter than the training window of {longest} '
                f'frames'
            )
        self._tensors = [
            GroupTensors(
                g,
                model.layout(g.n_rigid),
                self.simulator.statistics,
                relative_loads=not self.config.is_published,
            )
            for g in groups
        ]
        runs = np.array([t.n_run for t in self._tensors], float)
        self._share = np.cumsum(runs / runs.sum())
        self.learning_rate = TwoStageSchedule(self.config)
        self.optimizer = tf.keras.optimizers.Adam(
            self.learning_rate, global_clipnorm=None if self.config.is_published else CLIP_NORM
        )
        self.optimizer.build(self.simulator.trainable_variables)
        self._model = model
        if self.config.gate_weight > 0:
            self.gates = EdgeGates(self.simulator.scene.n_modes)
        self.averaging = WeightAverages(
            self.simulator.trainable_variables, self.config.weight_average
        )
        self._steps = {}

    @property
    def total_steps(self) -> int:
        """Steps of both stages."""
        return self.config.num_steps

    def is_gated(self, step: int) -> bool:
        """Whether the edges are still being learned in training step `step`."""
        return self.gates is not None and step < self.config.gate_steps

    def fix_edges(self, mode_mask) -> None:
        """Goes on with a fixed list of mode -> mode edges; the removed ones leave the graph.

        Args:
          mode_mask: bool [r, r], entry [receiver, sender].
        """
        self._model.fix_mode_edges(mode_mask)
        self._tensors = [t.with_layout(self._model.layout(t.layout.n_rigid)) for t in self._tensors]
        self._steps = {}

    def step(self, step: int) -> dict[str, tf.Tensor]:
        """Runs training step `step` (counted from 0) and returns its scalar losses."""
        unrolled = step >= self.config.single_steps
        group = self._group_of(step)
        key = group, unrolled, self.is_gated(step)
        if key not in self._steps:
            self._steps[key] = self._compile(self._tensors[group], *key[1:])
        return self._steps[key](tf.constant(step, tf.int32))

    def _group_of(self, step):
        draw = np.random.Generator(
            np.random.Philox(key=self.config.seed, counter=[0, 0, _GROUP_STREAM, step])
        ).random()
        return min(int(np.searchsorted(self._share, draw, side='right')), len(self._tensors) - 1)

    def batch_of(self, step: int) -> list[tuple[int, int]]:
        """The batch of training step `step`: (record of the training split, first frame) of each
        window."""
        config, tensors = self.config, self._tensors[self._group_of(step)]
        size, length = config.batch_size, 1
        if step >= config.single_steps:
            size, length = config.unroll_batch_size, config.unroll_length

        # Compiled as in the training step: its draws need not be eager ones.
        @tf.function(jit_compile=True, autograph=False)
        def picks(step):
            seed = tf.stack([config.seed * 8 + _WINDOW_STREAM, step])
            return tensors.picks(size, INPUT_SEQUENCE_LENGTH + length, seed)

        run, start = (values.numpy() for values in picks(tf.constant(step, tf.int32)))
        return list(zip(tensors.record[run].tolist(), start.tolist()))

    def _compile(self, tensors, unrolled, gated):
        variables = self.simulator.trainable_variables
        config, gates = self.config, self.gates if gated else None

        @tf.function(jit_compile=True, autograph=False)
        def train_step(step):
            window_seed = tf.stack([config.seed * 8 + _WINDOW_STREAM, step])
            noise_seed = tf.stack([config.seed * 8 + _NOISE_STREAM, step])
            with tf.GradientTape() as tape:
                if unrolled:
                    values = self._unrolled_losses(tensors, config.unroll_batch_size, window_seed)
                elif gates:
                    gate_seed = tf.stack([config.seed * 8 + _GATE_STREAM, step])
                    layout = gates.gated(tensors.layout, config.batch_size, gate_seed)
                    values = self._single_step_losses(
                        tensors.with_layout(layout), config.batch_size, window_seed, noise_seed
                    )
                    values = gates.with_price(values, config, step)
                else:
                    values = self._single_step_losses(
                        tensors, config.batch_size, window_seed, noise_seed
                    )
            if gates:
                *gradients, of_gates = tape.gradient(values['loss'], [*variables, gates.log_alpha])
                gates.optimizer.apply_gradients([(of_gates, gates.log_alpha)])
            else:
                gradients = tape.gradient(values['loss'], variables)
            self.optimizer.apply_gradients(zip(gradients, variables, strict=True))
            self.averaging.update(step)
            return values

        return train_step

    def one_step_errors(self, n_batch: int = 50) -> dict[str, float]:
        """Mean one-step losses without noise over random windows, and the position error in m².

        Args:
          n_batch: batches of 64 windows per group of runs.
        """
        rows = []
        for index, tensors in enumerate(self._tensors):

            @tf.function(jit_compile=True, autograph=False)
            def errors(i, tensors=tensors, index=index):
                return self._single_step_losses(
                    tensors, 64, tf.stack([_EVALUATION_STREAM + index, i]), None
                )

            rows += [
                {k: float(v) for k, v in errors(tf.constant(i)).items()} for i in range(n_batch)
            ]
        return {k: float(np.mean([row[k] for row in rows])) for k in rows[0]}

    def _noisy_state(self, offset, velocity, layout, seed):
        """State after the first H frames of windows, with random-walk noise on the nodes that move
        freely."""
        h = INPUT_SEQUENCE_LENGTH
        state = initial_state(offset[:, :h], velocity[:, 1:h])
        if self.config.noise_std == 0 or seed is None:
            return state
        std = np.full(layout.velocity_std.shape, self.config.noise_std, np.float32)
        if self.config.noise_relative:
            std *= layout.velocity_std
        noise = noise_utils.random_walk_velocity_noise(
            state.velocity.shape, std * (layout.moving > 0), seed
        )
        scene = self.simulator.scene
        if scene.rigid_motion == RigidMotion.DRIVEN:
            # One degree of freedom: every rigid particle carries the same noise, on the scale of
            # the height.
            up = up_vector(self.simulator.dim, scene.up_axis)
            s = self.simulator.statistics
            factor = (
                s.height_velocity_std[0] / layout.velocity_std[0, scene.up_axis]
                if self.config.noise_relative
                else 1.0
            )
            body = noise[:, :1] * up * np.float32(factor)
            noise = tf.concat(
                [tf.tile(body, [1, layout.n_rigid, 1, 1]), noise[:, layout.n_rigid :]], axis=1
            )
        return SimulatorState(
            state.offset + noise_utils.position_noise(noise), state.velocity + noise
        )

    def _known(self, offset, velocity, memory, layout, frame):
        n = layout.n_rigid
        known = known_motion(offset[:, frame, :n], velocity[:, frame, :n], self.simulator.scene)
        path, start = memory
        return known if path is None else known._replace(path=path[:, frame], start=start)

    def _single_step_losses(self, tensors, batch_size, window_seed, noise_seed):
        h, layout = INPUT_SEQUENCE_LENGTH, tensors.layout
        offset, velocity, load, context, load_weights, memory = tensors.windows(
            batch_size, h + 1, window_seed
        )
        state = self._noisy_state(offset, velocity, layout, noise_seed)
        known = self._known(offset, velocity, memory, layout, h)
        moved = velocity[:, h] if self.config.mode_order else offset[:, h] - state.offset
        target = self.simulator.normalized_target(moved, state, known, layout)
        predicted, predicted_load = self.simulator.predict(state, known, context(h), layout)
        true_load = None if load is None else load[:, h]
        values = one_step_loss(
            target, predicted, true_load, predicted_load, layout.loss_weight, load_weights
        )
        # Of the displacement, m: what is normalised is multiplied back.
        error = (
            (predicted - target) * layout.target_std * self.simulator.rate(known) * layout.moving
        )
        return values | {'one_step_position_mse': tf.reduce_mean(error[:, layout.n_rigid :] ** 2)}

    def _unrolled_losses(self, tensors, batch_size, window_seed):
        h, n, layout = INPUT_SEQUENCE_LENGTH, self.config.unroll_length, tensors.layout
        offset, velocity, load, context, load_weights, memory = tensors.windows(
            batch_size, h + n, window_seed
        )
        state = initial_state(offset[:, :h], velocity[:, 1:h])
        offsets, stepped = [], []
        for k in range(n):
            known = self._known(offset, velocity, memory, layout, h + k)
            state, of_frame = self.simulator.step(state, known, context(h + k), layout)
            offsets.append(state.offset)
            stepped.append(of_frame)
        s = self.simulator.statistics
        predicted_load = None
        if load is not None:
            load = load[:, h:]
            predicted_load = (
                tf.stack(stepped, 1) - self.simulator.load_mean
            ) / self.simulator.load_std
        scale = layout.velocity_std.copy()
        if s.height_velocity_std is not None:
            scale[: layout.n_rigid, self.simulator.scene.up_axis] = s.height_velocity_std[0]
        return unrolled_loss(
            offset[:, h:],
            tf.stack(offsets, 1),
            load,
            predicted_load,
            layout.loss_weight,
            scale,
            load_weights,
        )


class GroupTensors:
    """Runs of one group as float32 tensors: offsets from the origin, velocities, loads, context."""

    def __init__(self, group, layout, statistics, relative_loads):
        self.layout = layout
        self.n_run, self.n_frame = group.position.shape[:2]
        self.record = group.record
        flat = (self.n_run * self.n_frame, *group.position.shape[2:])
        # Differences in float64 before the cast: see the note on state in `learned_simulator`.
        self.offset = tf.constant((group.position - layout.origin).reshape(flat), tf.float32)
        self.velocity = tf.constant(group.velocity.reshape(flat), tf.float32)
        self.load = self.context = None
        self.load_weights = []
        normalised = []
        for load, (mean, std) in zip((group.force, group.torque), loads.scales(statistics)):
            normalised.append((load - mean) / std)
            # (std / rms of the run)^2 turns squared errors over `std` into relative ones.
            weight = np.ones(self.n_run)
            if relative_loads:
                size = np.sqrt((load**2).sum(axis=-1).mean(axis=1))
                floor = FORCE_FLOOR * size.max() or std[0]  # all zero: no weights
                weight = (std[0] / np.maximum(size, floor)) ** 2
            self.load_weights.append(tf.constant(weight, tf.float32))
        if normalised:
            flat_loads = np.concatenate(normalised, axis=-1).reshape(flat[0], -1)
            self.load = tf.constant(flat_loads, tf.float32)
        if statistics.context_mean is not None:
            self._context_by_frame = group.context_changes
            rows = group.context.reshape(-1, group.context.shape[-1])
            self.context = tf.constant(rows, tf.float32)
        self.path = self.start = None
        if layout.memory is not None:
            path = layout.memory.read(group.position[:, :, : group.n_rigid])
            self.path = tf.constant(path.reshape(flat[0], -1))
            start = (group.position - layout.origin)[:, INPUT_SEQUENCE_LENGTH - 1, group.n_rigid :]
            self.start = tf.constant(start, tf.float32)

    def with_layout(self, layout):
        """The same runs on another graph of the same nodes."""
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

    def _context_of(self, run, frames):
        """Context [B, C] or None of windows, called with the number of a frame in the window."""
        if self.context is None:
            return lambda k: None
        if self._context_by_frame:
            return lambda k: tf.gather(self.context, frames[:, k])
        constant = tf.gather(self.context, run)
        return lambda k: constant

    def windows(self, batch_size, length, seed):
        """Gathers the windows that `picks` names: offsets, velocities, loads, context as of
        `_context_of`, weights of each load, and (path, start) as of `KnownMotion`."""
        run, start = self.picks(batch_size, length, seed)
        frames = (run * self.n_frame + start)[:, None] + tf.range(length)
        memory = (None, None)
        if self.path is not None:
            memory = tf.gather(self.path, frames), tf.gather(self.start, run)
        return (
            tf.gather(self.offset, frames),
            tf.gather(self.velocity, frames),
            None if self.load is None else tf.gather(self.load, frames),
            self._context_of(run, frames),
            [tf.gather(weight, run) for weight in self.load_weights],
            memory,
        )


def one_step_loss(target, predicted_target, load, predicted_load, moving, load_weights=(1.0,)):
    """Loss of Usmani & Skonieczny 2023, eq. 13: error of the moving nodes plus error of the force,
    and of the torque where it is predicted.

    Args:
      target, predicted_target: [B, V, D], normalised.
      load, predicted_load: [B, F], normalised, or None; equal parts for the names of `loads`.
      moving: [V, D], 1 for components that the network decides, 0 for given ones.
      load_weights: for each of the parts, [B] or 1, of each graph's squared error.

    Returns:
      dict of scalars: `loss`, `loss_mse` (sum of squares per moving node), `loss_force_mse` and
      `loss_torque_mse`, as far as there are weights.
    """
    dim = target.shape[-1]
    # L = sum over nodes of |y - y^|^2 / moving nodes + weight |F - F^|^2, mean over graphs.
    n_moving = tf.reduce_sum(moving) / dim
    motion = tf.reduce_sum((predicted_target - target) ** 2 * moving, axis=[1, 2]) / n_moving
    return _total(tf.reduce_mean(motion), _load_errors(load, predicted_load, load_weights))


def unrolled_loss(
    offsets, predicted_offsets, load, predicted_load, moving, scale, load_weights=(1.0,)
):
    """Loss over N rolled-out frames; frame k weighs 1 / k, because its error is the sum of k
    steps'.

    Args:
      offsets, predicted_offsets: [B, N, V, D], m.
      load, predicted_load: [B, N, F], normalised, or None.
      moving: [V, D] as in `one_step_loss`.
      load_weights: as in `one_step_loss`.
      scale: [V, D], m; errors are counted in units of it (each node's own velocity scale).

    Returns:
      dict of scalars as in `one_step_loss`.
    """
    n_step, dim = offsets.shape[1], offsets.shape[-1]
    n_moving = tf.reduce_sum(moving) / dim
    # L = mean over frames k of 1/k sum over nodes of |x_k - x^_k|^2 / scale^2 / moving nodes.
    error = ((predicted_offsets - offsets) / scale) ** 2 * moving
    weight = 1.0 / tf.range(1, n_step + 1, dtype=error.dtype)
    motion = tf.reduce_sum(error, axis=[2, 3]) * weight / n_moving
    return _total(tf.reduce_mean(motion), _load_errors(load, predicted_load, load_weights))


def _load_errors(load, predicted_load, weights):
    """Name of each load -> its error."""
    if load is None:
        return {}
    parts = (tf.split(x, len(weights), axis=-1) for x in (load, predicted_load))
    return {
        name: _load_error(*one) for name, *one in zip(loads.NAMES, *parts, weights, strict=False)
    }


def _load_error(load, predicted_load, weight):
    error = tf.reduce_sum((predicted_load - load) ** 2, axis=-1)
    return tf.reduce_mean(tf.reduce_mean(tf.reshape(error, [error.shape[0], -1]), axis=1) * weight)


def _total(motion, of_loads):
    parts = {f'loss_{name}_mse': error for name, error in of_loads.items()}
    return {'loss': sum(of_loads.values(), motion), 'loss_mse': motion, **parts}
