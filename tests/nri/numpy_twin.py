"""Encoders and decoders once more in plain numpy and float64, pair by pair.

Shares no code with the package but the weights.
"""

import numpy as np


def weights_of(module):
    """{name: float64 array} of a module's variables, names below the module's own."""
    return {v.name.split(':')[0]: v.numpy().astype(float) for v in module.variables}


def elu(x):
    return np.where(x > 0, x, np.expm1(np.minimum(x, 0)))


def relu(x):
    return np.maximum(x, 0)


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


class Twin:
    """Reads the weights by the end of their names."""

    def __init__(self, module):
        self.w = weights_of(module)

    def __getitem__(self, name):
        found = [v for k, v in self.w.items() if ('/' + k).endswith('/' + name)]
        assert len(found) == 1, (name, sorted(self.w))
        return found[0]

    def has_bias(self, name):
        return any(('/' + k).endswith(f'/{name}/b') for k in self.w)

    def linear(self, name, x):
        bias = self.has_bias(name)
        return x @ self[f'{name}/w'] + (self[f'{name}/b'] if bias else 0.0)

    def norm(self, name, x):
        mean = self[f'{name}/moving_mean/average'].reshape(-1)
        variance = self[f'{name}/moving_variance/average'].reshape(-1)
        scale, offset = self[f'{name}/scale'].reshape(-1), self[f'{name}/offset'].reshape(-1)
        return (x - mean) / np.sqrt(variance + 1e-5) * scale + offset

    def after_first(self, name, x):
        x = elu(self.linear(f'{name}/linear', elu(x)))
        return self.norm(f'{name}/batch_norm', x)

    def mlp(self, name, x):
        return self.after_first(f'{name}/after_first', self.linear(f'{name}/linear', x))

    def ends(self, name, receiver, sender):
        return self.linear(f'{name}/of_receiver', receiver) + self.linear(
            f'{name}/of_sender', sender
        )


def pairs_of(n_node):
    return [(i, j) for i in range(n_node) for j in range(n_node) if i != j]


def factor_graph(twin, of_pair, n_node, is_factor):
    pairs = pairs_of(n_node)
    last = []
    for e, (i, j) in enumerate(pairs):
        if is_factor:
            incoming = [
                np.mean([of_pair[k] for k, (r, _) in enumerate(pairs) if r == node], axis=0)
                for node in (i, j)
            ]
            ends = [twin.mlp('messages/middle', x) for x in incoming]
            hidden = twin.ends('messages/ends', *ends)
        else:
            hidden = twin.linear('messages/ends', twin.mlp('messages/middle', of_pair[e]))
        hidden = hidden + twin.linear('skip', of_pair[e])
        last.append(twin.linear('logits', twin.after_first('last', hidden)))
    return np.stack(last)


def mlp_encoder(module, features, is_factor):
    """Logits [V (V - 1), K] of one sample [V, T, F]."""
    twin = Twin(module)
    nodes = [twin.mlp('of_node', x.reshape(-1)) for x in features]
    of_pair = [
        twin.after_first('of_pair', twin.ends('encoder/ends', nodes[i], nodes[j]))
        for i, j in pairs_of(len(features))
    ]
    return factor_graph(twin, of_pair, len(features), is_factor)


def cnn_encoder(module, features, is_factor):
    """Logits [V (V - 1), K] of one sample [V, T, F]."""
    twin = Twin(module)

    def convolve(name, x):
        kernel = twin[f'{name}/w']
        bias = twin[f'{name}/b'] if twin.has_bias(name) else 0.0
        return np.stack(
            [np.einsum('kf,kfo->o', x[t : t + 5], kernel) + bias for t in range(len(x) - 4)]
        )

    of_pair = []
    for i, j in pairs_of(len(features)):
        x = relu(convolve('receiver', features[i]) + convolve('sender', features[j]))
        x = twin.norm('first_norm', x)
        x = x[: len(x) // 2 * 2].reshape(-1, 2, x.shape[1]).max(1)
        x = twin.norm('second_norm', relu(convolve('second', x)))
        score = twin.linear('attention', x)[:, 0]
        share = np.exp(score - score.max())
        x = (share / share.sum()) @ twin.linear('value', x)
        of_pair.append(twin.mlp('of_pair', x))
    return factor_graph(twin, of_pair, len(features), is_factor)


def _update(twin, x):
    for i in range(3):
        x = twin.linear(f'update/linear_{i}', x)
        x = relu(x) if i < 2 else x
    return x


def _received(twin, nodes, types, first_type, activation):
    total = np.zeros((len(nodes), twin.w_width))
    for e, (i, j) in enumerate(pairs_of(len(nodes))):
        for k in range(first_type, types.shape[1]):
            hidden = activation(twin.ends(f'first_{k}', nodes[i], nodes[j]))
            total[i] += types[e, k] * activation(twin.linear(f'second_{k}', hidden))
    return total


def decode(module, frames, types, kind, skip_first, burn_in):
    """Predictions [V, T - 1, F] of one sample's frames [V, T, F]."""
    twin = Twin(module)
    first_type = 1 if skip_first else 0
    twin.w_width = len(twin[f'second_{first_type}/b'])
    n_node = len(frames)
    memory = np.zeros((n_node, twin.w_width))
    out, frame = [], frames[:, 0]
    for t in range(frames.shape[1] - 1):
        if 0 < t < burn_in:
            frame = frames[:, t]
        if kind == 'mlp':
            received = _received(twin, frame, types, first_type, relu)
            change = _update(twin, np.concatenate([frame, received], -1))
        else:
            received = _received(twin, memory, types, first_type, np.tanh) / (n_node - 1)
            of_frame = np.split(twin.linear('of_frame', frame), 3, -1)
            of_received = np.split(twin.linear('of_received', received), 3, -1)
            reset = sigmoid(of_frame[0] + of_received[0])
            keep = sigmoid(of_frame[1] + of_received[1])
            new = np.tanh(of_frame[2] + reset * of_received[2])
            memory = (1 - keep) * new + keep * memory
            change = _update(twin, memory)
        frame = frame + change
        out.append(frame)
    return np.stack(out, 1)
