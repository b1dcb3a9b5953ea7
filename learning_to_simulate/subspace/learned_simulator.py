"""`LearnedSimulator`: features, network, heads and integration of one frame.

State inside the model is float32 offset from a float64 origin plus float32 velocities (per frame);
absolute mode scores reach 18 while their steps are 1e-5, so float32 positions would lose the
motion. Callers add the origin back in float64 when positions are written.
"""

from typing import NamedTuple

import numpy as np
import sonnet as snt
import tensorflow as tf

from learning_to_simulate import normalization
from learning_to_simulate.axes import up_vector
from learning_to_simulate.checkpoints import NUM_PARTICLE_TYPES
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH, TrainConfig
from learning_to_simulate.scene import RigidMotion, Scene
from learning_to_simulate.subspace import features, graph_network
from learning_to_simulate.subspace.contact import Contact
from learning_to_simulate.subspace.path_memory import PathMemory

RATE_FLOOR = 0.05  # of the mean speed of the body; below it the soil's own motion is not scaled


class SimulatorState(NamedTuple):
    """State of B graphs."""

    offset: tf.Tensor  # float32 [B, V, D], position minus origin, m
    velocity: tf.Tensor  # float32 [B, V, H - 1, D], of the last frames, m/frame, newest last


class Layout:
    """Constants of the graph for R rigid particles: edges of V = R + r nodes by a mask bool [V, V],
    entry [receiver, sender], and statistics per node and edge. ValueError if the bodies of the
    scene have another number of nodes."""

    def __init__(
        self,
        mask: np.ndarray,
        n_rigid: int,
        scene: Scene,
        statistics: normalization.Statistics,
        config: TrainConfig,
    ):
        s = statistics
        self.n_rigid = n_rigid
        # Sorted by receiver, then sender.
        self.receivers, self.senders = (ends.astype(np.int32) for ends in np.nonzero(mask))
        self.n_node, self.n_edge = len(mask), len(self.senders)
        self.edge_gates = None  # float32 [B or 1, E] while the edges are being learned
        self.node_class = normalization.node_classes(n_rigid, scene.n_modes)
        self.origin = s.origin[self.node_class]
        # Reads the path, where that is an input; and says where the body feels no soil, where tools
        # leave it.
        self.memory = None if s.path is None else PathMemory.of_statistics(s.path, scene)
        self.contact = None
        if s.contact is not None:
            self.contact = Contact.of_statistics(s.contact, s.surface, scene)
        counts = [count for _, count in scene.bodies] or [n_rigid]
        if sum(counts) != n_rigid:
            raise ValueError(f'the bodies {scene.bodies} have {sum(counts)} nodes, not {n_rigid}')
        # Rows of an embedding by class: further bodies have theirs behind those of the modes.
        further = np.where(np.arange(len(counts)) > 0, np.arange(len(counts)) + scene.n_modes, 0)
        self.embedded = self.node_class.copy()
        self.embedded[:n_rigid] = np.repeat(further, counts)

        def per_node(values):
            return values[self.node_class].astype(np.float32)

        self.position_std = per_node(s.position_std)
        self.velocity_mean, self.velocity_std = per_node(s.velocity_mean), per_node(s.velocity_std)
        self.acceleration_mean = per_node(s.acceleration_mean)
        self.acceleration_std = per_node(s.acceleration_std)
        self.target_mean, self.target_std = per_node(s.target_mean), per_node(s.target_std)
        pair = (self.node_class[self.receivers], self.node_class[self.senders])
        edge_std, edge_origin = s.displacement_std[pair], s.origin[pair[1]] - s.origin[pair[0]]
        self.edge_std = edge_std.astype(np.float32)
        self.edge_shift = ((edge_origin - s.displacement_mean[pair]) / edge_std).astype(np.float32)
        # What the network decides: all of the modes; of the body nothing, its height, or all.
        self.moving = np.ones((self.n_node, self.origin.shape[1]), np.float32)
        if scene.rigid_motion.is_known:
            self.moving[:n_rigid] = 0.0
        if scene.rigid_motion == RigidMotion.DRIVEN:
            # R particles share one degree of freedom: together they count as one component.
            self.moving[:n_rigid, scene.up_axis] = 1.0 / n_rigid
        self.loss_weight = self.moving.copy()
        if not config.is_published:
            # Quiet components cost less: an error counts by its share of the loudest component's
            # motion. Lateral scores are mostly noise, and equal weights would spend the network on
            # them. An error of a place (order 0) counts as it does in the particles.
            weight = s.velocity_std[1:] / s.velocity_std[1:].max()
            if config.mode_order == 0:
                weight = (s.target_std[1:] / s.target_std[1:].max()) ** 2
            self.loss_weight[n_rigid:] *= weight.astype(np.float32)


