"""A trained model in a subspace as the values of `struct lts_model`.

A graph network is folded for one graph: see `fold`. What reaches no output is left out, and what
the first layers do to a node for each of its edges is done once for the node.
"""

import numpy as np
import sonnet as snt
import tensorflow as tf

from learning_to_simulate.live import poses
from learning_to_simulate.native import c_values, fold, library
from learning_to_simulate.rollout_status import NodeRanges
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace import contact, features
from learning_to_simulate.subspace.learned_simulator import RATE_FLOOR

# In the order of `lts.h`.
MOTIONS = (RigidMotion.NONE, RigidMotion.PRESCRIBED, RigidMotion.DRIVEN, RigidMotion.PREDICTED)
EXPORTED_MODELS = ('gns', 'mlp')
LAYER_NORM_EPSILON = 1e-5  # Sonnet's
RIGID, MODES = 0, 1  # kinds of nodes, in the order of the C code
# Inputs of a node that lts_features.c knows, in its order.
_FEATURES = (
    'velocity', 'offset', 'acceleration', 'rate', 'coming', 'height', 'embedding', 'context',
)  # fmt: skip


def refuse(simulator) -> None:
    """Raises ValueError for a model that the C code cannot run, with what C lacks."""
    config = simulator.config
    if config.model not in EXPORTED_MODELS:
        raise ValueError(
            f'model {config.model!r} has no C form; exported are {", ".join(EXPORTED_MODELS)}'
        )
    simulator.scene.check_one_body('the C form')
    if simulator.dim != 3:
        raise ValueError(f'the model has {simulator.dim} axes, the C form has 3')
    names = [feature.name for feature in features.of(simulator)]
    if names != [name for name in _FEATURES if name in names]:
        raise ValueError(f'the model has inputs {names}, the C form knows {list(_FEATURES)}')


def values(model, n_rigid: int, subspace=None, starts=None, rigid_correction: bool = True) -> dict:
    """The fields of `lts_model` for graphs of R rigid particles.

    Args:
      model: `subspace_model.Model`.
      n_rigid: R.
      subspace: `Subspace` that turns modes into particles, or None.
      starts: `live.starts.Starts`, of which those with bodies of R particles and the limit of the
        force are taken, or None.
      rigid_correction: whether a predicted body is kept rigid.

    Raises:
      ValueError: a model that has no C form, a body or a subspace that it does not take.
    """
    simulator = model.simulator
    refuse(simulator)
    layout = model.layout(n_rigid)
    scene, config, s = simulator.scene, simulator.config, simulator.statistics
    motion = scene.rigid_motion
    result = {
        'abi': library.constants()['LTS_ABI'],
        'motion': MOTIONS.index(motion),
        'name': scene.name,
        'context_names': ','.join(scene.context_names),
        'n_rigid': n_rigid,
        'n_modes': scene.n_modes,
        'n_context': len(scene.context_names),
        'up_axis': scene.up_axis,
        'has_force': int(scene.has_force),
        'is_graph': int(config.model == 'gns'),
        'position_inputs': int(not config.is_published),
        'knows_next': int(simulator.knows_next_frame),
        'rate_scaled': int(simulator.rate_scaled),
        'correction': int(rigid_correction and motion == RigidMotion.PREDICTED),
        'velocity_inputs': config.velocity_inputs,
        'mode_order': config.mode_order,
        'rigid_order': config.rigid_order,
        'has_log_context': int(s.log_context_mean is not None),
        'has_height': int(motion == RigidMotion.DRIVEN and not config.is_published),
        'dt': scene.dt,
        'rate_floor': RATE_FLOOR,
        'origin': layout.origin,
        'norm_epsilon': LAYER_NORM_EPSILON,
    }
    for name in ('body_speed', 'height_std', 'height_velocity_std'):
        value = getattr(s, name)
        result[name] = 1.0 if value is None else float(value[0])
    for name in ('position_std', 'velocity_mean', 'velocity_std', 'acceleration_mean',
                 'acceleration_std', 'target_mean', 'target_std'):  # fmt: skip
        result[name] = getattr(s, name)[layout.node_class]
    for name in ('context_mean', 'context_std', 'log_context_mean', 'log_context_std'):
        result[name] = getattr(s, name)
    if layout.contact is not None:
        result |= _contact(layout.contact)
    ranges = NodeRanges(n_rigid, s, scene, None if starts is None else starts.force_limit)
    result |= {
        'bounds': ranges.bounds,
        'start_range': ranges.start_limits,
        'context_range': ranges.context,
        'force_range': ranges.force,
    }
    names = ('given_range', 'given_velocity_range', 'extent_range', 'speed_range')
    result |= dict(zip(names, ranges.motion or ()))
    result |= network(simulator, layout)
    if subspace is not None:
        result |= _particles(model.fitting_subspace(subspace), layout.origin[n_rigid:])
    found = [] if starts is None else _starts(starts, n_rigid, scene.n_modes)
    result |= {'n_start': len(found), 'starts': found}
    return result | {'digest': c_values.digest(result)}


