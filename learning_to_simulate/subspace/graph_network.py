"""`EncodeProcessDecode`: the graph network (Sanchez-Gonzalez et al. 2020, section 3), Sonnet 2 +
graph_nets.

The only file that touches graph_nets, so that its layers can be replaced in one place.
"""

from typing import NamedTuple

import graph_nets as gn
import numpy as np
import sonnet as snt
import tensorflow as tf


class MlpWeights(NamedTuple):
    """Variables of one MLP."""

    layers: tuple  # (w [in, out], b [out]) of each linear layer, the last one without ReLU
    scale: tf.Variable | None  # of the LayerNorm behind it, [out]; None for the decoder
    offset: tf.Variable | None


class NetworkWeights(NamedTuple):
    """Variables of the whole network by their role."""

    node_encoder: MlpWeights
    edge_encoder: MlpWeights
    # Per message-passing step (edge model, node model); the first layer of an edge model acts on
    # [edge, receiver, sender], that of a node model on [received, node].
    processors: tuple
    decoder: MlpWeights


def _weights_of(model) -> MlpWeights:
    linear = [m for m in model.submodules if isinstance(m, snt.Linear)]
    norms = [m for m in model.submodules if isinstance(m, snt.LayerNorm)]
    layers = tuple((m.w, m.b) for m in linear)
    return MlpWeights(layers, *((norms[0].scale, norms[0].offset) if norms else (None, None)))


def mlp(width, hidden_layers, output_size=None, name='mlp'):
    """`hidden_layers` ReLU layers of `width`, then a linear layer; LayerNorm unless it is the
    decoder."""
    layers = [snt.nets.MLP([width] * hidden_layers + [output_size or width], name=name)]
    if output_size is None:
        layers.append(snt.LayerNorm(axis=-1, create_scale=True, create_offset=True))
    return snt.Sequential(layers)


class _EdgeBlock(snt.Module):
    """Messages from edges and their two ends.

    The first layer acts on [edge, receiver, sender]. Its node parts are the same for all edges of a
    node: computed per node and added per edge they give the same sum for a third of the work.
    """

    def __init__(self, make_model, name='edge_block'):
        super().__init__(name=name)
        self._model = make_model()

    @snt.once
    def _create_variables(self, width):
        self._model(tf.zeros([1, 1, width]))

    def __call__(self, edges, nodes, senders, receivers):
        self._create_variables(3 * edges.shape[-1])
        _, layer_norm, first, *rest = self._model.submodules
        of_edge, of_receiver, of_sender = tf.split(first.w, 3)
        # W [e_ij, h_i, h_j] + b = W_e e_ij + W_r h_i + W_s h_j + b of receiver i and sender j.
        hidden = tf.matmul(edges, of_edge) + first.b
        hidden += tf.gather(tf.matmul(nodes, of_receiver), receivers, axis=1)
        hidden += tf.gather(tf.matmul(nodes, of_sender), senders, axis=1)
        for linear in rest:
            hidden = linear(tf.nn.relu(hidden))
        return layer_norm(hidden)


class _InteractionNetwork(snt.Module):
    """One message-passing step with residuals (Battaglia et al. 2016), on B equal graphs: the
    function and the variables of graph_nets' InteractionNetwork."""

    def __init__(self, make_model, name):
        super().__init__(name=name)
        self._edge_block = _EdgeBlock(make_model)
        self._node_block = _NodeBlock(make_model)

    def __call__(self, nodes, edges, senders, receivers, incidence):
        # m_ij = phi_e(e_ij, h_i, h_j); h_i += phi_v(sum or mean over j of m_ij, h_i); e_ij += m_ij.
        messages = self._edge_block(edges, nodes, senders, receivers)
        # A small dense product compiles to faster code than a scatter of a few hundred rows.
        if len(incidence.shape) == 2:
            received = tf.einsum('ve,bel->bvl', incidence, messages)
        else:
            received = tf.matmul(incidence, messages)
        return nodes + self._node_block(received, nodes), edges + messages


