"""One frame of a `LearnedSimulator`, with its statistics and constants folded into the weights.

The same function as `LearnedSimulator.step`. Features that are constant (embedding, means of the
statistics) become a bias per node, features of the given motion are computed ahead, and a driven
body, of which only the height is unknown, adds one row for all of its particles.
"""

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import tensorflow as tf

from learning_to_simulate.body_height import height_of, up_vector
from learning_to_simulate.compiled.folded_network import (
    MODES,
    RIGID,
    EdgeBlock,
    FoldedNetwork,
    Linear,
    edge_blocks,
)
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace import features
from learning_to_simulate.subspace.learned_simulator import Layout, LearnedSimulator, SimulatorState
from learning_to_simulate.subspace.rigid_body import KnownMotion


class MovingState(NamedTuple):
    """What a frame changes, and only as much history as the model reads.

    Attributes:
      modes: float32 [B, r, D] offset, m.
      modes_velocity: float32 [B, r, K, D], last K velocities, m/frame.
      body: predicted: float32 [B, R, D] offset; driven: [B, 1] mean height; else [B, 0].
      body_velocity: predicted: float32 [B, R, K, D]; driven: [B, K] of the height; else [B, 0].
    """

    modes: tf.Tensor
    modes_velocity: tf.Tensor
    body: tf.Tensor
    body_velocity: tf.Tensor


class Given(NamedTuple):
    """What is given of one frame, or None in a field that the scene lacks.

    Attributes:
      offset: float32 [B, R, D], given part of the body's offset before the frame.
      velocity: float32 [B, R, K, D], of its last K velocities.
      coming: float32 [B, R, D], of its velocity in the frame.
      context: float32 [B, C].
      path: float32 [B, P], see `KnownMotion`.
      start: float32 [B, r, D], likewise; the same in all frames.
    """

    offset: tf.Tensor | None
    velocity: tf.Tensor | None
    coming: tf.Tensor | None
    context: tf.Tensor | None
    path: tf.Tensor | None = None
    start: tf.Tensor | None = None