class LearnedSimulator(snt.Module):
    """One frame of the simulation of B graphs; `particle_types` are those of the rigid particles
    and of the modes, for the published type embedding."""

    def __init__(self, scene: Scene, config: TrainConfig, statistics, particle_types):
        super().__init__()
        self.scene, self.config, self.statistics = scene, config, statistics
        self.particle_types = particle_types
        self.dim = statistics.origin.shape[1]
        self.force_mean, self.force_std = (
            None if x is None else x.astype(np.float32)
            for x in (statistics.force_mean, statistics.force_std)
        )
        # F: D of each body.
        self.force_size = 0 if self.force_mean is None else len(self.force_mean)
        self._make_network()

    def _make_network(self):
        config, scene = self.config, self.scene
        self.network = graph_network.EncodeProcessDecode(
            config.latent_size,
            config.hidden_layers,
            config.message_passing_steps,
            output_size=self.dim + self.force_size,
            mean_aggregation=not config.is_published,
        )
        rows = scene.n_modes + max(len(scene.bodies), 1)
        shape = [NUM_PARTICLE_TYPES if config.is_published else rows, features.EMBEDDING_SIZE]
        initial = tf.random.stateless_normal(shape, [config.seed, 0])
        self._embedding = tf.Variable(initial, name='embedding')

    def check_size(self, n_rigid: int):
        """Refuses bodies of R particles that the network cannot take; a graph takes any number."""

    @property
    def knows_next_frame(self) -> bool:
        """Whether the coming frame of the body is an input; not in the published presets."""
        return self.scene.rigid_motion.is_known and not self.config.is_published

    @property
    def rate_scaled(self) -> bool:
        """Whether motion is counted per displacement of the body, which must be known for it."""
        return self.config.rate_scaled and self.scene.rigid_motion.is_known

    def features(self, state: SimulatorState, known, context, layout: Layout):
        """Network inputs, nodes [B, V, F] and edges [B, E, D + 1]; arguments as of `step`."""
        view = features.View(self, state, known, context, layout)
        nodes = [features.at_every_node(feature, view) for feature in features.of(self)]
        ends = tf.gather(state.offset, layout.senders, axis=1) - tf.gather(
            state.offset, layout.receivers, axis=1
        )
        # e_ij = ((x_j - x_i) - mean_ij) / std_ij of sender j and receiver i, by their classes, and
        # |e_ij|. The origins of the positions are constant: they are in `edge_shift`.
        displacement = ends / layout.edge_std + layout.edge_shift
        # The floor keeps the gradient of the norm finite on self-edges and coincident nodes.
        length = tf.sqrt(tf.maximum(tf.reduce_sum(displacement**2, axis=-1, keepdims=True), 1e-12))
        return tf.concat(nodes, axis=-1), tf.concat([displacement, length], axis=-1)

    def node_embedding(self, layout: Layout):
        """What tells the nodes apart, [V, 16]: a learned row per class, or per published type."""
        classes = layout.embedded
        if self.config.is_published:
            classes = np.where(layout.node_class == 0, *self.particle_types)
        return tf.gather(self._embedding, classes)

    def context_features(self, context):
        """Normalised context [B, C], with its normalised logarithm where there is one [B, 2 C]."""
        s = self.statistics
        linear = (context - s.context_mean.astype(np.float32)) / s.context_std.astype(np.float32)
        if s.log_context_mean is None:
            return linear
        mean, std = s.log_context_mean.astype(np.float32), s.log_context_std.astype(np.float32)
        # The floor is far below any positive context; it keeps a zero from becoming infinite.
        return tf.concat([linear, (tf.math.log(tf.maximum(context, 1e-6)) - mean) / std], axis=-1)

    def predict(self, state: SimulatorState, known, context, layout: Layout):
        """Normalised predictions; arguments as of `step`.

        Returns:
          target [B, V, D] (displacement or acceleration over its statistics), and the force over
          its statistics [B, F] (mean over the nodes' decoded ones, Haeri & Skonieczny 2021) or
          None.
        """
        target, force = self._decoded(state, known, context, layout)
        return self._of_height(target, layout), force

    def _decoded(self, state, known, context, layout):
        """The network's target [B, V, D] and force [B, F] or None."""
        nodes, edges = self.features(state, known, context, layout)
        decoded = self.network(nodes, edges, layout.senders, layout.receivers, layout.edge_gates)
        force = tf.reduce_mean(decoded[..., self.dim :], axis=1) if self.scene.has_force else None
        return decoded[..., : self.dim], force

    def rate(self, known):
        """Displacement of the body in the coming frame over its mean in training, [B, 1, 1]; 1
        where motion is not counted per displacement of the body."""
        if not self.rate_scaled:
            return tf.ones([1, 1, 1])
        # q = sqrt(mean over the R particles of |v|^2) / its mean in training, at least RATE_FLOOR.
        speed = tf.sqrt(tf.reduce_mean(tf.reduce_sum(known.velocity**2, -1), -1))
        speed /= np.float32(self.statistics.body_speed[0])
        return tf.maximum(speed, RATE_FLOOR)[:, None, None]

    def normalized_target(self, next_velocity, state: SimulatorState, known, layout: Layout):
        """What `predict` should have said, [B, V, D], for the true next velocity [B, V, D].

        The velocities of `state` may carry noise: an acceleration target then corrects it, as in
        Sanchez-Gonzalez et al. 2020. Where places are predicted, `next_velocity` is what leads from
        the offset of `state`, noise and all, to the true one.
        """
        # y = ((v' - v_base) / q - mean) / std: the inverse of what `step` does with a prediction.
        target = self._of_height(next_velocity, layout) - self._base_velocity(state, known, layout)
        return (target / self.rate(known) - layout.target_mean) / layout.target_std

    def step(self, state: SimulatorState, known, context, layout: Layout):
        """One frame.

        Args:
          state: of B graphs.
          known: `KnownMotion` of the coming frame where the rigid motion is prescribed or driven,
            else None.
          context: float32 [B, C] or None.
          layout: of the graphs.

        Returns:
          the next `SimulatorState` and the force on the body [B, F], N, or None.
        """
        seen = known if self.knows_next_frame else None
        target, force = self.predict(state, seen, context, layout)
        # v' = rate (std y + mean), plus v where an acceleration is predicted, and start - x where a
        # place is; x' = x + v'.
        velocity = (target * layout.target_std + layout.target_mean) * self.rate(known)
        velocity += self._base_velocity(state, known, layout)
        offset = state.offset + velocity
        if self.scene.rigid_motion.is_known:
            velocity, offset = self._place_body(state, velocity, offset, known, layout)
        history = tf.concat([state.velocity[:, :, 1:], velocity[:, :, None]], axis=2)
        if force is not None:
            # F = std y + mean, times the share in [0, 1] that a body may show so far from the soil.
            force = force * self.force_std + self.force_mean
            if layout.contact is not None:
                n = layout.n_rigid
                body = known.offset + layout.origin[:n].astype(np.float32)
                force *= layout.contact.share(body, state.offset[:, n:])[:, None]
        return SimulatorState(offset, history), force

    def _base_velocity(self, state, known, layout):
        """The velocity that the prediction is added to: none (order 1), the last one (order 2), or
        what leads back to the start of the run (order 0)."""
        last = self._of_height(state.velocity[:, :, -1], layout)
        # Order 2: v' = v + a, with the last velocity. Order 1: v' itself. Order 0: x' = x_0 + y, so
        # v' = (x_0 - x) + y with the start x_0 of the run.
        order = np.where(layout.node_class == 0, self.config.rigid_order, self.config.mode_order)
        base = last * (order == 2).astype(np.float32)[:, None]
        if self.config.mode_order:
            return base
        n = layout.n_rigid
        return tf.concat([base[:, :n], known.start - state.offset[:, n:]], axis=1)

    def _of_height(self, velocity, layout):
        """Replaces each rigid particle's values [B, V, D] by the body's mean where only the height
        is predicted."""
        if self.scene.rigid_motion != RigidMotion.DRIVEN:
            return velocity
        n = layout.n_rigid
        body = tf.reduce_mean(velocity[:, :n], axis=1, keepdims=True)
        return tf.concat([tf.tile(body, [1, n, 1]), velocity[:, n:]], axis=1)

    def _place_body(self, state, velocity, offset, known, layout):
        n, body_offset, body_velocity = layout.n_rigid, known.offset, known.velocity
        if self.scene.rigid_motion == RigidMotion.DRIVEN:
            up = up_vector(self.dim, self.scene.up_axis)
            # Given without its height: the mean of the particles so far, and the predicted change.
            height = tf.reduce_mean(state.offset[:, :n], axis=1, keepdims=True)
            change = velocity[:, :1]
            body_offset = body_offset + (height + change) * up
            body_velocity = body_velocity + change * up
        return (
            tf.concat([body_velocity, velocity[:, n:]], axis=1),
            tf.concat([body_offset, offset[:, n:]], axis=1),
        )


def initial_state(offset, velocity) -> SimulatorState:
    """State after H frames, of offsets [B, H, V, D] and velocities [B, H - 1, V, D] of the frames
    1 .. H - 1."""
    if offset.shape[1] != INPUT_SEQUENCE_LENGTH or velocity.shape[1] != INPUT_SEQUENCE_LENGTH - 1:
        raise ValueError(
            f'a history has {INPUT_SEQUENCE_LENGTH} frames, got {offset.shape} and {velocity.shape}'
        )
    return SimulatorState(
        tf.cast(offset[:, -1], tf.float32),
        tf.cast(tf.transpose(velocity, [0, 2, 1, 3]), tf.float32),
    )
