"""`NriModel`: encoder and decoder, or `Central`, behind one config, saved as arrays and JSON.

A model folder holds `config.json` (settings, node names, digest of the data) and `weights.npz`
(arrays only: no code, no pickle).
"""

import dataclasses
import os

import numpy as np
import sonnet as snt
import tensorflow as tf

from learning_to_simulate import checkpoints
from learning_to_simulate.checkpoints import CONFIG_FILE, WEIGHTS_FILE
from nri import losses, networks
from nri.central import Central
from nri.config import MAX_NODES, NriConfig, log_prior
from nri.networks import Decoder, Encoder, unroll
from pca_tools import files

MAX_FEATURES = 100
BATCH = 500  # windows at a time; fewer where objects have more than 16 sets of edges


class NriModel(snt.Module):
    """Encoder and decoder, or `central`, and the normalisation of their features, `offset` and
    `scale`, float32 [1 or V, F] of `data.normalization`. ValueError: too few or too many nodes, or
    a normalisation that is not one of them."""

    def __init__(self, config: NriConfig, node_names, offset, scale, data_digest, name='nri'):
        super().__init__(name=name)
        self.config = config
        self.node_names = tuple(node_names)
        self.data_digest = data_digest
        self.digest: str | None = None  # sha256 of the weights file, once saved or loaded
        self.offset = np.asarray(offset, np.float32)
        self.scale = np.asarray(scale, np.float32)
        self._check()
        n_features = self.offset.shape[1]
        tf.random.set_seed(config.seed)
        self._log_prior = log_prior(config.edge_types, config.no_edge_prior)
        n_node = len(self.node_names)
        frames = tf.zeros([1, n_node, config.window, n_features])
        self.central, self.chunk = None, BATCH
        if config.central:
            self.central = Central(n_node, n_features, config, self._log_prior)
            self.chunk = max(1, BATCH * 16 // max(16, self.central.n_sets))
            self.logits(frames, is_training=True)
        else:
            self.encode = Encoder(config.hidden, config.edge_types)
            self.decoder = Decoder(n_features, config.hidden, config.edge_types, config.skip_first)
            types = tf.nn.softmax(self.both_ways(self.logits(frames, is_training=True)))
            self.decoder(frames[:, :, 0], types)
        self._probabilities = tf.function(
            lambda features: tf.nn.softmax(
                self.both_ways(self.logits(self.normalized(features), is_training=False))
            ),
            jit_compile=True,
            autograph=False,
        )

    def _check(self):
        names = self.node_names
        if not 2 <= len(names) <= MAX_NODES or not all(isinstance(n, str) for n in names):
            raise ValueError(f'{len(names)} node names, 2 to {MAX_NODES} texts were expected')
        shape = self.offset.shape
        if (
            len(shape) != 2
            or shape[0] not in (1, len(names))
            or not 1 <= shape[1] <= MAX_FEATURES
            or self.scale.shape != shape
            or not np.isfinite([self.offset, self.scale]).all()
            or not (self.scale > 0).all()
        ):
            raise ValueError(
                f'offset {shape} and scale {self.scale.shape} are no finite normalisation of '
                f'{len(names)} nodes'
            )

    def normalized(self, features):
        """[B, V, T, F] in the units of the files -> about [-1, 1]."""
        return (features - self.offset[:, None]) / self.scale[:, None]

    def logits(self, frames, is_training) -> tf.Tensor:
        """Logits of types that are chosen independently, of normalised frames [B, V, window, F]:
        [B, V (V - 1), K]; with `symmetric` [B, V (V - 1) / 2, K], of the pairs i < j. In training
        layers are normalised with the statistics of this batch."""
        if self.central:
            by_time = tf.transpose(frames, [0, 2, 1, 3])
            each = self.central.log_likelihoods(by_time[:, :-1], by_time[:, 1:])
            logits = self.central.posterior(tf.reduce_sum(each, axis=1))[1]
        else:
            logits = self.encode(frames, is_training)
        if self.config.symmetric:
            return networks.mean_of_both_ways(logits, frames.shape[1])
        return logits

    def both_ways(self, of_pair) -> tf.Tensor:
        """What `logits` is of, for each ordered pair: -> [B, V (V - 1), K]."""
        n_node = len(self.node_names)
        return networks.both_ways(of_pair, n_node) if self.config.symmetric else of_pair

    def losses(self, features, seed, true_edges=None, is_training=False) -> dict[str, tf.Tensor]:
        """Negative evidence bound of a batch [B, V, window, F], the same in training and
        validation; `is_training` as for `logits`.

        The seed, int32 [2], is of the edge sample and of the segment that is predicted; true edges
        are int32 [B, V (V - 1)]. Returns scalars: 'loss', and what it is made of: 'nll' and 'kl'
        per node, scaled to the whole window; if supervised, 'loss' alone, the cross-entropy of the
        true edges."""
        c = self.config
        frames = self.normalized(features)
        if self.central:
            return self._losses_of_central(frames, seed)
        logits = self.logits(frames, is_training)
        if c.supervised:
            cross_entropy = tf.nn.sparse_softmax_cross_entropy_with_logits(
                true_edges, self.both_ways(logits)
            )
            return {'loss': tf.reduce_mean(cross_entropy)}
        n_node = frames.shape[1]
        sample_seed, segment_seed = tf.unstack(tf.random.experimental.stateless_split(seed, 2))
        types = losses.gumbel_softmax(logits, c.temperature, sample_seed)
        types = self.both_ways(types)
        start = tf.random.stateless_uniform(
            [tf.shape(frames)[0], 1], segment_seed, maxval=c.window - c.segment, dtype=tf.int32
        )
        by_time = tf.transpose(frames, [0, 2, 1, 3])
        segment = tf.gather(by_time, start + tf.range(c.segment + 1), batch_dims=1)
        segment = tf.ensure_shape(segment, [None, c.segment + 1, n_node, frames.shape[3]])
        segment = tf.transpose(segment, [0, 2, 1, 3])
        predictions = unroll(self.decoder, segment[:, :, 0], types, c.segment)
        nll = losses.gaussian_nll(predictions, segment[:, :, 1:], c.output_variance)
        nll *= (c.window - 1) * frames.shape[3]
        kl = losses.kl_to_prior(logits, self._log_prior)
        kl = tf.reduce_mean(tf.reduce_sum(kl, axis=1)) / n_node
        return {'loss': nll + kl, 'nll': nll, 'kl': kl}

    def _losses_of_central(self, frames, seed):
        """Of `segment` frames at even distances, from a random one on."""
        c = self.config
        apart = (c.window - 1) // c.segment
        n_start = c.window - 1 - apart * (c.segment - 1)
        first = tf.random.stateless_uniform(
            [tf.shape(frames)[0], 1], seed, maxval=n_start, dtype=tf.int32
        )
        chosen = first + apart * tf.range(c.segment)
        by_time = tf.transpose(frames, [0, 2, 1, 3])
        now, after = (tf.gather(by_time, chosen + k, axis=1, batch_dims=1) for k in (0, 1))
        nll, kl = self.central.losses(now, after)
        nll *= c.window - 1
        return {'loss': nll + kl, 'nll': nll, 'kl': kl}

    def edge_probabilities(self, features) -> np.ndarray:
        """Posterior of the edge types, float32 [S, V (V - 1), K], pairs in Kipf's order, of
        features [S, V, T, F] as `data.load` gives them.

        Runs longer than the window are cut into windows side by side, the last one ending with
        the run, and their probabilities averaged. ValueError: other nodes, or too few frames."""
        self.check_features(features)
        span, n_frame = self.config.span, features.shape[2]
        count = -(-n_frame // span)
        starts = np.linspace(0, n_frame - span, count).round().astype(int)
        total = sum(
            self.window_probabilities(features[:, :, start : start + span : self.config.stride])
            for start in starts
        )
        return (total / count).astype(np.float32)

    def window_probabilities(self, windows) -> np.ndarray:
        """Posterior of single windows: [S, V, window, F] -> float32 [S, V (V - 1), K]."""
        parts = []
        for first in range(0, len(windows), self.chunk):
            batch = windows[first : first + self.chunk]
            # A short last batch is filled up, so that nothing is compiled for it.
            filled = np.resize(batch, (min(self.chunk, len(windows)), *batch.shape[1:]))
            parts.append(self._probabilities(tf.constant(filled))[: len(batch)].numpy())
        return np.concatenate(parts)

    def check_features(self, features):
        """Raises ValueError, with both shapes, for features that are not those of this model's
        nodes."""
        expected = len(self.node_names), self.offset.shape[1]
        if features.ndim != 4 or (features.shape[1], features.shape[3]) != expected:
            raise ValueError(
                f'features have shape {features.shape}, (runs, {expected[0]} nodes, frames, '
                f'{expected[1]}) was expected; nodes are {self.node_names[0]} ... '
                f'{self.node_names[-1]}'
            )
        if features.shape[2] < self.config.span:
            raise ValueError(
                f'runs have {features.shape[2]} frames; a window of {self.config.window} frames '
                f'with stride {self.config.stride} needs {self.config.span}'
            )

    def save(self, path: str) -> None:
        """Writes config.json and weights.npz; ValueError for weights that are not finite: nothing
        is written then."""
        os.makedirs(path, exist_ok=True)
        checkpoints.save_weights(path, self._weights())
        files.write_json(os.path.join(path, CONFIG_FILE), self.to_json())
        self.digest = files.sha256_of_file(os.path.join(path, WEIGHTS_FILE))

    def load_weights(self, path: str) -> None:
        """Reads weights.npz of a folder; raises as `checkpoints.filled`."""
        checkpoints.filled(path, lambda: self, NriModel._weights)
        self.digest = files.sha256_of_file(os.path.join(path, WEIGHTS_FILE))

    def _weights(self):
        """Variables by names that do not change between processes."""
        return {f'{i:03d}.{v.name.split(":")[0]}': v for i, v in enumerate(self.variables)}

    def to_json(self) -> dict:
        """What config.json holds."""
        return {
            'schema_version': checkpoints.SCHEMA_VERSION,
            'kind': 'nri',
            'config': dataclasses.asdict(self.config),
            'node_names': list(self.node_names),
            'offset': self.offset.astype(float).tolist(),
            'scale': self.scale.astype(float).tolist(),
            'data_digest': self.data_digest,
        }


def load_model(path: str) -> NriModel:
    """Loads a saved model, of which nothing is built that its weights do not hold.
    FileNotFoundError: no model there. ValueError: a damaged or foreign config, or weights that do
    not belong to it."""
    name = os.path.join(path, CONFIG_FILE)
    if not os.path.isfile(name):
        raise FileNotFoundError(f'{name}: no such file; train a model with nri.train')
    values = checkpoints.read_config(path)
    if values.get('kind') != 'nri':
        raise ValueError(f'{name}: not the config of an NRI model')

    def make():
        with checkpoints.refusing_wrong_fields(path):
            config = NriConfig(**values['config'])
            keys = 'node_names', 'offset', 'scale', 'data_digest'
            return NriModel(config, *(values[key] for key in keys))

    model = checkpoints.filled(path, make, NriModel._weights)
    model.digest = files.sha256_of_file(os.path.join(path, WEIGHTS_FILE))
    return model