def _contact(reader):
    return {
        'n_place': len(reader.places),
        'way_axis': reader.axis,
        'clear': reader.clear,
        'clear_ramp': contact.RAMP,
        'clear_slope': contact.SLOPE,
        'places': reader.places,
        'place_heights': reader.heights,
        'place_weights': np.moveaxis(reader.weights, -1, 0),
    }


def _starts(starts, n_rigid, n_modes):
    """Soil at rest, body and context of the starts of bodies of R particles."""
    context = np.zeros((len(starts), 0)) if starts.context is None else starts.context
    return [
        {
            'modes': starts.modes[i][:n_modes],
            'points': poses.placed(starts.body[i][kept], starts.pose[i]),
            'context': context[i],
        }
        for i, kept in enumerate(starts.kept)
        if len(kept) == n_rigid
    ]


def _particles(subspace, origin):
    """The subspace for offsets from the modes' origin, particles side by side."""
    panel = library.constants()['LTS_PANEL']
    mean = np.broadcast_to(subspace.mean, (subspace.n_soil, 3)) + subspace.components @ origin
    more = ((0, 0), (0, -subspace.n_soil % panel))
    return {
        'n_soil': subspace.n_soil,
        'components': np.pad(subspace.components.T, more).astype(np.float32),
        'mean': np.pad(mean.T, more).astype(np.float32),
    }


def network(simulator, layout) -> dict:
    """The fields of `lts_model` that hold the network, for one graph."""
    if simulator.config.model == 'gns':
        return _Graph(simulator, layout).values()
    return _whole_state(simulator)


def _numpy(weights):
    return tf.nest.map_structure(
        lambda v: None if v is None else np.asarray(v.numpy(), np.float64), weights
    )


