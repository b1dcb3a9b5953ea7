"""`ParticleSimulator`: one frame of thinned soil; features on the host, network in TensorFlow.

The network is that of `graph_network` with the edges as tensors: messages are summed by receiver,
since a dense incidence matrix of thousands of edges would not pay.
"""

import copy
import dataclasses
from typing import Any

import numpy as np
import sonnet as snt
import tensorflow as tf
from scipy.spatial import cKDTree

from learning_to_simulate.axes import speed_of, without_height
from learning_to_simulate.normalization import Covered, array, floored, ranges
from learning_to_simulate.scene import RigidMotion, Scene
from learning_to_simulate.subspace import graph_network
from learning_to_simulate.subspace.learned_simulator import RATE_FLOOR

NEIGHBOURS = 14  # the radius is the mean distance of the 14th neighbours in the first frames


@dataclasses.dataclass(frozen=True, kw_only=True)
class ParticleStatistics(Covered):
    """Statistics of the training runs; rows are the rigid particles and the soil.

    Attributes:
      body_speed: mean RMS displacement of the rigid particles, m/frame; 1 where none moves.
      velocity_std: m/frame; where motion is counted per displacement of the body, of that ratio
        times `body_speed`. The mean is zero by choice: soil mostly rests.
      height_std: of the acceleration of the body's height, m/frame².
      low, high: box of the soil in the first frames, m: where the walls are.
      position_range: lowest and highest position.
      force_mean, force_std: N, or None.
      context_mean, context_std: or None.
    """

    body_speed: np.ndarray = array('1')
    velocity_std: np.ndarray = array('2 D')
    height_std: np.ndarray = array('1')
    low: np.ndarray = array('D')
    high: np.ndarray = array('D')
    force_mean: np.ndarray | None = array('D', optional=True)
    force_std: np.ndarray | None = array('D', optional=True)
    context_mean: np.ndarray | None = array('C', optional=True)
    context_std: np.ndarray | None = array('C', optional=True)
    position_range: np.ndarray = array('2 2 D')

    def check(self, scene: Scene) -> None:
        """Raises ValueError where a value does not fit the scene, is infinite, or divides by 0."""
        context = len(scene.context_names)
        present = {'force': scene.has_force, 'context': bool(context)}
        self.check_arrays({'D': self.low.size, 'C': context}, present)


def compute_statistics(group, scene: Scene, rate_scaled: bool) -> ParticleStatistics:
    """Statistics of a `RunGroup` of particles; with `rate_scaled` motion is counted per
    displacement of the body: ValueError if none moves."""
    n = group.n_rigid
    velocity = np.diff(group.position, axis=1)
    speeds = speed_of(velocity[:, :, :n]) if n else np.zeros(1)
    if rate_scaled and not speeds.mean() > 0:
        raise ValueError('rate_scaled needs a body that moves in the training runs')
    body_speed = speeds.mean() or 1.0
    if rate_scaled:
        velocity = velocity / np.maximum(speeds / body_speed, RATE_FLOOR)[:, :, None, None]
    height = group.position[:, :, :n, scene.up_axis].mean(axis=-1) if n else np.zeros((1, 3))
    rows = [velocity[:, :, :n], velocity[:, :, n:]] if n else [velocity, velocity]
    stds = [np.sqrt((row**2).mean(axis=(0, 1, 2))) for row in rows]
    soil = group.position[:, 0, n:]
    further = ranges([group], scene)
    body, (low, high) = further['position_range'][:, 0], further['position_range'][:, 1:]
    reached = np.stack([low.min(axis=0), high.max(axis=0)])
    further['position_range'] = np.stack([body, reached], axis=1)
    if group.force is not None:
        spread = max(group.force.std(axis=(0, 1)).max(), 1e-9)
        further |= {'force_mean': group.force.mean(axis=(0, 1)), 'force_std': np.full(3, spread)}
    if group.context is not None:
        context = group.context.reshape(-1, group.context.shape[-1])
        further['context_mean'] = context.mean(axis=0)
        further['context_std'] = np.maximum(context.std(axis=0), 1e-9)
    return ParticleStatistics(
        body_speed=np.array([body_speed]),
        velocity_std=floored(np.stack(stds)),
        height_std=np.maximum(np.diff(height, 2).std(), 1e-9).reshape(1),
        low=soil.min(axis=(0, 1)),
        high=soil.max(axis=(0, 1)),
        **further,
    )


def typical_radius(soil) -> float:
    """Mean distance of the `NEIGHBOURS`-th neighbour among soil particles [N, D], m."""
    count = min(NEIGHBOURS, len(soil) - 1)
    return float(cKDTree(soil).query(soil, count + 1)[0][:, -1].mean())


