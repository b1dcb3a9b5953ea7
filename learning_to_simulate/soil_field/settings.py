"""Settings of the soil field."""

import dataclasses

from learning_to_simulate.config import Settings, number


@dataclasses.dataclass(frozen=True)
class SoilFieldConfig(Settings):
    """What a soil field is and how it is trained.

    Attributes:
      preset: name of the preset the config started from.
      model: the method, a name of `registry`.
      members: networks of each kind that are trained together from different first weights; their
        mean predicts, their spread says how sure it is.
      num_steps: of training the load; see `SCHEDULES`.
      learning_rate: its first one; it ends at 0 along a cosine.
      seed: of first weights and draws.

    Raises:
      ValueError: a value of another type, or a number outside its range.
    """

    preset: str
    model: str = 'soil_field'
    members: int = number(3, 1, 100)
    num_steps: int = number(8000, 1)
    learning_rate: float = 3e-3
    seed: int = number(0, 0)

    def rules(self):
        """Raises where the learning rate is none."""
        if not 0 < self.learning_rate < 1:
            raise ValueError(f'learning_rate is {self.learning_rate}, must lie in (0, 1)')


PRESETS = {'soil_field': SoilFieldConfig('soil_field')}
# By tool and network: rows of `samples` that a step takes; times `num_steps`; times
# `learning_rate`. Loads are few, those of a wheel learned by heart; places are many.
_PLACES = (1024, 3, 2.0)
SCHEDULES = {
    'blade': {'load': (512, 2, 1.0), 'surface': (1024, 5, 2.0), 'soil': _PLACES},
    'wheel': {'load': (512, 1, 1.0), 'surface': _PLACES, 'soil': _PLACES},
}
