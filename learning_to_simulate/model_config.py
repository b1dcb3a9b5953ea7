"""What `config.json` of a model folder says, checked before any variable is made of it."""

import dataclasses
import math

import numpy as np

from learning_to_simulate.config import MAX_MODES, MAX_RIGID, TrainConfig
from learning_to_simulate.normalization import Statistics
from learning_to_simulate.scene import RigidMotion, Scene

_NUMBER_OF_TYPES = 9
MAX_PLACES = 10_000
# What a field of a damaged or foreign file raises where it is read.
WRONG_FIELD = (KeyError, TypeError, ValueError, AttributeError, OverflowError)


@dataclasses.dataclass(frozen=True)
class ModelConfig:
    """The parts of `config.json` that say what a model is.

    Attributes:
      config: `TrainConfig`.
      scene: `Scene`.
      statistics: `Statistics`.
      particle_types: of the rigid particles and of the modes.
      n_rigid: an R that the model runs on.
      mode_mask: bool [r, r], or None.
      loaded_mask: bool [V, V], or None.
      edge_source: where the edges come from, or None.
    """

    config: TrainConfig
    scene: Scene
    statistics: Statistics
    particle_types: tuple[int, int]
    n_rigid: int
    mode_mask: np.ndarray | None
    loaded_mask: np.ndarray | None
    edge_source: str | None


def parse(values: dict, source: str) -> ModelConfig:
    """Checks the values of `config.json` and gives them their types.

    Args:
      values: the JSON object.
      source: its file, for messages.

    Raises:
      ValueError: a field is missing, unknown, of another type, or fits no model.
    """
    try:
        config, scene, types = config_and_scene(values)
        statistics = Statistics.from_json(values['statistics'])
        _check_statistics(statistics, scene, config.predict_torque)
        n_rigid = values['n_rigid']
        _require(_is_int(n_rigid, 0, MAX_RIGID), 'n_rigid', n_rigid)
        source_of_edges = values.get('edge_source')
        _require(isinstance(source_of_edges, str | None), 'edge_source', source_of_edges)
        masks = [_mask(values[key], key) for key in ('mode_mask', 'loaded_mask')]
    except WRONG_FIELD as error:
        raise ValueError(f'{source}: a field is missing, unknown or wrong ({error})') from error
    return ModelConfig(config, scene, statistics, types, n_rigid, *masks, source_of_edges)


def config_and_scene(values: dict) -> tuple[TrainConfig, Scene, tuple[int, int]]:
    """The checked `TrainConfig`, scene and particle types of any model's `config.json`.

    Raises:
      one of `WRONG_FIELD`: a field is missing, unknown or wrong.
    """
    config, scene = TrainConfig(**values['config']), Scene.from_json(values['scene'])
    _check_scene(scene)
    _require(config.modes in (0, scene.n_modes), 'modes', config.modes)
    types = values['particle_types']
    _require(
        isinstance(types, list)
        and len(types) == 2
        and all(_is_int(t, 0, _NUMBER_OF_TYPES - 1) for t in types),
        'particle_types',
        types,
    )
    return config, scene, tuple(types)


def _require(condition, name, value):
    if not condition:
        raise ValueError(f'{name} is {value!r}')


def _is_int(value, low, high):
    return isinstance(value, int) and not isinstance(value, bool) and low <= value <= high


def _is_finite(value):
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _check_scene(scene):
    _require(isinstance(scene.name, str), 'scene.name', scene.name)
    _require(_is_int(scene.n_modes, 1, MAX_MODES), 'scene.n_modes', scene.n_modes)
    _require(isinstance(scene.rigid_motion, RigidMotion), 'rigid_motion', scene.rigid_motion)
    _require(isinstance(scene.has_force, bool), 'scene.has_force', scene.has_force)
    _require(scene.n_soil is None or _is_int(scene.n_soil, 1, 2**31), 'scene.n_soil', scene.n_soil)
    _require(_is_finite(scene.dt) and scene.dt > 0, 'scene.dt', scene.dt)
    _require(_is_int(scene.up_axis, 0, 2), 'scene.up_axis', scene.up_axis)
    radius = scene.connectivity_radius
    _require(_is_finite(radius) and radius > 0, 'scene.connectivity_radius', radius)
    _require(all(isinstance(n, str) for n in scene.context_names), 'context_names', '...')
    for name, count in scene.bodies:
        _require(isinstance(name, str) and _is_int(count, 1, MAX_RIGID), 'body', (name, count))
    for edge in scene.rigid_edges:
        _require(len(edge) == 2 and all(_is_int(end, 0, MAX_RIGID) for end in edge), 'edge', edge)