class _NodeBlock(snt.Module):
    """Update of the nodes from what they received."""

    def __init__(self, make_model, name='node_block'):
        super().__init__(name=name)
        self._model = make_model()

    def __call__(self, received, nodes):
        return self._model(tf.concat([received, nodes], axis=-1))


class EncodeProcessDecode(snt.Module):
    """Encoder, M residual interaction networks, node decoder; latent size L, ReLU layers per MLP,
    values per node. A node takes the mean of its messages (independent of the number of rigid
    particles), or their sum (as published)."""

    def __init__(
        self, latent_size, hidden_layers, message_passing_steps, output_size, mean_aggregation,
        name=None,
    ):  # fmt: skip
        super().__init__(name=name)

        def make():
            return mlp(latent_size, hidden_layers)

        self._mean_aggregation = mean_aggregation
        self._encoder = gn.modules.GraphIndependent(
            edge_model_fn=make, node_model_fn=make, name='encoder'
        )
        self._processors = [
            _InteractionNetwork(make, name=f'processor_{m}') for m in range(message_passing_steps)
        ]
        self._decoder = mlp(latent_size, hidden_layers, output_size, name='decoder')

    def weights(self) -> NetworkWeights:
        """The variables by role, for code that rewrites the network; they must exist already."""
        edge, node = (m for m in self._encoder.submodules if isinstance(m, snt.Sequential))
        return NetworkWeights(
            _weights_of(node),
            _weights_of(edge),
            tuple(
                (_weights_of(p._edge_block._model), _weights_of(p._node_block._model))
                for p in self._processors
            ),
            _weights_of(self._decoder),
        )

    def __call__(self, nodes, edges, senders, receivers, edge_gates=None):
        """Runs the network on B equal graphs.

        Args:
          nodes: float32 [B, V, F] node features.
          edges: float32 [B, E, G] edge features.
          senders, receivers: int32 [E] numpy arrays, the edges of one graph.
          edge_gates: float32 [B or 1, E] in [0, 1], weights of the messages: 0 is as if the edge
            were not there, 1 for all is the same as None.

        Returns:
          float32 [B, V, output_size].
        """
        n_graph, n_node = nodes.shape[:2]
        n_edge = len(senders)
        # [V, E]: 1 where an edge ends at a node. With gates z_ij the sum is of z_ij m_ij, and the
        # mean divides it by the sum of the gates, at least 1.
        incidence = (np.arange(n_node)[:, None] == receivers).astype(np.float32)
        n_received = incidence.sum(axis=1, keepdims=True)
        if edge_gates is not None:
            incidence = incidence * edge_gates[:, None]
            n_received = tf.reduce_sum(incidence, axis=-1, keepdims=True)
        if self._mean_aggregation:
            at_least_one = np.maximum if edge_gates is None else tf.maximum
            incidence = incidence / at_least_one(n_received, 1.0)
        first_node = np.repeat(np.arange(n_graph, dtype=np.int32) * n_node, n_edge)
        # The B graphs lie one behind the other, as graph_nets wants them; edges count on by V.
        graph = gn.graphs.GraphsTuple(
            nodes=tf.reshape(nodes, [n_graph * n_node, nodes.shape[2]]),
            edges=tf.reshape(edges, [n_graph * n_edge, edges.shape[2]]),
            globals=None,
            senders=tf.constant(np.tile(senders, n_graph) + first_node, tf.int32),
            receivers=tf.constant(np.tile(receivers, n_graph) + first_node, tf.int32),
            n_node=tf.fill([n_graph], n_node),
            n_edge=tf.fill([n_graph], n_edge),
        )
        graph = self._encoder(graph)
        # Widths by name: -1 is undefined where there are no nodes or no edges.
        nodes = tf.reshape(graph.nodes, [n_graph, n_node, graph.nodes.shape[-1]])
        edges = tf.reshape(graph.edges, [n_graph, n_edge, graph.edges.shape[-1]])
        for processor in self._processors:
            nodes, edges = processor(nodes, edges, senders, receivers, incidence)
        return self._decoder(nodes)