class FoldedSimulator:
    """One frame of B graphs, for one layout.

    Constructing it folds the variables as they are: inside a compiled function this is done once
    per call of the function.

    Args:
      simulator: the model.
      layout: of the graphs.
      dense: whether blocks of all pairs are computed without gathers.
      frozen: whether the weights of now become constants of the compiled function.
    """

    def __init__(
        self,
        simulator: LearnedSimulator,
        layout: Layout,
        dense: bool = True,
        frozen: bool = False,
    ):
        if not simulator.config.has_lasting_graph:
            raise ValueError('only a graph network whose edges last can be folded')
        self.simulator, self.layout = simulator, layout
        self.motion = simulator.scene.rigid_motion
        config, scene = simulator.config, simulator.scene
        free = self.motion in (RigidMotion.DRIVEN, RigidMotion.PREDICTED)
        self._decodes_body = layout.n_rigid > 0 and (free or scene.has_force)
        weights = simulator.network.weights()
        if frozen:
            with tf.init_scope():
                weights = tf.nest.map_structure(lambda v: None if v is None else v.numpy(), weights)
        self._network = FoldedNetwork(
            weights,
            edge_blocks(layout, not config.is_published, dense),
            {MODES, RIGID} if self._decodes_body else {MODES},
        )
        self._of_edge = Linear(*weights.edge_encoder.layers[0])
        self._nodes = {RIGID: slice(0, layout.n_rigid), MODES: slice(layout.n_rigid, None)}
        self._rows, bias = self._split_first_layer(*weights.node_encoder.layers[0])
        self._bias = self._constant_part(bias)
        w, b = self._network.decoder_last
        self._target = Linear(w[:, : simulator.dim], b[: simulator.dim])
        if scene.has_force:
            std, mean = simulator.load_std, simulator.load_mean
            self._load = Linear(w[:, simulator.dim :] * std, b[simulator.dim :] * std + mean)

    @staticmethod
    def history(simulator) -> tuple[int, int]:
        """How many last velocities of modes and body the model reads: K of both."""
        config, scene = simulator.config, simulator.scene
        count = config.velocity_inputs
        if scene.rigid_motion == RigidMotion.DRIVEN and not config.is_published:
            return count, INPUT_SEQUENCE_LENGTH - 1
        return count, count

    def _split_first_layer(self, w, b):
        """Rows of the node encoder's first layer by the feature that they act on."""
        sizes = {f.name: f.width(self.simulator) for f in features.of(self.simulator)}
        return dict(zip(sizes, tf.split(w, list(sizes.values())), strict=True)), b

    def _constant_part(self, bias):
        """Bias of the first layer by kind, [n, L]: embedding and means of the statistics."""
        layout, rows = self.layout, self._rows
        count = self.simulator.config.velocity_inputs
        shift = -layout.velocity_mean / layout.velocity_std
        constant = bias + tf.matmul(self.simulator.node_embedding(layout), rows['embedding'])
        constant += tf.matmul(np.tile(shift, (1, count)), rows['velocity'])
        if count > 1 and 'acceleration' in rows:
            shift_a = -layout.acceleration_mean / layout.acceleration_std
            constant += tf.matmul(np.tile(shift_a, (1, count - 1)), rows['acceleration'])
        parts = {kind: constant[nodes] for kind, nodes in self._nodes.items()}
        if 'coming' in rows:
            parts[RIGID] += tf.matmul(shift[self._nodes[RIGID]], rows['coming'])
        return parts

    def predict(self, do, given: Given, state: MovingState):
        """Network outputs of one frame.

        Args:
          do: the pass.
          given: of the frame; in an `AheadPass` of all frames.
          state: before the frame; None fields in an `AheadPass`.

        Returns:
          decoder outputs by name: 'modes' [B, r, D] normalised target, 'body' likewise ([B, 1] of
          the height where it is driven), 'load' [B, F] in N and N m (`loads`), 'rate' [B, 1, 1];
          parts that the scene lacks are absent. In an `AheadPass` the values mean nothing.
        """
        simulator, scene = self.simulator, self.simulator.scene
        rate = tf.ones([1, 1, 1])
        if simulator.rate_scaled:
            rate = do('rate', lambda v: simulator.rate(KnownMotion(None, v)), given.coming)
        body = (given.offset, given.velocity)
        if self.motion == RigidMotion.PREDICTED:
            body = (state.body, state.body_velocity)
        first, motions = {}, {MODES: (state.modes, state.modes_velocity), RIGID: body}
        for kind in self._network.alive[0]:
            bias = self._biased(do, kind, rate, given)
            first[kind] = do(f'{kind}: first', self._first(kind), bias, rate, *motions[kind])
        offsets = {kind: offset for kind, (offset, _) in motions.items()}
        if self.motion == RigidMotion.DRIVEN:
            heights = (state.body, state.body_velocity)
            row = do('height', self._height_row, rate, *heights)
            first[RIGID] = do('rigid: first with height', tf.add, first[RIGID], row)
            lift = do('lift', self._lift, state.body)
            offsets[RIGID] = do('rigid: offset', tf.add, given.offset, lift)
        edges = {}
        for block in self._network.blocks[0]:
            ends = [offsets[block.receiver], offsets[block.sender]]
            if block.receiver == block.sender == RIGID and self.motion == RigidMotion.DRIVEN:
                ends = [given.offset] * 2  # the height cancels
            edges[block.name] = do(f'{block.name}: first', self._first_of_edges(block), *ends)
        hidden = self._network(do, first, edges)
        outputs = {'modes': do('modes: target', self._target, hidden[MODES]), 'rate': rate}
        if self.motion == RigidMotion.PREDICTED:
            outputs['body'] = do('rigid: target', self._target, hidden[RIGID])
        if self.motion == RigidMotion.DRIVEN:
            outputs['body'] = do('rigid: target of the height', self._height_target, hidden[RIGID])
        if scene.has_force:
            sums = [
                do(f'{kind}: load', self._load_part, hidden[kind])
                for kind in (MODES, RIGID)
                if kind in hidden
            ]
            outputs['load'] = do('load', lambda *x: tf.add_n(x) + self._load.b, *sums)
            if self.layout.contact is not None:
                outputs['load'] = do(
                    'load: contact', self._of_contact,
                    outputs['load'], given.offset, given.coming, state.modes,
                )  # fmt: skip
        return outputs

    def _biased(self, do, kind, rate, given):
        """Part of the first layer that no state enters, [N, n, L] or, if constant, [1, n, L]."""
        simulator, rows = self.simulator, self._rows
        bias = self._bias[kind][None]
        parts = []
        if 'rate' in rows:
            log = do('rate: logarithm', lambda r: tf.concat([tf.math.log(r), r], -1), rate)
            parts.append(do('rate: first', Linear(rows['rate'], 0.0), log))
        if 'context' in rows:
            of_context = Linear(rows['context'], 0.0)
            parts.append(
                do(
                    'context: first',
                    lambda c: of_context(simulator.context_features(c))[:, None],
                    given.context,
                )
            )
        if 'path' in rows:
            of_path = Linear(tf.concat([rows['path'], rows['start']], 0), 0.0)
            parts.append(do('path: first', of_path, self._path_and_start(given)))
        if 'coming' in rows and kind == RIGID:
            scale = 1.0 / self.layout.velocity_std[self._nodes[RIGID]]
            of_coming = Linear(rows['coming'], 0.0)
            parts.append(
                do(
                    'rigid: coming',
                    lambda v, r: of_coming(v / r * scale),
                    given.coming,
                    rate,
                )
            )
        if not parts:
            return bias
        return do(f'{kind}: bias', lambda *x: sum(x, bias), *parts)

    def _path_and_start(self, given):
        """Values [B, 1, F] of the features of the run so far; None where they are not known."""
        if given.path is None:
            return None
        known = KnownMotion(None, None, given.path, given.start)
        view = SimpleNamespace(known=known, layout=self.layout)
        values = {f.name: f.values for f in features.TABLE}
        return tf.concat([values['path'](view), values['start'](view)], axis=-1)

    def _first(self, kind):
        """First layer of the nodes' own motion, added to its bias."""
        layout, nodes, rows = self.layout, self._nodes[kind], self._rows
        count = self.simulator.config.velocity_inputs
        names = [n for n in ('velocity', 'offset', 'acceleration') if n in rows]
        linear = Linear(tf.concat([rows[n] for n in names], 0), 0.0)

        def first(bias, rate, offset, velocity):
            n, v = offset.shape[1], velocity[:, :, -count:] / rate[..., None]

            def flat(x):
                return tf.reshape(x, [x.shape[0], n, -1])

            values = [flat(v * (1.0 / layout.velocity_std[nodes, None]))]
            if 'offset' in rows:
                values.append(offset * (1.0 / layout.position_std[nodes]))
            if count > 1 and 'offset' in rows:
                change = v[:, :, 1:] - v[:, :, :-1]
                values.append(flat(change * (1.0 / layout.acceleration_std[nodes, None])))
            return bias + linear(tf.concat(values, -1))

        return first

    def _height_row(self, rate, height, change):
        """What the height of a driven body adds to the first layer of its particles: [B, 1, L]."""
        s, layout, up = self.simulator, self.layout, self.simulator.scene.up_axis
        rows, count, dim = self._rows, s.config.velocity_inputs, s.dim
        v = change[:, -count:] / rate[:, 0]
        values, weights = [v / layout.velocity_std[0, up]], [rows['velocity'][up::dim]]
        if 'offset' in rows:
            values.append(height / layout.position_std[0, up])
            weights.append(rows['offset'][up : up + 1])
        if count > 1 and 'offset' in rows:
            values.append((v[:, 1:] - v[:, :-1]) / layout.acceleration_std[0, up])
            weights.append(rows['acceleration'][up::dim])
        if 'height' in rows:
            values += [
                height / np.float32(s.statistics.height_std[0]),
                change / np.float32(s.statistics.height_velocity_std[0]),
            ]
            weights.append(rows['height'])
        row = Linear(tf.concat(weights, 0), 0.0)(tf.concat(values, -1))
        return row[:, None]

    def _lift(self, height):
        return height[:, None] * up_vector(self.simulator.dim, self.simulator.scene.up_axis)

    def _first_of_edges(self, block: EdgeBlock):
        scale = 1.0 / self.layout.edge_std[block.edges]
        shift = self.layout.edge_shift[block.edges]

        def first(of_receiver, of_sender):
            displacement = block.combine(-of_receiver, of_sender) * scale + shift
            square = tf.reduce_sum(displacement**2, axis=-1, keepdims=True)
            length = tf.sqrt(tf.maximum(square, 1e-12))
            return self._of_edge(tf.concat([displacement, length], axis=-1))

        return first

    def _height_target(self, hidden):
        up = self.simulator.scene.up_axis
        column = Linear(self._target.w[:, up : up + 1], self._target.b[up : up + 1])
        return column(tf.reduce_mean(hidden, axis=1))

    def _load_part(self, hidden):
        """Share of a kind of nodes in the mean of the decoded loads, N and N m."""
        return tf.matmul(tf.reduce_sum(hidden, axis=1) / self.layout.n_node, self._load.w)

    def _of_contact(self, load, before, coming, modes):
        """The loads that the body may show where it comes to."""
        body = before + coming + self.layout.origin[self._nodes[RIGID]].astype(np.float32)
        return load * self.layout.contact.share(body, modes)[:, None]

    def advance(self, outputs, state: MovingState, given: Given) -> MovingState:
        """The state after a frame, from `predict`; body velocities in m/frame."""
        config, layout = self.simulator.config, self.layout
        nodes = self._nodes[MODES]
        velocity = outputs['modes'] * layout.target_std[nodes] + layout.target_mean[nodes]
        velocity *= outputs['rate']
        if config.mode_order == 2:
            velocity += state.modes_velocity[:, :, -1]
        elif config.mode_order == 0:
            velocity += given.start - state.modes
        modes = (state.modes + velocity, _pushed(state.modes_velocity, velocity[:, :, None], 2))
        body = state.body, state.body_velocity
        if self.motion == RigidMotion.PREDICTED:
            nodes = self._nodes[RIGID]
            change = outputs['body'] * layout.target_std[nodes] + layout.target_mean[nodes]
            if config.rigid_order == 2:
                change += state.body_velocity[:, :, -1]
            body = state.body + change, _pushed(state.body_velocity, change[:, :, None], 2)
        elif self.motion == RigidMotion.DRIVEN:
            up = self.simulator.scene.up_axis
            change = outputs['body'] * layout.target_std[0, up] + layout.target_mean[0, up]
            change *= outputs['rate'][:, 0]
            if config.rigid_order == 2:
                change += state.body_velocity[:, -1:]
            body = state.body + change, _pushed(state.body_velocity, change, 1)
        return MovingState(*modes, *body)

    def moving(self, state: SimulatorState) -> MovingState:
        """The part of a full state that frames change."""
        n, (count, body_count) = self.layout.n_rigid, self.history(self.simulator)
        modes = (state.offset[:, n:], state.velocity[:, n:, -count:])
        if self.motion == RigidMotion.PREDICTED:
            return MovingState(*modes, state.offset[:, :n], state.velocity[:, :n, -body_count:])
        if self.motion == RigidMotion.DRIVEN:
            up = self.simulator.scene.up_axis
            height = height_of(state.offset[:, :n], up, tf.reduce_mean)[:, None]
            change = height_of(state.velocity[:, :n, -body_count:], up, tf.reduce_mean, axis=1)
            return MovingState(*modes, height, change)
        none = tf.zeros([state.offset.shape[0], 0])
        return MovingState(*modes, none, none)


def _pushed(history, newest, axis):
    """History with its oldest entry dropped and the newest appended."""
    oldest = [slice(None)] * axis + [slice(1, None)]
    return tf.concat([history[tuple(oldest)], newest], axis)
