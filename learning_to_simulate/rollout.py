"""Whole rollouts of networks in the subspace, in one compiled loop (soil fields:
`soil_field.rollout`)."""

import time
from typing import NamedTuple

import numpy as np
import tensorflow as tf

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.rollout_status import Judgement, judge
from learning_to_simulate.subspace.learned_simulator import (
    Layout,
    LearnedSimulator,
    SimulatorState,
    initial_state,
)
from learning_to_simulate.subspace.rigid_body import (
    KnownMotion,
    known_motion,
    rigid_correction,
    shape_of,
)


class Rollout(NamedTuple):
    """Predicted frames H .. T - 1 of S runs.

    Attributes:
      position: float64 [S, T - H, V, D], m.
      force: float32 [S, T - H, D], N, or None.
      judgements: per run.
      seconds: wall time of the compiled loop (after compilation), materialised results included.
      edges: of the graph, in the mean over frames; 0 without one.
    """

    position: np.ndarray
    force: np.ndarray | None
    judgements: list[Judgement]
    seconds: float
    edges: int = 0


def corrected_step(simulator, layout: Layout, state: SimulatorState, known, context, shape):
    """One frame of `LearnedSimulator.step`, a predicted body kept in a shape of `shape_of` (None
    for none): the next `SimulatorState`, and force [B, F] or None."""
    after, force = simulator.step(state, known, context, layout)
    if shape is None:
        return after, force
    n = layout.n_rigid
    origin, before = layout.origin[:n], tf.cast(state.offset[:, :n], tf.float64)
    placed = rigid_correction(shape, tf.cast(after.offset[:, :n], tf.float64) + origin) - origin
    newest = tf.concat([tf.cast(placed - before, tf.float32), after.velocity[:, n:, -1]], axis=1)
    return SimulatorState(
        tf.concat([tf.cast(placed, tf.float32), after.offset[:, n:]], axis=1),
        tf.concat([after.velocity[:, :, :-1], newest[:, :, None]], axis=2),
    ), force


class RolloutFunction:
    """A compiled rollout of B graphs of a layout over a fixed number of frames; variables are read
    anew in every call."""

    def __init__(self, simulator: LearnedSimulator, layout: Layout):
        self.simulator, self.layout = simulator, layout
        self.is_warm = False
        self._run = tf.function(self._loop, jit_compile=True, autograph=False)

    def __call__(self, state: SimulatorState, known, context, n_frame: int):
        """Rolls out `n_frame` frames from the state after the first H: offsets float32 [n_frame, B,
        V, D] and forces float32 [n_frame, B, F] or None. `known` is a `KnownMotion` with a leading
        frame axis [n_frame, B, ...], or None; the context float32 [B, C], or [n_frame, B, C] where
        it changes in time, or None."""
        return self._run(state, known, context, n_frame)

    def _loop(self, state, known, context, n_frame):
        layout, simulator = self.layout, self.simulator
        shape = shape_of(state.offset, layout, simulator.scene)

        def body(k, state, arrays):
            coming = None if known is None else known.at(k)
            changes = context is not None and context.shape.rank == 3
            now = context[k] if changes else context
            state, force = corrected_step(simulator, layout, state, coming, now, shape)
            written = [state.offset] + ([] if force is None else [force])
            return k + 1, state, [a.write(k, x) for a, x in zip(arrays, written, strict=True)]

        shapes = [state.offset.shape]
        if simulator.force_size:
            shapes.append((state.offset.shape[0], simulator.force_size))
        arrays = [tf.TensorArray(tf.float32, n_frame, element_shape=x) for x in shapes]
        _, _, arrays = tf.while_loop(
            lambda k, *_: k < n_frame, body, (0, state, arrays), maximum_iterations=n_frame
        )
        offsets, *force = [a.stack() for a in arrays]
        return offsets, force[0] if force else None


def rollout_inputs(group, layout: Layout, scene):
    """Arguments of a `RolloutFunction` for all runs of a group."""
    offset, velocity = group.position - layout.origin, group.velocity
    state = initial_state(offset[:, :H], velocity[:, 1:H])
    body = (np.moveaxis(a[:, H:, : group.n_rigid], 1, 0) for a in (offset, velocity))
    known = known_motion(*body, scene)  # type: ignore[call-arg]
    if known is not None:
        known = KnownMotion(*(tf.cast(x, tf.float32) for x in known[:2]))
    if layout.memory is not None:
        path = layout.memory.read(group.position[:, :, : group.n_rigid])[:, H:]
        start = tf.constant(offset[:, H - 1, group.n_rigid :], tf.float32)
        known = known._replace(path=tf.constant(np.moveaxis(path, 1, 0)), start=start)
    context = group.context
    if context is not None:
        by_frame = np.moveaxis(context[:, H:], 1, 0) if group.context_changes else context
        context = tf.constant(by_frame, tf.float32)
    return state, known, context, group.position.shape[1] - H


def roll_out(function: RolloutFunction, group, force_limit: float | None = None) -> Rollout:
    """Rolls out all runs of a `RunGroup` from their first H frames; `force_limit` as of
    `rollout_status.judge`.

    The first call of a function runs twice: once to compile and warm up, once for the clock.
    """
    layout = function.layout
    inputs = rollout_inputs(group, layout, function.simulator.scene)
    if not function.is_warm:
        function(*inputs)[0].numpy()
        function.is_warm = True
    start = time.perf_counter()
    offsets, force = function(*inputs)
    offsets = offsets.numpy()
    seconds = time.perf_counter() - start
    position = np.moveaxis(offsets, 0, 1).astype(np.float64) + layout.origin
    force = None if force is None else np.moveaxis(force.numpy(), 0, 1)
    s = function.simulator
    judgements = judge(group, position, force, s.statistics, s.scene, force_limit)
    return Rollout(position, force, judgements, seconds, layout.n_edge)
