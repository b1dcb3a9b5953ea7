"""Settings and presets of the open-loop methods: the baselines that learn no dynamics."""

import dataclasses

from learning_to_simulate.config import Settings, number


@dataclasses.dataclass(frozen=True)
class OpenLoopConfig(Settings):
    """What an open-loop method is.

    Attributes:
      preset: name of the preset the config started from.
      model: the method, a name of `methods.registry`.
      max_samples: frames of training that a kernel ridge is fitted to, spread over all runs.
      fitted: whether the formula's parameters are fitted to the training runs; else they are the
        soil's own.
    """

    preset: str
    model: str
    max_samples: int = number(3000, 1, 20_000)
    fitted: bool = False


PRESETS = {
    'path_ridge': OpenLoopConfig('path_ridge', 'path_ridge'),
    'earthmoving': OpenLoopConfig('earthmoving', 'earthmoving'),
    'earthmoving_fitted': OpenLoopConfig('earthmoving_fitted', 'earthmoving', fitted=True),
    'bekker_wong_janosi': OpenLoopConfig('bekker_wong_janosi', 'bekker_wong_janosi'),
    'bekker_wong_janosi_fitted': OpenLoopConfig(
        'bekker_wong_janosi_fitted', 'bekker_wong_janosi', fitted=True
    ),
}
