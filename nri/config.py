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
    """float32 [K] log probabilities: uniform, or `no_edge_prior` for type 0 and the rest equally.

    Raises:
      ValueError: a probability outside (0, 1).
    """
    if no_edge_prior is None:
        return np.full(n_types, -math.log(n_types), np.float32)
    if not 0.0 < no_edge_prior < 1.0:
        raise ValueError(f'no_edge_prior is {no_edge_prior}, must lie in (0, 1)')
    rest = math.log1p(-no_edge_prior) - math.log(n_types - 1)
    return np.array([math.log(no_edge_prior)] + [rest] * (n_types - 1), np.float32)


@dataclasses.dataclass(frozen=True)
class NriConfig(Settings):
    """Every setting of a model and its training. Defaults: Kipf et al. 2018 and the thesis.

    Attributes:
      skip_first: whether edge type 0 means that nothing is exchanged.
      symmetric: whether what acts is mutual, as a force between two objects is: both directions of
        a pair then share one type, from the mean of their logits.
      edge_types: K.
      hidden: width of all layers.
      window: frames that the encoder sees.
      stride: frames of the data between two of the window.
      segment: frames that the decoder predicts on its own; a random part of the window.
      temperature: of the Gumbel-softmax, at least 0.05.
      no_edge_prior: prior probability of type 0; None for the uniform prior.
      output_variance: of the Gaussian likelihood, in normalised units.
      learning_rate, decay, decay_epochs, decay_start: rate x decay each decay_epochs, first at
        epoch decay_start.
      epochs, batch_size, seed: of the training.
      supervised: train the encoder alone, with the true edges.
      isotropic: whether no direction is special in the box that the objects move in: each sample is
        then turned by a multiple of 90 degrees and mirrored at random; in a plane one counts eight.
      nodes: which nodes of a dataset of this project; see `nri.data`.
      modes: how many of its modes, the first ones; 0: all.

    Raises:
      ValueError: a value outside its range, with the range.
    """

    skip_first: bool = True
    symmetric: bool = False
    edge_types: int = number(2, 2, 100)
    hidden: int = number(256, 1, 4096)
    window: int = number(49, 2, 10_000)
    stride: int = number(1, 1, 10_000)
    segment: int = number(10, 1)
    temperature: float = number(0.5, MIN_TEMPERATURE)
    no_edge_prior: float | None = None
    output_variance: float = number(5e-5, _POSITIVE)
    learning_rate: float = number(5e-4, _POSITIVE)
    decay: float = number(0.5, _POSITIVE)
    decay_epochs: int = number(50, 1, _INT32)
    decay_start: int = number(50, 0, _INT32)
    epochs: int = number(200, 1, _INT32)
    batch_size: int = number(128, 1, 100_000)
    seed: int = number(0, 0, 2**28 - 1)  # eight random streams per seed in int32
    supervised: bool = False
    isotropic: bool = False
    nodes: str = 'modes'
    modes: int = number(0, 0, MAX_NODES)

    def rules(self):
        """Raises for a prior that is no probability and a segment longer than the window."""
        log_prior(self.edge_types, self.no_edge_prior)
        if self.segment >= self.window:
            raise ValueError(
                f'a segment of {self.segment} frames and the one before it are more than the '
                f'window of {self.window} frames'
            )

    @property
    def span(self) -> int:
        """Frames of the data from the first to the last of a window, both included."""
        return (self.window - 1) * self.stride + 1
