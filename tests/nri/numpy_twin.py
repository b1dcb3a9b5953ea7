"""Encoders and decoders once more in plain numpy and float64, pair by pair.

Shares no code with the package but the weights.
"""

import numpy as np


def elu(x):
    return np.where(x > 0, x, np.expm1(np.minimum(x, 0)))


def relu(x):
    return np.maximum(x, 0)


class Twin:
    """Reads the weights by the end of their names."""

    def __init__(self, module):
        self.w = {f'/{v.name.split(":")[0]}': v.numpy().astype(float) for v in module.variables}

    def __getitem__(self, name):
        found = [v for k, v in self.w.items() if k.endswith('/' + name)]
        assert len(found) == 1, (name, sorted(self.w))
        return found[0]

    def linear(self, name, x):
        has_bias = any(k.endswith(f'/{name}/b') for k in self.w)
        return x @ self[f'{name}/w'] + (self[f'{name}/b'] if has_bias else 0.0)

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
        of_receiver = self.linear(f'{name}/of_receiver', receiver)
        return of_receiver + self.linear(f'{name}/of_sender', sender)


def pairs_of(n_node):
    return [(i, j) for i in range(n_node) for j in range(n_node) if i != j]


def encode(module, features):
    """Logits [V (V - 1), K] of one sample [V, T, F]."""
    twin = Twin(module)
    pairs = pairs_of(len(features))
    nodes = [twin.mlp('of_node', x.reshape(-1)) for x in features]
    of_pair = [
        twin.after_first('of_pair', twin.ends('encoder/ends', nodes[i], nodes[j])) for i, j in pairs
    ]
    logits = []
    for e, ends in enumerate(pairs):
        incoming = [
            np.mean([of_pair[k] for k, (r, _) in enumerate(pairs) if r == node], axis=0)
            for node in ends
        ]
        hidden = twin.ends('messages/ends', *(twin.mlp('messages/middle', x) for x in incoming))
        hidden = hidden + twin.linear('skip', of_pair[e])
        logits.append(twin.linear('logits', twin.after_first('last', hidden)))
    return np.stack(logits)


def decode(module, frame, types, count, first_type):
    """The next `count` frames [V, count, F] of one sample's frame [V, F]."""
    twin = Twin(module)
    out = []
    for _ in range(count):
        received = np.zeros((len(frame), len(twin[f'second_{first_type}/b'])))
        for e, (i, j) in enumerate(pairs_of(len(frame))):
            for k in range(first_type, types.shape[1]):
                hidden = relu(twin.ends(f'first_{k}', frame[i], frame[j]))
                received[i] += types[e, k] * relu(twin.linear(f'second_{k}', hidden))
        x = np.concatenate([frame, received], -1)
        for layer in range(3):
            x = twin.linear(f'update/linear_{layer}', x)
            x = relu(x) if layer < 2 else x
        frame = frame + x
        out.append(frame)
    return np.stack(out, 1)
