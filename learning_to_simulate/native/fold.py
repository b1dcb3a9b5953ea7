"""Weights of a network as the C code takes them: packed panels, and LayerNorm folded in.

With h the last hidden layer of an MLP and W, b its last layer, LayerNorm(h W + b) is

    f (h W' + b') scale + offset,    f = 1 / sqrt(|h W' + b'|^2 / L + epsilon),

where W' and b' are W and b without their mean over the outputs. The norm needs no W': by a QR
decomposition |h W' + b'| = |h T + t| with a triangular T: half the products. Whatever linear layer
follows goes into one product with W'. All of it is done in float64 and rounded once.
"""

import numpy as np

from learning_to_simulate.native import library


def dense(w, b=None, triangular: bool = False) -> dict:
    """`lts_dense` of y = x w + b, w [in, out], b [out] or None for zeros. Where w[i, j] is 0 for i
    < j (`triangular`), the zeros of whole panels are left out."""
    panel = library.constants()['LTS_PANEL']
    w = np.asarray(w, np.float64)
    rows, columns = w.shape
    padded = -(-columns // panel) * panel
    whole, bias = np.zeros((rows, padded)), np.zeros(padded)
    whole[:, :columns] = w
    bias[:columns] = 0.0 if b is None else b
    panels = [
        whole[p if triangular else 0 :, p : p + panel].reshape(-1) for p in range(0, padded, panel)
    ]
    return {
        'rows': rows,
        'columns': padded,
        'triangular': int(triangular),
        'w': np.concatenate(panels).astype(np.float32),
        'b': bias.astype(np.float32),
    }


def side_by_side(parts):
    """Linear layers [(w, b)] of the same input as one, each padded to whole panels."""
    panel = library.constants()['LTS_PANEL']
    padded = []
    for w, b in parts:
        more = -len(b) % panel
        padded.append((np.pad(w, ((0, 0), (0, more))), np.pad(b, (0, more))))
    return tuple(np.concatenate(x, axis=-1) for x in zip(*padded))


class Mlp:
    """An MLP with LayerNorm behind it, of `graph_network.MlpWeights`, folded."""

    def __init__(self, weights):
        layers = [tuple(np.asarray(x, np.float64) for x in layer) for layer in weights.layers]
        self.first, self._hidden = layers[0], layers[1:-1]
        w, b = layers[-1]
        self._w, self._b = w - w.mean(axis=1, keepdims=True), b - b.mean()
        self._scale, self._offset = (
            np.asarray(x, np.float64) for x in (weights.scale, weights.offset)
        )
        self.width = w.shape[1]

    def tail(self) -> dict:
        """`lts_mlp`: from the first layer to the factor f."""
        r = np.linalg.qr(np.concatenate([self._w, self._b[None]]).T, mode='r').T  # type: ignore[attr-defined]
        return {
            'n_hidden': len(self._hidden),
            'width': self.width,
            'hidden': [dense(*layer) for layer in self._hidden],
            'norm': dense(r[:-1], r[-1], triangular=True),
        }

    def before(self, w, b) -> dict:
        """`lts_normed`: the linear layer w, b of the output."""
        w = np.asarray(w, np.float64)
        through = self._scale[:, None] * w
        o = self._offset @ w + b
        a = dense(self._w @ through, self._b @ through)
        return {'a': a, 'o': np.pad(o, (0, a['columns'] - len(o))).astype(np.float32)}

    def identity(self):
        """The layer whose `before` is the output itself."""
        return np.eye(self.width), np.zeros(self.width)

    def before_sum(self, w) -> dict:
        """`lts_dense` of [sum s f h, sum s f, sum s]: w of the sum over rows of s times the
        output."""
        w = np.asarray(w, np.float64)
        through = self._scale[:, None] * w
        rows = [self._w @ through, (self._b @ through)[None], (self._offset @ w)[None]]
        return dense(np.concatenate(rows))
