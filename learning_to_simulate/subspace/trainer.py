"""`Trainer`: compiled training steps over runs held in memory.

Two stages: single steps with noise on the history, then N-step rollouts with gradients through
them. A step is a function of (weights, optimiser, seed, step): a training that was killed and
resumed gives the same weights.
"""

import numpy as np
import tensorflow as tf

from learning_to_simulate.body_height import up_vector
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace import losses, noise_utils
from learning_to_simulate.subspace.edge_gates import EdgeGates
from learning_to_simulate.subspace.learned_simulator import SimulatorState, initial_state
from learning_to_simulate.subspace.rigid_body import known_motion
from learning_to_simulate.subspace.windows import GroupTensors
from learning_to_simulate.training.schedule import TwoStageSchedule, WeightAverages

# Independent random streams of one (seed, step).
_WINDOW_STREAM, _NOISE_STREAM, _GROUP_STREAM, _EVALUATION_STREAM, _GATE_STREAM = 1, 2, 3, 4, 5


class Trainer:
    """Holds the data, the optimiser and one compiled step per group and stage.

    Args:
      model: `checkpoints.Model` whose variables exist.
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
                relative_loads=self.config.relative_force_loss,
            )
            for g in groups
        ]
        runs = np.array([t.n_run for t in self._tensors], float)
        self._share = np.cumsum(runs / runs.sum())
        self.learning_rate = TwoStageSchedule(self.config)
        self.optimizer = tf.keras.optimizers.Adam(
            self.learning_rate, global_clipnorm=self.config.clip_norm
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
        return self.config.num_steps + self.config.unroll_steps

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
        unrolled = step >= self.config.num_steps
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
        if step >= config.num_steps:
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
                    values = self._unrolled_losses(
                        tensors, config.unroll_batch_size, window_seed, noise_seed
                    )
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

    def _noisy_state(self, offset, velocity, layout, seed, scale=1.0):
        """State after the first H frames of windows, with random-walk noise on the nodes that move
        freely."""
        h = INPUT_SEQUENCE_LENGTH
        state = initial_state(offset[:, :h], velocity[:, 1:h])
        if self.config.noise_std * scale == 0 or seed is None:
            return state
        std = np.full(layout.velocity_std.shape, self.config.noise_std * scale, np.float32)
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
        values = losses.one_step_loss(
            target, predicted, true_load, predicted_load, layout.loss_weight, load_weights
        )
        error = (
            (predicted - target) * layout.target_std * self.simulator.rate(known) * layout.moving
        )
        return values | {'one_step_position_mse': tf.reduce_mean(error[:, layout.n_rigid :] ** 2)}

    def _unrolled_losses(self, tensors, batch_size, window_seed, noise_seed):
        h, n, layout = INPUT_SEQUENCE_LENGTH, self.config.unroll_length, tensors.layout
        offset, velocity, load, context, load_weights, memory = tensors.windows(
            batch_size, h + n, window_seed
        )
        state = self._noisy_state(offset, velocity, layout, noise_seed, self.config.unroll_noise)
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
        return losses.unrolled_loss(
            offset[:, h:],
            tf.stack(offsets, 1),
            load,
            predicted_load,
            layout.loss_weight,
            scale,
            load_weights,
        )