def neighbour_list(position, radius: float, n_rigid: int):
    """Senders and receivers, int32 [E], of the edges between particles [V, D] within the radius, m,
    both ways; no self-edges, none within the body of the first R particles."""
    pairs = cKDTree(position).query_pairs(radius, output_type='ndarray')
    pairs = pairs[(pairs >= n_rigid).any(axis=1)].astype(np.int32)
    return np.concatenate([pairs[:, 0], pairs[:, 1]]), np.concatenate([pairs[:, 1], pairs[:, 0]])


class ParticleSimulator(snt.Module):
    """One frame of the simulation of thinned soil and a body; ValueError for one whose particles
    are all to be predicted. In its scene `n_modes` counts the soil particles, and
    `connectivity_radius` is that of the graph; `particle_types` are for the record."""

    def __init__(self, scene: Scene, config, statistics, particle_types):
        super().__init__()
        if scene.rigid_motion == RigidMotion.PREDICTED:
            raise ValueError(
                'full_space takes a body whose motion is prescribed or driven, or none'
            )
        self.scene, self.config, self.statistics = scene, config, statistics
        self.particle_types = particle_types
        self.dim = len(statistics.low)
        self.force_size = self.dim if scene.has_force else 0
        self._network = ParticleNetwork(
            config.latent_size,
            config.hidden_layers,
            config.message_passing_steps,
            self.dim + self.force_size,
        )
        shapes = ((None, None), (None, None), (None,), (None,))
        types = (tf.float32, tf.float32, tf.int32, tf.int32)
        # One trace for graphs of any size: edges come and go with every frame.
        self._compiled = tf.function(
            self._network,
            input_signature=[tf.TensorSpec(*spec) for spec in zip(shapes, types)],
            autograph=False,
        )

    def create_variables(self):
        """Makes all variables; as `subspace_model.Model.create_variables`."""
        self._network(*self._one_node())

    def _one_node(self):
        width = self.dim * (self.config.velocity_inputs + 3) + 2 + len(self.scene.context_names)
        ends = tf.constant([0])
        return tf.zeros([1, width]), tf.zeros([1, self.dim + 1]), ends, ends

    def compile(self) -> None:
        """Traces the network now and not in the first frame."""
        self._compiled(*self._one_node())

    def inputs(self, position, velocity, body_velocity, context, n_rigid):
        """Graph and features of one state, in float64 until the last cast.

        Args:
          position: [V, D], m.
          velocity: [H - 1, V, D], m/frame, newest last.
          body_velocity: [R, D], given displacement of the coming frame (see `given_motion`).
          context: [C] or None.
          n_rigid: R.

        Returns:
          nodes float32 [V, F], edges float32 [E, D + 1], senders and receivers int32 [E].
        """
        s, radius = self.statistics, self.scene.connectivity_radius
        n_node = len(position)
        is_rigid = np.arange(n_node) < n_rigid
        rate = self.rate(body_velocity)
        std = rate * np.where(is_rigid[:, None], s.velocity_std[0], s.velocity_std[1])
        history = velocity[-self.config.velocity_inputs :] / std
        to_come = np.zeros_like(position)
        to_come[:n_rigid] = body_velocity / (rate * s.velocity_std[0])
        walls = np.concatenate([position - s.low, s.high - position], axis=1) / radius
        features = [
            np.moveaxis(history, 0, 1).reshape(n_node, -1),
            to_come,
            np.clip(walls, -1.0, 1.0),  # distance to the walls within the radius (SG 2020)
            is_rigid[:, None],
            np.full((n_node, 1), np.log(rate)),
        ]
        if context is not None:
            features.append(np.tile((context - s.context_mean) / s.context_std, (n_node, 1)))
        senders, receivers = neighbour_list(position, radius, n_rigid)
        displacement = (position[senders] - position[receivers]) / radius
        length = np.linalg.norm(displacement, axis=1, keepdims=True)
        return (
            np.concatenate(features, axis=1).astype(np.float32),
            np.concatenate([displacement, length], axis=1).astype(np.float32),
            senders,
            receivers,
        )

    def rate(self, body_velocity) -> float:
        """Given displacement [R, D] of the body in the coming frame over its mean in training; 1
        where motion is not counted per displacement of the body."""
        if not (self.config.rate_scaled and self.scene.rigid_motion.is_known):
            return 1.0
        return float(max(speed_of(body_velocity) / self.statistics.body_speed[0], RATE_FLOOR))

    def given_motion(self, displacement):
        """The given part of the body's true displacement [R, D]: all but its mean height where that
        is predicted."""
        if self.scene.rigid_motion != RigidMotion.DRIVEN:
            return displacement
        return without_height(displacement, self.scene.up_axis)

    def decode(self, nodes, edges, senders, receivers):
        """Normalised values and forces (or None) of each node [V, D]; differentiable."""
        decoded = self._compiled(nodes, edges, senders, receivers)
        return decoded[:, : self.dim], decoded[:, self.dim :] if self.scene.has_force else None

    def step(self, position, velocity, body_displacement, context, n_rigid):
        """One frame on the host; arguments of `inputs`, and the true displacement [R, D] of the
        body in the coming frame, of whose height nothing is used where that is predicted.

        Returns:
          displacement of all particles [V, D] in m, force [D] in N or None, number of edges.
        """
        s = self.statistics
        given = self.given_motion(body_displacement)
        graph = self.inputs(position, velocity, given, context, n_rigid)
        target, forces = (None if x is None else x.numpy() for x in self.decode(*graph))
        displacement = target * s.velocity_std[1] * self.rate(given)
        displacement[:n_rigid] = given
        if self.scene.rigid_motion == RigidMotion.DRIVEN:
            up = self.scene.up_axis
            height = target[:n_rigid, up].mean() * s.height_std[0]
            displacement[:n_rigid, up] += velocity[-1, :n_rigid, up].mean() + height
        force = None
        if forces is not None:
            # Of the rigid particles, on which it acts; of all where there are none.
            force = forces[: n_rigid or None].mean(axis=0) * s.force_std + s.force_mean
        return displacement, force, len(graph[2])


