"""Training windows, cut by index out of runs that are held in memory."""

import copy

import numpy as np
import tensorflow as tf

from learning_to_simulate import loads
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH

# The force error of a run is counted in units of the run's own force, because that is how it is
# judged (relative L2); a run with less than this share of the largest force counts as if it had it.
# So is the torque error.
FORCE_FLOOR = 0.02


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
