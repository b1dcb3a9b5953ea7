"""The inputs of a node: one table, read by the graph network and the whole-state networks.

A feature has a name, the nodes that have it and its values; which features a model has,
and in which order they meet the rows of the first layer, is decided here and nowhere else. A new
input is an entry of `TABLE` and, where it is to be exported, a few lines of `lts_features.c`.
"""

from collections.abc import Callable
from typing import NamedTuple

import tensorflow as tf

from learning_to_simulate.scene import RigidMotion

EMBEDDING_SIZE = 16  # Sanchez-Gonzalez et al. 2020
START_MODES = 8  # of the bed at the start of a run: more would be learned by heart
# Who has a feature: every node, the rigid particles (a value each, or one for all), or the scene.
NODES, RIGID, SCENE = 'nodes', 'rigid', 'scene'


class Feature(NamedTuple):
    name: str  # of its rows in the first layer
    at: str  # `NODES`, `RIGID` or `SCENE`
    is_present: Callable  # called with the simulator
    values: Callable  # [B or 1, n, width], called with a `View`


class View:
    """What features are made of: the state (`SimulatorState`), the `KnownMotion` of the coming
    frame and the context float32 [B, C] (or None) of B graphs of a layout."""

    def __init__(self, simulator, state, known, context, layout):
        self.simulator, self.state, self.known = simulator, state, known
        self.context, self.layout = context, layout
        # Soil at these speeds is nearly rate-independent: motion is counted per displacement of
        # the body in the coming frame, [B, 1, 1].
        self.rate = simulator.rate(known)
        count = simulator.config.velocity_inputs
        self.history = state.velocity[:, :, -count:] / self.rate[..., None]

    def flat(self, history):
        """[B, V, K, D] -> [B, V, K D], oldest first."""
        return tf.reshape(history, [self.state.offset.shape[0], self.layout.n_node, -1])


def _velocity(view):
    layout = view.layout
    return view.flat((view.history - layout.velocity_mean[:, None]) / layout.velocity_std[:, None])


def _acceleration(view):
    change = view.history[:, :, 1:] - view.history[:, :, :-1]
    change -= view.layout.acceleration_mean[:, None]
    return view.flat(change / view.layout.acceleration_std[:, None])


def _rate(view):
    # What does depend on the rate (inertia, a body at rest) is left to the network.
    return tf.concat([tf.math.log(view.rate), view.rate], -1)


def _coming(view):
    layout, n = view.layout, view.layout.n_rigid
    return (view.known.velocity / view.rate - layout.velocity_mean[:n]) / layout.velocity_std[:n]


def _height(view):
    """Height of a driven body and its H - 1 last changes, [B, 1, H]."""
    n, up, s = view.layout.n_rigid, view.simulator.scene.up_axis, view.simulator.statistics
    height = tf.reduce_mean(view.state.offset[:, :n, up], axis=1)[:, None]
    change = tf.reduce_mean(view.state.velocity[:, :n, :, up], axis=1)
    scales = s.height_std[0].astype('f4'), s.height_velocity_std[0].astype('f4')
    return tf.concat([height / scales[0], change / scales[1]], axis=-1)[:, None]


def _start(view):
    """Offsets of the first modes at the start of the run, [B, 1, F]."""
    n = view.layout.n_rigid
    start = view.known.start / view.layout.position_std[n:]
    return tf.reshape(start[:, :START_MODES], [start.shape[0], 1, -1])


def _has_state(simulator):
    return not simulator.config.reads_path


def _has_positions(simulator):
    return _has_state(simulator) and not simulator.config.is_published


TABLE = (
    Feature('velocity', NODES, _has_state, _velocity),
    Feature(
        'offset', NODES, _has_positions,
        lambda view: view.state.offset / view.layout.position_std,
    ),
    Feature(
        'acceleration', NODES,
        lambda s: _has_positions(s) and s.config.velocity_inputs > 1, _acceleration,
    ),
    Feature('rate', SCENE, lambda s: s.rate_scaled, _rate),
    Feature('coming', RIGID, lambda s: s.knows_next_frame, _coming),
    Feature(
        'height', RIGID,
        lambda s: s.scene.rigid_motion == RigidMotion.DRIVEN and not s.config.is_published, _height,
    ),
    Feature(
        'path', SCENE, lambda s: s.config.reads_path, lambda view: view.known.path[:, None],
    ),
    Feature('start', SCENE, lambda s: s.config.reads_path, _start),
    Feature(
        'embedding', NODES, lambda s: True,
        lambda view: view.simulator.node_embedding(view.layout)[None],
    ),
    Feature(
        'context', SCENE, lambda s: bool(s.scene.context_names),
        lambda view: view.simulator.context_features(view.context)[:, None],
    ),
)  # fmt: skip


def of(simulator) -> tuple[Feature, ...]:
    """The features of a model, in the order of the rows of its first layer."""
    return tuple(feature for feature in TABLE if feature.is_present(simulator))


def at_every_node(feature: Feature, view: View):
    """Values of a feature [B, V, width]; what the rigid particles alone have is zero at the
    modes."""
    layout, values = view.layout, feature.values(view)
    n = layout.n_rigid if feature.at == RIGID else layout.n_node
    values = tf.broadcast_to(values, [view.state.offset.shape[0], n, values.shape[-1]])
    return tf.pad(values, [[0, 0], [0, layout.n_node - n], [0, 0]])
