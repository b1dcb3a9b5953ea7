"""`NriConfig`: every setting of a model and of its training, checked; without TensorFlow."""

import dataclasses
import math

import numpy as np

from learning_to_simulate.config import Settings, number

# Below it the softmax saturates in float32 and the gradient of the sample vanishes.
MIN_TEMPERATURE = 0.05
_INT32, _POSITIVE = 2**31 - 1, 1e-30
MAX_NODES = 300


def log_prior(n_types: int, no_edge_prior: float | None) -> np.ndarray:
    """float32 [K] log probabilities: uniform, or `no_edge_prior` for type 0 and the rest equally;
    ValueError for a probability outside (0, 1)."""
    if no_edge_prior is None:
        return np.full(n_types, -math.log(n_types), np.float32)
    if not 0.0 < no_edge_prior < 1.0:
        raise ValueError(f'no_edge_prior is {no_edge_prior}, must lie in (0, 1)')
    rest = math.log1p(-no_edge_prior) - math.log(n_types - 1)
    return np.array([math.log(no_edge_prior)] + [rest] * (n_types - 1), np.float32)


@dataclasses.dataclass(frozen=True)
class NriConfig(Settings):
    """Every setting of a model and its training. Defaults: Kipf et al. 2018 and Usmani 2023.
    ValueError, with the range: a value outside of it."""

    skip_first: bool = True  # whether edge type 0 means that nothing is exchanged
    # Whether what acts is mutual, as a force between two objects is: both directions of a pair then
    # share one type, from the mean of their logits.
    symmetric: bool = False
    edge_types: int = number(2, 2, 100)  # K
    hidden: int = number(256, 1, 4096)  # width of all layers
    window: int = number(49, 2, 10_000)  # frames that the encoder sees
    stride: int = number(1, 1, 10_000)  # frames of the data between two of the window
    segment: int = number(10, 1)  # frames that the decoder predicts alone, a random part of those
    temperature: float = number(0.5, MIN_TEMPERATURE)  # of the Gumbel-softmax
    no_edge_prior: float | None = None  # probability of type 0; None for the uniform prior
    output_variance: float = number(5e-5, _POSITIVE)  # of the likelihood, in normalised units
    # Rate x decay each decay_epochs, first at epoch decay_start.
    learning_rate: float = number(5e-4, _POSITIVE)
    decay: float = number(0.5, _POSITIVE)
    decay_epochs: int = number(50, 1, _INT32)
    decay_start: int = number(50, 0, _INT32)
    epochs: int = number(200, 1, _INT32)
    batch_size: int = number(128, 1, 100_000)
    seed: int = number(0, 0, 2**28 - 1)  # eight random streams per seed in int32
    supervised: bool = False  # train the encoder alone, with the true edges
    # Whether objects act on each other along lines between them: their edges then follow from the
    # decoder, without an encoder, and `segment` frames of a window are drawn; see `nri.central`.
    central: bool = False
    nodes: str = 'modes'  # which nodes of a dataset of this project; see `nri.data`
    modes: int = number(0, 0, MAX_NODES)  # how many of its modes, the first ones; 0: all

    def rules(self):
        """Raises for a prior that is no probability, a segment longer than the window, and edges
        as labels for `central`."""
        log_prior(self.edge_types, self.no_edge_prior)
        if self.supervised and self.central:
            raise ValueError('central has no encoder that could be trained with the true edges')
        if self.segment >= self.window:
            raise ValueError(
                f'a segment of {self.segment} frames and the one before it are more than the '
                f'window of {self.window} frames'
            )

    @property
    def span(self) -> int:
        """Frames of the data from the first to the last of a window, both included."""
        return (self.window - 1) * self.stride + 1
