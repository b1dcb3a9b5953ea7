"""Settings and preset of the swept field."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class SweptFieldConfig:
    """What a swept field is and how it is trained.

    Attributes:
      preset: name of the preset the config started from.
      model: the method, a name of `methods.registry`.
      members: networks that are trained together from different first weights; their mean predicts,
        their spread says how sure it is.
      latent_size, hidden_layers: of the network of the particles.
      force_latent_size: of that of the force, which has two hidden layers.
      num_steps: of training.
      batch_size: frames of a batch.
      particles_per_frame: drawn of each frame's sample.
      learning_rate: the first one; it ends at 0 along a cosine.
      train_runs: so many runs spread over train are used, 0: all (for learning curves).
      start_every: frames between the starts of further episodes in the middle of runs; 0: none.
      seed: of first weights and draws.

    Raises:
      ValueError: a number outside its range.
    """

    preset: str
    model: str = 'swept_field'
    members: int = 3
    latent_size: int = 128
    hidden_layers: int = 3
    force_latent_size: int = 64
    num_steps: int = 6000
    batch_size: int = 96
    particles_per_frame: int = 48
    learning_rate: float = 3e-3
    train_runs: int = 0
    start_every: int = 100
    seed: int = 0

    def __post_init__(self):
        for name, low in {
            'members': 1, 'latent_size': 1, 'hidden_layers': 1, 'force_latent_size': 1,
            'num_steps': 1, 'batch_size': 1, 'particles_per_frame': 1, 'train_runs': 0,
            'start_every': 0, 'seed': 0,
        }.items():  # fmt: skip
            if getattr(self, name) < low:
                raise ValueError(f'{name} is {getattr(self, name)}, must be at least {low}')
        if not 0 < self.learning_rate < 1:
            raise ValueError(f'learning_rate is {self.learning_rate}, must lie in (0, 1)')


PRESETS = {'swept_field': SweptFieldConfig('swept_field')}
