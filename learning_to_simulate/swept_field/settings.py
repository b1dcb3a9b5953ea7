"""Settings and preset of the swept field."""

import dataclasses

from learning_to_simulate.config import Settings, number


@dataclasses.dataclass(frozen=True)
class SweptFieldConfig(Settings):
    """What a swept field is and how it is trained.

    Attributes:
      preset: name of the preset the config started from.
      model: the method, a name of `registry`.
      members: networks that are trained together from different first weights; their mean predicts,
        their spread says how sure it is.
      latent_size, hidden_layers: of the network of the particles.
      num_steps: of training.
      batch_size: frames of a batch.
      learning_rate: the first one; it ends at 0 along a cosine.
      train_runs: number of training runs, spread over train; 0: all (for learning curves).
      start_every: frames between the starts of further episodes in the middle of runs; 0: none.
      seed: of first weights and draws.

    Raises:
      ValueError: a value of another type, or a number outside its range.
    """

    preset: str
    model: str = 'swept_field'
    members: int = number(3, 1, 100)
    latent_size: int = number(128, 1, 4096)
    hidden_layers: int = number(3, 1, 100)
    num_steps: int = number(6000, 1)
    batch_size: int = number(96, 1)
    learning_rate: float = 3e-3
    train_runs: int = number(0, 0)
    start_every: int = number(100, 0)
    seed: int = number(0, 0)

    def rules(self):
        """Raises where the learning rate is none."""
        if not 0 < self.learning_rate < 1:
            raise ValueError(f'learning_rate is {self.learning_rate}, must lie in (0, 1)')


PRESETS = {'swept_field': SweptFieldConfig('swept_field')}
