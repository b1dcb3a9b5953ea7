"""`EncodeProcessDecode`: the graph network (Sanchez-Gonzalez et al. 2020, section 3), Sonnet 2 +
graph_nets.

The only file that touches graph_nets, so that its layers can be replaced in one place.
"""

import graph_nets as gn
import numpy as np
import sonnet as snt
import tensorflow as tf


def _mlp(width, hidden_layers, output_size=None, name='mlp'):
    """`hidden_layers` ReLU layers of `width`, then a linear layer; LayerNorm unless it is the
    decoder."""
    layers = [snt.nets.MLP([width] * hidden_layers + [output_size or width], name=name)]
    if output_size is None:
        layers.append(snt.LayerNorm(axis=-1, create_scale=True, create_offset=True))
    return snt.Sequential(layers)


class EncodeProcessDecode(snt.Module):
    """Encoder, M residual interaction networks, node decoder.

    Args:
      latent_size: L.
      hidden_layers: ReLU layers per MLP.
      message_passing_steps: M.
      output_size: values per node.
      mean_aggregation: whether a node takes the mean of its messages (independent of the number of
        rigid particles) instead of their sum (as published).
    """

    def __init__(
        self,
        latent_size,
        hidden_layers,
        message_passing_steps,
        output_size,
        mean_aggregation,
        name=None,
    ):
        super().__init__(name=name)

        def make():
            return _mlp(latent_size, hidden_layers)

        reducer = (
            tf.math.unsorted_segment_mean if mean_aggregation else tf.math.unsorted_segment_sum
        )
        self._encoder = gn.modules.GraphIndependent(
            edge_model_fn=make, node_model_fn=make, name='encoder'
        )
        self._processors = [
            gn.modules.InteractionNetwork(
                edge_model_fn=make, node_model_fn=make, reducer=reducer, name=f'processor_{m}'
            )
            for m in range(message_passing_steps)
        ]
        self._decoder = _mlp(latent_size, hidden_layers, output_size, name='decoder')

    def zero_decoder(self):
        """Sets the last layer to zero: every output is 0 until it is trained."""
        for variable in self._decoder.trainable_variables[-2:]:
            variable.assign(tf.zeros_like(variable))

    def __call__(self, nodes, edges, senders, receivers):
        """Runs the network on B equal graphs.

        Args:
          nodes: float32 [B, V, F] node features.
          edges: float32 [B, E, G] edge features.
          senders, receivers: int32 [E] numpy arrays, the edges of one graph.

        Returns:
          float32 [B, V, output_size].
        """
        n_graph, n_node = nodes.shape[:2]
        n_edge = len(senders)
        first_node = np.repeat(np.arange(n_graph, dtype=np.int32) * n_node, n_edge)
        graph = gn.graphs.GraphsTuple(
            nodes=tf.reshape(nodes, [n_graph * n_node, nodes.shape[2]]),
            edges=tf.reshape(edges, [n_graph * n_edge, edges.shape[2]]),
            globals=None,
            senders=tf.constant(np.tile(senders, n_graph) + first_node, tf.int32),
            receivers=tf.constant(np.tile(receivers, n_graph) + first_node, tf.int32),
            n_node=tf.fill([n_graph], n_node),
            n_edge=tf.fill([n_graph], n_edge),
        )
        latent = self._encoder(graph)
        for processor in self._processors:
            update = processor(latent)
            latent = latent.replace(
                nodes=latent.nodes + update.nodes, edges=latent.edges + update.edges
            )
        return tf.reshape(self._decoder(latent.nodes), [n_graph, n_node, -1])
