"""The encode-process-decode network with everything folded that is constant over the frames.

The same function as `graph_network.EncodeProcessDecode`, written for speed:

  - LayerNorm's mean is subtracted in the weights before it, its scale and offset move into the
    weights behind it; what stays is one division per row.
  - An encoder's last layer and the first layers behind it are one product.
  - Edges come in blocks by the kind of their ends (rigid particles, modes). A block that holds all
    pairs needs no gather.
  - The encoder's last layer, message and update of anything that reaches no output do not exist.

Shapes: N graphs (B, or all frames of B graphs at once), n nodes of a kind, E edges of a block.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
import tensorflow as tf

LAYER_NORM_EPSILON = 1e-5  # Sonnet's
RIGID, MODES = 'rigid', 'modes'


@dataclasses.dataclass(frozen=True)
class EdgeBlock:
    """Edges from one kind of nodes to one kind of nodes.

    Attributes:
      receiver, sender: `RIGID` or `MODES`.
      receivers, senders: int [E], indices within their kinds.
      edges: int [E], indices within the layout.
      incidence: float32 [n of the receiver, E], what a node takes of each message.
      complete: whether the block is all pairs, sorted by receiver.
    """

    receiver: str
    sender: str
    receivers: np.ndarray
    senders: np.ndarray
    edges: np.ndarray
    incidence: np.ndarray
    complete: bool

    @property
    def name(self) -> str:
        """Unique within a graph."""
        return f'{self.sender} to {self.receiver}'

    def combine(self, of_receiver, of_sender):
        """Sum of values of both ends of each edge: [N, n, F] twice -> [N, E, F]."""
        if self.complete:
            pairs = of_receiver[:, :, None] + of_sender[:, None]
            return tf.reshape(pairs, [pairs.shape[0], -1, pairs.shape[-1]])
        return tf.gather(of_receiver, self.receivers, axis=1) + tf.gather(
            of_sender, self.senders, axis=1
        )


def edge_blocks(layout, mean_aggregation: bool, dense: bool = True) -> list[EdgeBlock]:
    """The blocks of a layout that hold edges.

    Args:
      layout: `learned_simulator.Layout`.
      mean_aggregation: whether a node takes the mean of its messages, or their sum.
      dense: whether complete blocks may be treated as such.
    """
    n = {RIGID: layout.n_rigid, MODES: layout.n_node - layout.n_rigid}
    first = {RIGID: 0, MODES: layout.n_rigid}
    degree = np.bincount(layout.receivers, minlength=layout.n_node)
    blocks = []
    for receiver in (MODES, RIGID):
        for sender in (RIGID, MODES):
            inside = ((layout.receivers < layout.n_rigid) == (receiver == RIGID)) & (
                (layout.senders < layout.n_rigid) == (sender == RIGID)
            )
            edges = np.flatnonzero(inside)
            if not edges.size:
                continue
            receivers = layout.receivers[edges] - first[receiver]
            senders = layout.senders[edges] - first[sender]
            incidence = (np.arange(n[receiver])[:, None] == receivers).astype(np.float32)
            if mean_aggregation:
                incidence /= np.maximum(degree[layout.receivers[edges]], 1.0)
            # Edges of a layout are sorted by receiver, then sender.
            complete = dense and edges.size == n[receiver] * n[sender]
            blocks.append(
                EdgeBlock(receiver, sender, receivers, senders, edges, incidence, complete)
            )
    return blocks


class Linear(NamedTuple):
    """x w + b."""

    w: tf.Tensor
    b: tf.Tensor

    def __call__(self, x):
        # One product of all rows: XLA would repeat the weights for a batch of products.
        rows = tf.matmul(tf.reshape(x, [-1, x.shape[-1]]), self.w)
        return tf.reshape(rows, [*x.shape[:-1], self.w.shape[1]]) + self.b


class FoldedMlp:
    """An MLP with LayerNorm, from the sum of its first layer on.

    LayerNorm's mean is subtracted in the last layer; what is left of it is `factor`.

    Args:
      weights: `graph_network.MlpWeights`.
    """

    def __init__(self, weights):
        self._hidden = [Linear(*layer) for layer in weights.layers[1:-1]]
        w, b = weights.layers[-1]
        self.last = Linear(w - tf.reduce_mean(w, 1, keepdims=True), b - tf.reduce_mean(b))
        self._scale, self._offset = weights.scale, weights.offset
        self.width = w.shape[1]

    def hidden(self, first):
        """Last hidden layer [..., L] from the sums of the first one."""
        x = tf.nn.relu(first)
        for linear in self._hidden:
            x = tf.nn.relu(linear(x))
        return x

    def factor(self, centred):
        """What LayerNorm multiplies the output of `last` by, [..., 1]."""
        squares, width = centred * centred, self.width
        while width % 2 == 0:  # halves, because a plain sum over a row does not vectorise
            width //= 2
            squares = squares[..., :width] + squares[..., width:]
        length = tf.reduce_sum(squares, axis=-1, keepdims=True)
        return tf.math.rsqrt(length / self.width + LAYER_NORM_EPSILON)

    def restored(self, centred, factor):
        """The output of the MLP."""
        return centred * factor * self._scale + self._offset

    def before(self, linear: Linear) -> Linear:
        """`linear` of the output, as a layer of the centred output times `factor`."""
        return Linear(
            self._scale[:, None] * linear.w,
            tf.linalg.matvec(linear.w, self._offset, transpose_a=True) + linear.b,
        )

    def output_and(self, hidden, linear: Linear, with_output: bool):
        """The output [..., L] (None if unwanted) and `linear` of it, by one product."""
        behind = self.before(linear)
        both = Linear(
            tf.concat([self.last.w, tf.matmul(self.last.w, behind.w)], 1),
            tf.concat([self.last.b, tf.linalg.matvec(behind.w, self.last.b, transpose_a=True)], 0),
        )(hidden)
        centred = both[..., : self.width]
        factor = self.factor(centred)
        result = both[..., self.width :] * factor + behind.b
        return (self.restored(centred, factor) if with_output else None), result


class FoldedNetwork:
    """The network over blocks of edges.

    Args:
      weights: `graph_network.NetworkWeights`.
      blocks: of the graph.
      outputs: the kinds of nodes that must be decoded.
    """

    def __init__(self, weights, blocks: list[EdgeBlock], outputs: set[str]):
        self._node_encoder = FoldedMlp(weights.node_encoder)
        self._edge_encoder = FoldedMlp(weights.edge_encoder)
        self._edge_models = [FoldedMlp(edge) for edge, _ in weights.processors]
        self._node_models = [FoldedMlp(node) for _, node in weights.processors]
        self._processors = weights.processors
        self._decoder = [Linear(*layer) for layer in weights.decoder.layers]
        self.decoder_last = self._decoder[-1]
        # Backwards from the outputs: which kinds a step must leave behind, and by which edges.
        self.alive = [outputs]
        self.blocks: list = []
        for _ in weights.processors:
            self.blocks.insert(0, [b for b in blocks if b.receiver in self.alive[0]])
            self.alive.insert(0, self.alive[0] | {b.sender for b in self.blocks[0]})

    def __call__(self, do, first_nodes: dict, first_edges: dict) -> dict:
        """Runs the network on the sums of the encoders' first layers.

        Args:
          do: `two_pass.AheadPass` or `two_pass.FramePass`.
          first_nodes: by kind, [N, n, L].
          first_edges: by name of block, [N, E, L].

        Returns:
          by kind, the decoder's last hidden layer [N, n, L].
        """
        last = len(self._processors) - 1
        nodes = {
            kind: do(f'{kind}: encoded', self._encode_nodes(kind), first_nodes[kind])
            for kind in sorted(self.alive[0])
        }
        edges = {
            b.name: do(f'{b.name}: encoded', self._encode_edges, first_edges[b.name])
            for b in self.blocks[0]
        }
        for m, blocks in enumerate(self.blocks):
            received: dict = {kind: [] for kind in self.alive[m + 1]}
            for b in blocks:
                name, ends = f'{b.name}: step {m}', (nodes[b.receiver], nodes[b.sender])
                message = do(name, self._message(b, m), edges[b.name], *ends)
                received[b.receiver].append(message)
                if m < last and b in self.blocks[m + 1]:
                    name = f'{b.name}: after step {m}'
                    edges[b.name] = do(name, self._next_edges(m), edges[b.name], message)
            nodes = {
                kind: do(
                    f'{kind}: step {m}', self._update(kind, m, blocks), nodes[kind], *received[kind]
                )
                for kind in sorted(self.alive[m + 1])
            }
        return nodes

    def _columns(self, kind, m):
        """What is needed of the nodes of a kind before step m, as name -> layer of their latent."""
        (edge_w, _), (node_w, node_b) = (mlp.layers[0] for mlp in self._processors[m])
        _, of_receiver, of_sender = tf.split(edge_w, 3)
        columns = {}
        if any(b.receiver == kind for b in self.blocks[m]):
            columns['receive'] = Linear(of_receiver, tf.zeros_like(node_b))
        if any(b.sender == kind for b in self.blocks[m]):
            columns['send'] = Linear(of_sender, tf.zeros_like(node_b))
        if kind in self.alive[m + 1]:
            columns['update'] = Linear(tf.split(node_w, 2)[1], node_b)
            if m == len(self._processors) - 1:
                columns['decode'] = self._decoder[0]
        merged = Linear(*(tf.concat(part, -1) for part in zip(*columns.values(), strict=True)))
        return list(columns), merged

    def _encode_nodes(self, kind):
        names, linear = self._columns(kind, 0)
        residual = len(self._processors) > 1 and kind in self.alive[1]

        def encode(first):
            mlp = self._node_encoder
            output, columns = mlp.output_and(mlp.hidden(first), linear, residual)
            return _named(names, columns) | ({'latent': output} if residual else {})

        return encode

    def _encode_edges(self, first):
        mlp, (w, b) = self._edge_encoder, self._processors[0][0].layers[0]
        residual = len(self._processors) > 1
        of_edge = Linear(tf.split(w, 3)[0], b)
        output, result = mlp.output_and(mlp.hidden(first), of_edge, residual)
        return {'first': result} | ({'latent': output} if residual else {})

    def _message(self, block, m):
        mlp = self._edge_models[m]
        keep = m + 1 < len(self._processors)

        def message(edges, receivers, senders):
            ends = block.combine(receivers['receive'], senders['send'])
            centred = mlp.last(mlp.hidden(edges['first'] + ends))
            factor = mlp.factor(centred)
            # Messages are summed by a small product, which also divides by their deviation.
            weight = block.incidence * tf.linalg.matrix_transpose(factor)
            result = {'received': tf.matmul(weight, centred)}
            return result | ({'latent': mlp.restored(centred, factor)} if keep else {})

        return message

    def _next_edges(self, m):
        w, b = self._processors[m + 1][0].layers[0]
        of_edge = Linear(tf.split(w, 3)[0], b)

        def residual(edges, message):
            latent = edges['latent'] + message['latent']
            return {'first': of_edge(latent), 'latent': latent}

        return residual

    def _update(self, kind, m, blocks):
        mlp, last = self._node_models[m], m + 1 == len(self._processors)
        w = tf.split(self._processors[m][1].layers[0][0], 2)[0]
        of_received = self._edge_models[m].before(Linear(w, tf.zeros(w.shape[1])))
        share = sum(b.incidence.sum(axis=1) for b in blocks if b.receiver == kind)

        def update(nodes, *received):
            first = nodes['update']
            if received:
                total = tf.add_n([x['received'] for x in received])
                first += Linear(of_received.w, share[:, None] * of_received.b)(total)
            hidden = mlp.hidden(first)
            if last:
                of_decoder = Linear(self._decoder[0].w, tf.zeros_like(self._decoder[0].b))
                _, change = mlp.output_and(hidden, of_decoder, False)
                x = tf.nn.relu(nodes['decode'] + change)
                for linear in self._decoder[1:-1]:
                    x = tf.nn.relu(linear(x))
                return x
            centred = mlp.last(hidden)
            latent = nodes['latent'] + mlp.restored(centred, mlp.factor(centred))
            names, linear = self._columns(kind, m + 1)
            return _named(names, linear(latent)) | {'latent': latent}

        return update


def _named(names, columns):
    return dict(zip(names, tf.split(columns, len(names), axis=-1), strict=True))
