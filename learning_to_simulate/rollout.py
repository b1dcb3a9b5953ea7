"""Whole rollouts in one compiled loop."""

import time
from typing import NamedTuple

import numpy as np
import tensorflow as tf

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH
from learning_to_simulate.learned_simulator import (
    KnownMotion,
    Layout,
    LearnedSimulator,
    SimulatorState,
    initial_state,
    known_motion,
)
from learning_to_simulate.rollout_status import Judgement, RolloutStatus, judge
from learning_to_simulate.scene import RigidMotion


class Rollout(NamedTuple):
    """Predicted frames H .. T - 1 of S runs.

    Attributes:
      position: float64 [S, T - H, V, D], m.
      force: float32 [S, T - H, D], N, or None.
      judgements: per run, its `RolloutStatus` and where that begins.
      seconds: wall time of the compiled loop (after compilation), materialised results included.
    """

    position: np.ndarray
    force: np.ndarray | None
    judgements: list[Judgement]
    seconds: float

    @property
    def status(self) -> list[RolloutStatus]:
        """The status of each run."""
        return [judgement.status for judgement in self.judgements]


def rigid_correction(shape, position):
    """Nearest rigid placement of a body to predicted particles (Usmani & Skonieczny 2023, Algorithm
    3).

    Horn's quaternion form (J. Opt. Soc. Am. A 4, 1987) instead of an SVD: its result is a proper
    rotation for coplanar bodies too, and XLA compiles it. The thesis places the particles of the
    frame before; placing the body's first shape is the same map without the drift of the shape.

    Args:
      shape: float64 [B, R, D], particles relative to their centroid in a reference frame.
      position: float64 [B, R, D], predicted particles.

    Returns:
      float64 [B, R, D], the rotated and translated shape.
    """
    centroid = tf.reduce_mean(position, axis=1, keepdims=True)
    s = tf.einsum('bri,brj->bij', shape, position - centroid)
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = (
        tf.unstack(row, axis=-1) for row in tf.unstack(s, axis=1)
    )
    rows = [
        [xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ]
    _, vectors = tf.linalg.eigh(tf.stack([tf.stack(row, -1) for row in rows], 1))
    w, x, y, z = tf.unstack(vectors[..., -1], axis=-1)
    rotation = tf.stack(
        [
            tf.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            tf.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            tf.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        axis=1,
    )
    return centroid + tf.einsum('bij,brj->bri', rotation, shape)


def body_shape(offset, origin):
    """Particles of a body relative to their centroid, float64 [B, R, D].

    Args:
      offset: float32 [B, R, D] from the origin, m.
      origin: float64 [R, D].
    """
    position = tf.cast(offset, tf.float64) + origin
    return position - tf.reduce_mean(position, axis=1, keepdims=True)


def corrected_body(shape, before, after, origin):
    """Offset and velocity, float32 [B, R, D], of a predicted body after `rigid_correction`.

    Args:
      shape: of `body_shape`.
      before, after: float32 [B, R, D] offsets before the frame and as predicted.
      origin: float64 [R, D].
    """
    placed = rigid_correction(shape, tf.cast(after, tf.float64) + origin) - origin
    velocity = tf.cast(placed - tf.cast(before, tf.float64), tf.float32)
    return tf.cast(placed, tf.float32), velocity


class RolloutFunction:
    """A compiled rollout of B graphs over a fixed number of frames.

    Args:
      simulator: the model.
      layout: of the graphs.
      rigid_correction: whether predicted bodies are kept rigid; has no effect where the motion is
        given.
    """

    def __init__(self, simulator: LearnedSimulator, layout: Layout, rigid_correction: bool = True):
        self.simulator, self.layout = simulator, layout
        self._correct = rigid_correction and simulator.scene.rigid_motion == RigidMotion.PREDICTED
        self.is_warm = False
        self._run = tf.function(self._loop, jit_compile=True, autograph=False)

    def __call__(self, state: SimulatorState, known, context, n_frame: int):
        """Rolls out `n_frame` frames.

        Args:
          state: after the first H frames.
          known: `KnownMotion` with a leading frame axis [n_frame, B, R, D], or None.
          context: float32 [B, C] or None.
          n_frame: number of frames.

        Returns:
          offsets float32 [n_frame, B, V, D] and forces float32 [n_frame, B, D] or None.
        """
        return self._run(state, known, context, n_frame)

    def _loop(self, state, known, context, n_frame):
        n = self.layout.n_rigid
        shape = body_shape(state.offset[:, :n], self.layout.origin[:n]) if self._correct else None

        def body(k, state, offsets, forces):
            coming = None if known is None else KnownMotion(known.offset[k], known.velocity[k])
            next_state, force = self.simulator.step(state, coming, context, self.layout)
            if self._correct:
                next_state = self._corrected(state, next_state, shape)
            offsets = offsets.write(k, next_state.offset)
            if force is not None:
                forces = forces.write(k, force)
            return k + 1, next_state, offsets, forces

        arrays = [
            tf.TensorArray(tf.float32, n_frame, element_shape=element)
            for element in (state.offset.shape, (state.offset.shape[0], state.offset.shape[2]))
        ]
        _, _, offsets, forces = tf.while_loop(
            lambda k, *_: k < n_frame, body, (0, state, *arrays), maximum_iterations=n_frame
        )
        return offsets.stack(), forces.stack() if self.simulator.scene.has_force else None

    def _corrected(self, before, after, shape):
        n = self.layout.n_rigid
        placed, velocity = corrected_body(
            shape, before.offset[:, :n], after.offset[:, :n], self.layout.origin[:n]
        )
        offset = tf.concat([placed, after.offset[:, n:]], axis=1)
        last = tf.concat([velocity, after.velocity[:, n:, -1]], axis=1)
        return SimulatorState(
            offset, tf.concat([after.velocity[:, :, :-1], last[:, :, None]], axis=2)
        )


def rollout_inputs(group, layout: Layout, scene):
    """The inputs of a `RolloutFunction` for all runs of a group: state, known motion, context,
    frames."""
    h = INPUT_SEQUENCE_LENGTH
    offset, velocity = group.position - layout.origin, group.velocity
    state = initial_state(offset[:, :h], velocity[:, 1:h])
    body = (np.moveaxis(a[:, h:, : group.n_rigid], 1, 0) for a in (offset, velocity))
    known = known_motion(*body, scene)
    if known is not None:
        known = KnownMotion(*(tf.cast(x, tf.float32) for x in known))
    context = None if group.context is None else tf.constant(group.context, tf.float32)
    return state, known, context, group.position.shape[1] - h


def roll_out(function: RolloutFunction, group) -> Rollout:
    """Rolls out all runs of a `RunGroup` from their first H frames.

    The first call of a function runs twice: once to compile and warm up, once for the clock.
    """
    layout = function.layout
    inputs = rollout_inputs(group, layout, function.simulator.scene)
    if not function.is_warm:
        function(*inputs)[0].numpy()
        function.is_warm = True
    start = time.perf_counter()
    offsets, forces = function(*inputs)
    offsets = offsets.numpy()
    seconds = time.perf_counter() - start
    position = np.moveaxis(offsets, 0, 1).astype(np.float64) + layout.origin
    force = None if forces is None else np.moveaxis(forces.numpy(), 0, 1)
    simulator = function.simulator
    judgements = judge(group, position, force, simulator.statistics, simulator.scene)
    return Rollout(position, force, judgements, seconds)