def _check_statistics(statistics, scene, predict_torque=False):
    classes, context = scene.n_modes + 1, len(scene.context_names)
    dim = statistics.origin.shape[-1] if statistics.origin.ndim else 0
    _require(dim in (2, 3), 'statistics.origin of shape', statistics.origin.shape)
    force = dim  # of one body, or of all together, or of each
    if scene.bodies and statistics.force_mean is not None and statistics.force_mean.size > dim:
        force = dim * len(scene.bodies)
    shapes = {
        'displacement_mean': (classes, classes, dim), 'displacement_std': (classes, classes, dim),
        'force_mean': (force,), 'force_std': (force,), 'torque_mean': (dim,), 'torque_std': (dim,),
        'height_std': (1,), 'height_velocity_std': (1,), 'path': (5,), 'contact': (2,),
        'body_speed': (1,), 'context_mean': (context,), 'context_std': (context,),
        'log_context_mean': (context,), 'log_context_std': (context,),
        'position_range': (2, classes, dim), 'given_range': (2, dim),
        'given_velocity_range': (2, dim),
        'body_extent_range': (2, dim), 'body_speed_range': (2, 1), 'context_range': (2, context),
    }  # fmt: skip
    if statistics.surface is not None:
        places = statistics.surface.shape[0] if statistics.surface.ndim else 0
        _require(0 < places <= MAX_PLACES, 'places of statistics.surface', places)
        shapes['surface'] = (places, 2 + scene.n_modes * dim)
    contact, surface = statistics.contact is not None, statistics.surface is not None
    _require(contact == surface, 'presence of statistics.contact', contact)
    if contact:
        axis = float(statistics.contact.flat[0]) if statistics.contact.size else None
        wanted = set(range(dim)) - {scene.up_axis}
        _require(axis in wanted, 'axis of statistics.contact', axis)
        prescribed = scene.rigid_motion == RigidMotion.PRESCRIBED and not scene.bodies
        _require(prescribed and scene.has_force, 'statistics.contact of the scene', scene.name)
    for field in dataclasses.fields(statistics):
        value = getattr(statistics, field.name)
        if value is None:
            _require(type(None) in getattr(field.type, '__args__', ()), field.name, None)
            continue
        expected = shapes.get(field.name, (classes, dim))
        _require(value.shape == expected, f'statistics.{field.name} of shape', value.shape)
        _require(bool(np.isfinite(value).all()), f'statistics.{field.name}', 'not finite')
        if field.name.endswith('_std') or field.name == 'body_speed':
            _require(bool((value > 0).all()), f'statistics.{field.name}', 'not positive')
        if field.name.endswith('_range'):
            _require(bool((value[0] <= value[1]).all()), f'statistics.{field.name}', 'upside down')
    has_load = scene.has_force and not scene.bodies
    _require(has_load or not predict_torque, 'predict_torque', predict_torque)
    wanted = {'force': scene.has_force, 'torque': predict_torque, 'context': bool(context)}
    for name, present in wanted.items():
        for end in ('mean', 'std'):
            value = getattr(statistics, f'{name}_{end}')
            _require((value is not None) == present, f'presence of statistics.{name}_{end}', value)


def _mask(value, name):
    if value is None:
        return None
    _require(
        isinstance(value, list)
        and value
        and all(isinstance(row, list) and len(row) == len(value) for row in value)
        and all(_is_int(entry, 0, 1) for row in value for entry in row),
        name,
        'not a square of 0 and 1',
    )
    return np.array(value, bool)
