"""`NriConfig`: every setting of a model and of its training, checked; without TensorFlow."""

import dataclasses
import math

import numpy as np

# Below it the softmax saturates in float32 and the gradient vanishes.
MIN_TEMPERATURE = 0.05
_LARGEST = 2**31 - 1
MAX_NODES = 300
# Field -> its least and largest value; the largest are beyond any graph of the project, so that a
# damaged number does not ask for its memory.
_RANGES = {
    'edge_types': (2, 100), 'hidden': (1, 4096), 'window': (2, 10_000), 'stride': (1, 10_000),
    'decay_start': (0, _LARGEST), 'batch_size': (1, 100_000), 'modes': (0, MAX_NODES),
    'seed': (0, 2**28 - 1),  # eight random streams per seed in int32
}  # fmt: skip


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
class NriConfig:
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
      nodes: which nodes of a dataset of this project; see `nri.data`.
      modes: how many of its modes, the first ones; 0: all.

    Raises:
      ValueError: a value outside its range, with the range.
    """

    skip_first: bool = True
    symmetric: bool = False
    edge_types: int = 2
    hidden: int = 256
    window: int = 49
    stride: int = 1
    segment: int = 10
    temperature: float = 0.5
    no_edge_prior: float | None = None
    output_variance: float = 5e-5
    learning_rate: float = 5e-4
    decay: float = 0.5
    decay_epochs: int = 50
    decay_start: int = 50
    epochs: int = 200
    batch_size: int = 128
    seed: int = 0
    supervised: bool = False
    nodes: str = 'modes'
    modes: int = 0

    def __post_init__(self):
        for field in dataclasses.fields(self):
            name, value = field.name, getattr(self, field.name)
            if field.type is int:
                low, high = _RANGES.get(name, (1, _LARGEST))
                if type(value) is not int or not low <= value <= high:
                    raise ValueError(
                        f'{name} is {value!r}, must be at least {low} and at most {high}'
                    )
            if field.type is float and not (
                isinstance(value, (int, float)) and np.isfinite(value) and value > 0
            ):
                raise ValueError(f'{name} is {value!r}, must be positive and finite')
            if field.type is bool and type(value) is not bool:
                raise ValueError(f'{name} is {value!r}, must be true or false')
        if self.temperature < MIN_TEMPERATURE:
            raise ValueError(
                f'temperature is {self.temperature}, must be at least {MIN_TEMPERATURE}: below it '
                f'the gradient of the sample vanishes'
            )
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
