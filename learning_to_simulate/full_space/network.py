"""`ParticleNetwork`: encode, process, decode on a graph whose edges change with every call.

The network of `graph_network` with the edges as tensors: messages are summed by receiver, since a
dense incidence matrix of thousands of edges would not pay.
"""

import sonnet as snt
import tensorflow as tf


def _mlp(width, hidden_layers, name):
    layers = snt.nets.MLP([width] * (hidden_layers + 1), name=name)
    return snt.Sequential([layers, snt.LayerNorm(axis=-1, create_scale=True, create_offset=True)])


class ParticleNetwork(snt.Module):
    """Encoder, M residual interaction networks, node decoder (Sanchez-Gonzalez et al. 2020).

    Args:
      latent_size: L.
      hidden_layers: ReLU layers per MLP.
      message_passing_steps: M.
      output_size: values per node.
    """

    def __init__(self, latent_size, hidden_layers, message_passing_steps, output_size, name=None):
        super().__init__(name=name)
        self._encode_nodes = _mlp(latent_size, hidden_layers, 'encode_nodes')
        self._encode_edges = _mlp(latent_size, hidden_layers, 'encode_edges')
        self._edge_models, self._node_models = (
            [_mlp(latent_size, hidden_layers, f'{kind}_{m}') for m in range(message_passing_steps)]
            for kind in ('edges', 'nodes')
        )
        self._decode = snt.nets.MLP([latent_size] * hidden_layers + [output_size], name='decode')

    def __call__(self, nodes, edges, senders, receivers):
        """Runs the network on one graph, or on several side by side.

        Args:
          nodes: float32 [V, F].
          edges: float32 [E, G].
          senders, receivers: int32 [E].

        Returns:
          float32 [V, output_size].
        """
        nodes, edges = self._encode_nodes(nodes), self._encode_edges(edges)
        for edge_model, node_model in zip(self._edge_models, self._node_models, strict=True):
            ends = [edges, tf.gather(nodes, receivers), tf.gather(nodes, senders)]
            messages = edge_model(tf.concat(ends, axis=-1))
            received = tf.math.unsorted_segment_sum(messages, receivers, tf.shape(nodes)[0])
            nodes += node_model(tf.concat([received, nodes], axis=-1))
            edges += messages
        return self._decode(nodes)
