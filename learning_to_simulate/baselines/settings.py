"""Settings and presets of the open-loop methods: the baselines that learn no dynamics."""

import dataclasses

from learning_to_simulate.config import Settings, number

# `path_ridge.KERNELS` holds what they name.
RIDGE_KERNELS = ('gaussian', 'matern', 'exponential')


@dataclasses.dataclass(frozen=True)
class OpenLoopConfig(Settings):
    """What an open-loop method is.

    Attributes:
      preset: name of the preset the config started from.
      model: the method, a name of `registry`.
      max_samples: frames of training that a kernel ridge is fitted to, spread over all runs.
      leave_one_out: whether a kernel ridge is fitted to train and valid together and chosen by each
        of their runs, judging what the others give: for data of a dozen runs.
      ridge_kernels: of a kernel ridge, names of `path_ridge.KERNELS` with commas between.
      best_choices: how many of the best choices with each of these kernels are averaged.
      fitted: whether the formula's parameters are fitted to the training runs; else they are the
        soil's own.
    """

    preset: str
    model: str
    max_samples: int = number(3000, 1, 20_000)
    leave_one_out: bool = False
    ridge_kernels: str = 'gaussian'
    best_choices: int = number(1, 1, 100)
    fitted: bool = False

    def rules(self):
        """Raises where a kernel is none of `path_ridge.KERNELS`, or named twice."""
        names = self.ridge_kernels.split(',')
        if not set(names) <= set(RIDGE_KERNELS) or len(set(names)) < len(names):
            raise ValueError(
                f'ridge_kernels is {self.ridge_kernels!r}, must be some of {RIDGE_KERNELS}, with '
                f'commas between'
            )


PRESETS = {
    'path_ridge': OpenLoopConfig('path_ridge', 'path_ridge'),
    'path_ridge_few_runs': OpenLoopConfig(
        'path_ridge_few_runs',
        'path_ridge',
        max_samples=1500,
        leave_one_out=True,
        ridge_kernels=','.join(RIDGE_KERNELS),
        best_choices=10,
    ),  # fmt: skip
    'earthmoving': OpenLoopConfig('earthmoving', 'earthmoving'),
    'earthmoving_fitted': OpenLoopConfig('earthmoving_fitted', 'earthmoving', fitted=True),
    'bekker_wong_janosi': OpenLoopConfig('bekker_wong_janosi', 'bekker_wong_janosi'),
    'bekker_wong_janosi_fitted': OpenLoopConfig(
        'bekker_wong_janosi_fitted', 'bekker_wong_janosi', fitted=True
    ),
}