class ParticleStep:
    """Frames of a `method.ParticleModel` for R rigid particles: as `live.stepper.TfStep`, with a
    new graph in every frame; `edges` is the number of edges of the newest one."""

    def __init__(self, model, n_rigid: int):
        self._simulator, self._n, self.edges = model.simulator, n_rigid, 0
        # Of the newest frame and of the coming one: position, velocities, context.
        self._newest: Any = None
        self._proposed: Any = None
        self._simulator.compile()

    def reset(self, history, context) -> None:
        """As of `TfStep`."""
        self._newest = history[-1], np.diff(history, axis=0), context

    def propose(self, body, displacement, context=None):
        """As of `TfStep`; the displacement of the body [R, D] says all (None: there is no body)."""
        position, velocity, held = self._newest
        if displacement is None:
            displacement = np.zeros((0, position.shape[1]))
        context = held if context is None else context
        moved, force, self.edges = self._simulator.step(
            position, velocity, displacement, context, self._n
        )
        after = position + moved
        self._proposed = after, np.concatenate([velocity[1:], moved[None]]), context
        return after, None if force is None else force.astype(np.float32)

    def accept(self) -> None:
        """Takes the frame that was proposed last as the newest one."""
        self._newest = self._proposed

    def clone(self) -> 'ParticleStep':
        """Another run at the same point."""
        return copy.copy(self)


class ParticleNetwork(snt.Module):
    """Encoder, M residual interaction networks, node decoder (Sanchez-Gonzalez et al. 2020); sizes
    as of `graph_network.EncodeProcessDecode`, whose messages it sums by receiver."""

    def __init__(self, latent_size, hidden_layers, message_passing_steps, output_size, name=None):
        super().__init__(name=name)

        def mlp(name):
            return graph_network.mlp(latent_size, hidden_layers, name=name)

        self._encode_nodes, self._encode_edges = mlp('encode_nodes'), mlp('encode_edges')
        steps = range(message_passing_steps)
        self._edge_models = [mlp(f'edges_{m}') for m in steps]
        self._node_models = [mlp(f'nodes_{m}') for m in steps]
        self._decode = snt.nets.MLP([latent_size] * hidden_layers + [output_size], name='decode')

    def __call__(self, nodes, edges, senders, receivers):
        """float32 [V, output_size] of one graph, or of several side by side: nodes float32 [V, F],
        edges float32 [E, G], senders and receivers int32 [E]."""
        nodes, edges = self._encode_nodes(nodes), self._encode_edges(edges)
        for edge_model, node_model in zip(self._edge_models, self._node_models, strict=True):
            ends = [edges, tf.gather(nodes, receivers), tf.gather(nodes, senders)]
            messages = edge_model(tf.concat(ends, axis=-1))
            received = tf.math.unsorted_segment_sum(messages, receivers, tf.shape(nodes)[0])
            nodes += node_model(tf.concat([received, nodes], axis=-1))
            edges += messages
        return self._decode(nodes)
