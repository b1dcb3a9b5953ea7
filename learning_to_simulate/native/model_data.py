"""A trained model as the values of `struct lts_model`."""

import numpy as np

from learning_to_simulate import rollout_status
from learning_to_simulate.native import c_values, library, network_data
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.subspace import contact, features
from learning_to_simulate.subspace.learned_simulator import RATE_FLOOR
from pca_tools.subspace import Subspace

_MOTIONS = {
    RigidMotion.NONE: 'LTS_NO_BODY',
    RigidMotion.PRESCRIBED: 'LTS_PRESCRIBED',
    RigidMotion.DRIVEN: 'LTS_DRIVEN',
    RigidMotion.PREDICTED: 'LTS_PREDICTED',
}
EXPORTED_MODELS = ('gns', 'mlp')
# Inputs of a node that lts_features.c knows, in its order.
_FEATURES = (
    'velocity', 'offset', 'acceleration', 'rate', 'coming', 'height', 'embedding', 'context',
)  # fmt: skip


def refuse(simulator) -> None:
    """Refuses a model that the C code cannot run.

    Raises:
      ValueError: names the model and what it has that C lacks.
    """
    config = simulator.config
    if config.model not in EXPORTED_MODELS:
        raise ValueError(
            f'model {config.model!r} has no C form; exported are {", ".join(EXPORTED_MODELS)}'
        )
    if config.predict_torque:
        raise ValueError('predict_torque: the C form has no torque of a model in a subspace')
    simulator.scene.check_one_body('the C form')
    if simulator.dim != 3:
        raise ValueError(f'the model has {simulator.dim} axes, the C form has 3')
    names = [feature.name for feature in features.of(simulator)]
    if names != [name for name in _FEATURES if name in names]:
        raise ValueError(f'the model has inputs {names}, the C form knows {list(_FEATURES)}')


def motion_of(scene) -> int:
    """The number that `lts.h` has for the motion of a scene's body."""
    return library.constants()[_MOTIONS[scene.rigid_motion]]


def values(
    model,
    n_rigid: int,
    subspace: Subspace | None = None,
    rigid_correction: bool = True,
    starts=(),
) -> dict:
    """The fields of `lts_model` for graphs of R rigid particles.

    Args:
      model: `subspace_model.Model`.
      n_rigid: R.
      subspace: that turns modes into particles, or None.
      rigid_correction: whether a predicted body is kept rigid.
      starts: dicts of `modes` [r, 3], `points` [R, 3] and `context` [C], soil at rest.

    Raises:
      ValueError: a model that has no C form, a body or a subspace that it does not take.
    """
    simulator = model.simulator
    refuse(simulator)
    layout = model.layout(n_rigid)
    scene, config, s = simulator.scene, simulator.config, simulator.statistics
    if config.surface_height and config.model != 'gns':
        raise ValueError('surface_height needs a graph')
    result = {
        'abi': library.constants()['LTS_ABI'],
        'motion': motion_of(scene),
        'name': scene.name,
        'context_names': ','.join(scene.context_names),
        'n_rigid': n_rigid,
        'n_modes': scene.n_modes,
        'n_context': len(scene.context_names),
        'up_axis': scene.up_axis,
        'has_force': int(scene.has_force),
        'is_graph': int(config.model == 'gns'),
        'position_inputs': int(not config.is_published),
        'knows_next': int(simulator.knows_next_frame),
        'rate_scaled': int(simulator.rate_scaled),
        'correction': int(rigid_correction and scene.rigid_motion == RigidMotion.PREDICTED),
        'velocity_inputs': config.velocity_inputs,
        'mode_order': config.mode_order,
        'rigid_order': config.rigid_order,
        'has_log_context': int(s.log_context_mean is not None),
        'has_height': int(scene.rigid_motion == RigidMotion.DRIVEN and not config.is_published),
        'has_surface': int(bool(config.surface_height)),
        'dt': scene.dt,
        'surface': config.surface_height,
        'rate_floor': RATE_FLOOR,
        'origin': layout.origin,
        'norm_epsilon': network_data.LAYER_NORM_EPSILON,
    }
    for name in ('body_speed', 'height_std', 'height_velocity_std'):
        value = getattr(s, name)
        result[name] = 1.0 if value is None else float(value[0])
    for name in ('position_std', 'velocity_mean', 'velocity_std', 'acceleration_mean',
                 'acceleration_std', 'target_mean', 'target_std'):  # fmt: skip
        result[name] = getattr(s, name)[layout.node_class]
    for name in ('context_mean', 'context_std', 'log_context_mean', 'log_context_std'):
        result[name] = getattr(s, name)
    if layout.contact is not None:
        result |= _contact(layout.contact)
    result |= _ranges(s, layout.node_class)
    result |= network_data.values(simulator, layout)
    if subspace is not None:
        result |= _particles(model.fitting_subspace(subspace), layout.origin[n_rigid:])
    result |= {'n_start': len(starts), 'starts': [dict(start) for start in starts]}
    return result | {'digest': c_values.digest(result)}


def _contact(reader):
    """Where a body shows no force."""
    return {
        'n_place': len(reader.places),
        'way_axis': reader.axis,
        'clear': reader.clear,
        'clear_ramp': contact.RAMP,
        'clear_slope': contact.SLOPE,
        'places': reader.places,
        'place_heights': reader.heights,
        'place_weights': np.moveaxis(reader.weights, -1, 0),
    }


def _ranges(s, node_class):
    """Limits of `rollout_status`, widened as there."""
    widened, extra = rollout_status.widened, 1 + 2 * rollout_status.RANGE_MARGIN
    ranges = {
        'bounds': np.stack(widened(*s.position_range, rollout_status.BOUNDS_FACTOR))[:, node_class],
        'start_range': np.stack(widened(*s.position_range, extra))[:, node_class],
    }
    for name in ('given_range', 'given_velocity_range', 'body_extent_range', 'body_speed_range'):
        limits = getattr(s, name)
        if limits is not None:
            ranges[name.replace('body_', '')] = np.stack(widened(*limits, extra))
    if s.context_range is not None:
        low, high = s.context_range
        margin = rollout_status.RANGE_MARGIN
        ranges['context_range'] = np.stack([low - margin * abs(low), high + margin * abs(high)])
    return ranges


def _particles(subspace, origin):
    """The subspace for offsets from the modes' origin, particles side by side."""
    panel = library.constants()['LTS_PANEL']
    mean = np.broadcast_to(subspace.mean, (subspace.n_soil, 3)) + subspace.components @ origin
    more = ((0, 0), (0, -subspace.n_soil % panel))
    return {
        'n_soil': subspace.n_soil,
        'components': np.pad(subspace.components.T, more).astype(np.float32),
        'mean': np.pad(mean.T, more).astype(np.float32),
    }
