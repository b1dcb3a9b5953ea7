"""The way of the original code, for timing only: graph_nets as it comes, edges made in every step.

A `py_function` lists all pairs of nodes in Python for every graph and step, and the network is
graph_nets' GraphIndependent and InteractionNetwork on them, not compiled by XLA, as in the code
of Sanchez-Gonzalez et al. 2020 and Haeri & Skonieczny 2021. The published fully connected code
appends pair by pair to numpy arrays (`appended_pairs`); whoever writes it straightforwardly has
numpy make them at once (`numpy_pairs`). Weights are random: they do not change the time.
"""

import graph_nets as gn
import numpy as np
import sonnet as snt
import tensorflow as tf

RADIUS = 0.025  # m, scales edge features
EMBEDDING = 16


def _mlp(width, output_size=None):
    layers = [snt.nets.MLP([width, width, output_size or width])]
    if output_size is None:
        layers.append(snt.LayerNorm(axis=-1, create_scale=True, create_offset=True))
    return snt.Sequential(layers)


def appended_pairs(n_node: int):
    """Senders and receivers [V²] of a graph of V nodes, self-edges included, as the published code
    lists them (Haeri & Skonieczny 2021)."""
    senders, receivers = np.zeros(0, np.int32), np.zeros(0, np.int32)
    for i in range(n_node):
        for j in range(n_node):
            senders, receivers = np.append(senders, j), np.append(receivers, i)
    return senders, receivers


def numpy_pairs(n_node: int):
    """The same senders and receivers [V²] at once."""
    index = np.arange(n_node)
    return np.tile(index, n_node), np.repeat(index, n_node)


def _batch_of(pairs):
    """Pairs of a batch of graphs, for a `py_function`."""

    def of_batch(sizes):
        first, found = 0, []
        for n in sizes.numpy():
            found.append(np.stack(pairs(n)) + first)
            first += n
        return np.concatenate(found, axis=1).astype(np.int32)

    return of_batch


class OriginalNetwork(snt.Module):
    """Fully connected encode-process-decode network on B graphs of V nodes.

    Args:
      latent_size: L.
      steps: M.
      pairs: how the pairs of a graph are listed, `appended_pairs` or `numpy_pairs`.
    """

    def __init__(self, latent_size: int = 128, steps: int = 1, pairs=appended_pairs, name=None):
        super().__init__(name=name)
        self._pairs = _batch_of(pairs)

        def make():
            return _mlp(latent_size)

        self._embedding = tf.Variable(tf.random.normal([9, EMBEDDING]), name='embedding')
        self._encoder = gn.modules.GraphIndependent(edge_model_fn=make, node_model_fn=make)
        self._processors = [gn.modules.InteractionNetwork(make, make) for _ in range(steps)]
        self._decoder = _mlp(latent_size, 6)

    def __call__(self, history, types):
        """Decoded values of every node.

        Args:
          history: float32 [B, H, V, D] positions, m.
          types: int32 [V].

        Returns:
          float32 [B, V, 6], acceleration and force.
        """
        n_graph, _, n_node, dim = history.shape
        sizes = tf.fill([n_graph], n_node)
        pairs = tf.py_function(self._pairs, [sizes], tf.int32)
        pairs.set_shape([2, None])
        senders, receivers = pairs[0], pairs[1]
        last = tf.reshape(history[:, -1], [-1, dim])
        velocities = tf.transpose(history[:, 1:] - history[:, :-1], [0, 2, 1, 3])
        nodes = tf.concat(
            [
                tf.reshape(velocities, [n_graph * n_node, -1]),
                tf.tile(tf.gather(self._embedding, types), [n_graph, 1]),
            ],
            axis=-1,
        )
        ends = (tf.gather(last, senders) - tf.gather(last, receivers)) / RADIUS
        edges = tf.concat([ends, tf.norm(ends, axis=-1, keepdims=True)], axis=-1)
        graph = gn.graphs.GraphsTuple(
            nodes, edges, receivers, senders, None, sizes, tf.fill([n_graph], n_node * n_node)
        )
        graph = self._encoder(graph)
        for processor in self._processors:
            before = graph
            graph = processor(graph)
            graph = graph.replace(
                nodes=graph.nodes + before.nodes, edges=graph.edges + before.edges
            )
        return tf.reshape(self._decoder(graph.nodes), [n_graph, n_node, -1])


def original_rollout(network: OriginalNetwork, history, types, body, n_frame: int):
    """A rollout function of the original kind: `() -> positions [n_frame, B, V, D]`.

    Args:
      network: the network.
      history: float32 [B, H, V, D].
      types: int32 [V].
      body: float32 [n_frame, B, R, D], the prescribed particles.
      n_frame: number of frames.
    """
    n_rigid = body.shape[2]
    history, body = tf.constant(history, tf.float32), tf.constant(body, tf.float32)

    @tf.function(autograph=False)
    def run():
        def step(k, window, written):
            acceleration = 1e-6 * network(window, types)[..., :3]
            moved = 2 * window[:, -1] - window[:, -2] + acceleration
            position = tf.concat([body[k], moved[:, n_rigid:]], axis=1)
            window = tf.concat([window[:, 1:], position[:, None]], axis=1)
            return k + 1, window, written.write(k, position)

        written = tf.TensorArray(tf.float32, n_frame)
        return tf.while_loop(
            lambda k, *_: k < n_frame, step, (0, history, written), maximum_iterations=n_frame
        )[2].stack()

    return run
