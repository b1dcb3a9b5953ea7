"""Settings and presets of the open-loop methods: the baselines that learn no dynamics."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class OpenLoopConfig:
    """What an open-loop method is.

    Attributes:
      preset: name of the preset the config started from.
      model: the method, a name of `methods.registry`.
      max_samples: frames of training that a kernel ridge is fitted to, spread over all runs.
      fitted: whether the formula's parameters are fitted to the training runs; else they are the
        soil's own.

    Raises:
      ValueError: a number of samples that fits no kernel matrix.
    """

    preset: str
    model: str
    max_samples: int = 3000
    fitted: bool = False

    def __post_init__(self):
        if not 1 <= self.max_samples <= 20_000:
            raise ValueError(f'max_samples is {self.max_samples}, must lie in [1, 20000]')


PRESETS = {
    'path_ridge': OpenLoopConfig('path_ridge', 'path_ridge'),
    'earthmoving': OpenLoopConfig('earthmoving', 'earthmoving'),
    'earthmoving_fitted': OpenLoopConfig('earthmoving_fitted', 'earthmoving', fitted=True),
    'bekker_wong_janosi': OpenLoopConfig('bekker_wong_janosi', 'bekker_wong_janosi'),
    'bekker_wong_janosi_fitted': OpenLoopConfig(
        'bekker_wong_janosi_fitted', 'bekker_wong_janosi', fitted=True
    ),
}