class _Graph:
    """Folds a graph network for one layout; what reaches no output is left out."""

    def __init__(self, simulator, layout):
        self._simulator, self._layout = simulator, layout
        self._weights = weights = _numpy(simulator.network.weights())
        self._n_step = len(weights.processors)
        scene, n = simulator.scene, layout.n_rigid
        free = scene.rigid_motion in (RigidMotion.DRIVEN, RigidMotion.PREDICTED)
        into = np.where(layout.receivers < n, RIGID, MODES)
        out_of = np.where(layout.senders < n, RIGID, MODES)
        # Backwards from the outputs: which kinds of nodes a step must leave behind.
        alive = [{MODES, RIGID} if n and (free or scene.has_force) else {MODES}]
        for _ in range(self._n_step):
            needed = alive[0] | {int(k) for k in out_of[np.isin(into, list(alive[0]))]}
            alive.insert(0, needed)
        self._alive = alive
        # Edges into the modes are needed in every step, those into the body in the first ones.
        used = np.flatnonzero(np.isin(into, list(alive[1])))
        self._edges = used[np.argsort(into[used] == RIGID, kind='stable')]
        self._into, self._out_of = into[self._edges], out_of[self._edges]
        self._edge_models = [fold.Mlp(edge) for edge, _ in weights.processors]
        self._node_models = [fold.Mlp(node) for _, node in weights.processors]
        self._node_encoder = fold.Mlp(weights.node_encoder)
        self._edge_encoder = fold.Mlp(weights.edge_encoder)
        self._decoder = list(weights.decoder.layers)

    def values(self):
        layout, config, scene = self._layout, self._simulator.config, self._simulator.scene
        first, bias = self._first_layer()
        edges = self._edges
        last = [self._decoder[-1]]
        if scene.has_force:
            s, (w, b) = self._simulator.statistics, last[0]
            last = [
                (w[:, :3], b[:3]),
                (w[:, 3:] * s.force_std, b[3:] * s.force_std + s.force_mean),
            ]
        of_edge = [self._edge_first(0)]
        if self._n_step > 1:
            of_edge.append(self._edge_encoder.identity())
        return {
            'n_edge': len(edges),
            'latent': config.latent_size,
            'n_feature': first.shape[0],
            'n_step': self._n_step,
            'senders': layout.senders[edges],
            'receivers': layout.receivers[edges],
            'edge_scale': 1.0 / layout.edge_std[edges],
            'edge_shift': layout.edge_shift[edges],
            'node_bias': np.pad(bias, ((0, 0), (0, -bias.shape[1] % 16))),
            'mean_aggregation': int(not config.is_published),
            'n_decoder_hidden': len(self._decoder) - 2,
            'node_first': fold.dense(first),
            'edge_first': fold.dense(*self._edge_encoder.first),
            'node_encoder': self._node_encoder.tail(),
            'edge_encoder': self._edge_encoder.tail(),
            'edge_out': self._edge_encoder.before(*fold.side_by_side(of_edge)),
            'steps': [self._step(m) for m in range(self._n_step)],
            'decoder_hidden': [fold.dense(*layer) for layer in self._decoder[1:-1]],
            'decoder_last': fold.dense(*(np.concatenate(x, -1) for x in zip(*last))),
        }

    def _first_layer(self):
        """First layer of the node encoder without the embedding [F, L], and its bias [V, L]."""
        simulator, (w, b) = self._simulator, self._node_encoder.first
        of_nodes = np.asarray(simulator.node_embedding(self._layout), np.float64)
        # The context alone comes behind the embedding, with its logarithm where there is one.
        n_context = len(simulator.scene.context_names)
        n_context *= 1 if simulator.statistics.log_context_mean is None else 2
        embedding = slice(len(w) - n_context - of_nodes.shape[1], len(w) - n_context)
        return np.delete(w, embedding, axis=0), of_nodes @ w[embedding] + b

    def _edge_first(self, m):
        """Share of the edge's latent in the first layer of edge model m."""
        w, b = self._edge_models[m].first
        return np.split(w, 3)[0], b

    def _step(self, m):
        last = m + 1 == self._n_step
        edge, node = self._edge_models[m], self._node_models[m]
        result = {
            'n_edge': int(np.isin(self._into, list(self._alive[m + 1])).sum()),
            'has_rigid': int(RIGID in self._alive[m + 1]),
            'edge': edge.tail(),
            'node': node.tail(),
            'received': edge.before_sum(np.split(node.first[0], 2)[0]),
            'columns': [self._columns(m, kind) for kind in (RIGID, MODES)],
        }
        if last:
            w = self._decoder[0][0]
            return result | {'change': node.before(w, np.zeros(w.shape[1]))}
        return result | {
            'change': node.before(*node.identity()),
            'message': edge.before(*edge.identity()),
            'next_edge': fold.dense(*self._edge_first(m + 1)),
        }

    def _columns(self, m, kind):
        """What is needed of the latents of a kind before step m."""
        (edge_w, _), (node_w, node_b) = self._edge_models[m].first, self._node_models[m].first
        none, last = np.zeros_like(node_b), m + 1 == self._n_step
        used = np.isin(self._into, list(self._alive[m + 1]))
        parts = {}
        if kind in self._into[used]:
            parts['receive'] = np.split(edge_w, 3)[1], none
        if kind in self._out_of[used]:
            parts['send'] = np.split(edge_w, 3)[2], none
        if kind in self._alive[m + 1]:
            parts['update'] = np.split(node_w, 2)[1], node_b
            if last:
                parts['decode'] = self._decoder[0]
        width = -(-len(node_b) // 16) * 16
        columns = {name: -1 for name in ('receive', 'send', 'update', 'decode', 'latent')}
        columns |= {name: i * width for i, name in enumerate(parts)}
        columns['total'] = len(parts) * width
        keep = not last and kind in self._alive[m + 1]
        if keep:
            columns |= {'latent': columns['total'], 'total': columns['total'] + width}
        if not parts:
            return columns
        if m == 0:
            encoder = self._node_encoder
            if keep:
                parts['latent'] = encoder.identity()
            return columns | {'of': encoder.before(*fold.side_by_side(parts.values()))}
        return columns | {'of': {'a': fold.dense(*fold.side_by_side(parts.values()))}}


def _whole_state(simulator):
    """`StateMLP`: ReLU layers, LayerNorm of the last one, and a linear output."""
    network = simulator.network
    linear = [m for m in network.submodules if isinstance(m, snt.Linear)]
    linear.sort(key=lambda m: m.name == 'output')  # submodules come by depth, not in their order
    (norm,) = (m for m in network.submodules if isinstance(m, snt.LayerNorm))
    *hidden, (w, b) = _numpy([(m.w, m.b) for m in linear])
    scale, offset = _numpy((norm.scale, norm.offset))
    # The mean that LayerNorm subtracts is subtracted in the weights behind it.
    through = scale[:, None] * w
    a, o = through - through.mean(axis=0), offset @ w + b
    if simulator.scene.has_force:
        s = simulator.statistics
        a[:, -3:] *= s.force_std
        o[-3:] = o[-3:] * s.force_std + s.force_mean
    out = fold.dense(a)
    return {
        'n_input': hidden[0][0].shape[0],
        'n_whole_hidden': len(hidden),
        'whole_hidden': [fold.dense(*layer) for layer in hidden],
        'whole_out': {'a': out, 'o': np.pad(o, (0, out['columns'] - len(o))).astype(np.float32)},
    }
