"""Which network a model is made of: the one place that maps `TrainConfig.model` to code."""

import functools

from learning_to_simulate.learned_simulator import LearnedSimulator
from learning_to_simulate.mixer_model import MotionMixer
from learning_to_simulate.mlp_model import StateMLP
from learning_to_simulate.whole_state import WholeStateSimulator

_WHOLE_STATE = {
    'mlp': StateMLP,
    'mixer_se': functools.partial(MotionMixer, of_frames=False),
    'mixer_scse': functools.partial(MotionMixer, of_frames=True),
}


def make_simulator(scene, config, statistics, particle_types=(0, 6)) -> LearnedSimulator:
    """A simulator in the subspace, of the kind that the config names.

    Args:
      scene, config, statistics, particle_types: as `LearnedSimulator`.

    Raises:
      ValueError: a model that does not live in the subspace (full_space has its own package).
    """
    if config.model == 'gns':
        return LearnedSimulator(scene, config, statistics, particle_types)
    if config.model not in _WHOLE_STATE:
        raise ValueError(f'model {config.model!r} is not one of a subspace')
    make = _WHOLE_STATE[config.model]
    return WholeStateSimulator(make, scene, config, statistics, particle_types)
