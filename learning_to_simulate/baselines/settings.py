"""Settings and presets of the open-loop methods: the baselines that learn no dynamics."""

import dataclasses

from learning_to_simulate.config import Settings, number


@dataclasses.dataclass(frozen=True)
class OpenLoopConfig(Settings):
    """What an open-loop method is.

    Attributes:
      preset: name of the preset the config started from.
      model: the method, a name of `registry`.
      max_samples: frames of training that a kernel ridge is fitted to, spread over all runs.
      leave_one_out: whether a kernel ridge is fitted to train and valid together, chosen by each of
        their runs, judging what the others give, and averaged over the ten best with each kernel:
        for data of a dozen runs.
      fitted: whether the formula's parameters are fitted to the training runs; else they are the
        soil's own.
    """

    preset: str
    model: str
    max_samples: int = number(3000, 1, 20_000)
    leave_one_out: bool = False
    fitted: bool = False


PRESETS = {
    'path_ridge': OpenLoopConfig('path_ridge', 'path_ridge'),
    'path_ridge_few_runs': OpenLoopConfig(
        'path_ridge_few_runs', 'path_ridge', max_samples=1500, leave_one_out=True
    ),
    'earthmoving': OpenLoopConfig('earthmoving', 'earthmoving'),
    'earthmoving_fitted': OpenLoopConfig('earthmoving_fitted', 'earthmoving', fitted=True),
    'bekker_wong_janosi': OpenLoopConfig('bekker_wong_janosi', 'bekker_wong_janosi'),
    'bekker_wong_janosi_fitted': OpenLoopConfig(
        'bekker_wong_janosi_fitted', 'bekker_wong_janosi', fitted=True
    ),
}
