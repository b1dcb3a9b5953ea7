"""Simulator of soil moved by a rigid body: learned, in a subspace, in real time.

A TensorFlow 2 system in the shape of DeepMind's `learning_to_simulate` (Sanchez-Gonzalez et al.,
ICML 2020). Public names are loaded when they are first used, so that importing the package costs
no import of TensorFlow. The letters of docstrings, [T, V, D] and so on: `WORKSPACE.md`.
"""

import importlib

from learning_to_simulate._version import __version__

# Public name -> the module it lives in, and its name there.
_HOMES = {
    'Dataset': 'api.Dataset', 'TrainedModel': 'api.TrainedModel', 'load': 'api.load',
    'list': 'shipped.names', 'preset': 'api.preset', 'train': 'api.train',
    'RolloutStatus': 'rollout_status.RolloutStatus',
    'Terrain': 'soil_field.terrain.Terrain', 'Soil': 'soil_field.tools.Soil',
    'Blade': 'soil_field.tools.Blade', 'Wheel': 'soil_field.tools.Wheel',
    'read_tool': 'soil_field.tools.read_tool', 'LoadedTool': 'soil_field.loaded.LoadedTool',
}  # fmt: skip
__all__ = ['__version__', *(name for name in _HOMES if name != 'list')]  # `import *` keeps list


def __getattr__(name):
    if name not in _HOMES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    module, _, attribute = _HOMES[name].rpartition('.')
    return getattr(importlib.import_module(f'{__name__}.{module}'), attribute)


def __dir__():
    return sorted([*__all__, 'list'])
