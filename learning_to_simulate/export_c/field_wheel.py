"""What the C form knows of a wheel: its part of `struct lts_field_model`, see `field_data`."""

import numpy as np

from learning_to_simulate.export_c import c_header
from learning_to_simulate.live import poses
from learning_to_simulate.methods.swept_field import wheel_inputs, wheel_path

# Fields of lts_field_model.h -> places in `wheel_inputs.py`.
_PLACES = {
    'around': wheel_inputs.AROUND,
    'since': wheel_inputs.SLIP_AROUND,
    'edge': wheel_inputs.AT_CONTACT,
}
# What the C code was written for; another table of inputs needs another twin.
_RATES = ('speed', 'rim')
_LAST_SCALARS = (
    'travelled', 'slipped', 'foremost', 'rearmost', 'load', 'frame_load', 'peak_load', 'first_load',
    'radius', 'half_width', 'gravity', 'friction', 'sunk', 'contact', 'end', 'room',
    'stirred', 'height', 'area',
)  # fmt: skip
_CONTEXT = {'load', 'frame_load', 'peak_load', 'first_load', 'radius', 'half_width', 'gravity',
            'friction'}  # fmt: skip
# Inputs of a particle, of the drive and of the force that no list of places counts.
_OWN, _OF_DRIVE, _OF_END = 22, 18, 1


def values(field, starts, subspace) -> dict:
    """The fields that are a wheel's; see `field_blade.values`.

    Args:
      field: `SweptField`.
      starts, subspace: of the model folder (`resting_start.read`).

    Raises:
      ValueError: scalars that the C code does not know; no starts; too long a context.
    """
    _check(field)
    if starts is None or starts.context is None:
        raise ValueError('the C form of a wheel needs its recorded starts and their contexts')
    names = field.scene.context_names
    spread = starts.context.std(axis=0)
    result = {
        'places': _PLACES,
        'inputs': _inputs,
        'bit': _bit,
        'tool': c_header.constants()['LTS_FIELD_WHEEL'],
        'n_scale': len(wheel_path.TIME_SCALES),
        'time_scales': np.array(wheel_path.TIME_SCALES),
        'reach': wheel_path.REACH,
        'rise': wheel_path.RISE,
        'recent': wheel_inputs.RECENT,
        'below': wheel_inputs.BELOW,
        'below_ramp': wheel_inputs.BELOW_RAMP,
        'beside': wheel_inputs.BESIDE,
        'beside_ramp': wheel_inputs.BESIDE_RAMP,
        'sheared': wheel_inputs.SHEARED,
        'density': wheel_inputs.DENSITY,
        'vertical': wheel_inputs.VERTICAL,
        'least_sunk': wheel_inputs.LEAST_SUNK,
        'stir': wheel_path.STIR,
        'stir_load': wheel_path.STIR_LOAD,
        'borne': wheel_path.BORNE,
        'displacement': wheel_inputs.DISPLACEMENT,
        'n_context': len(names),
        'n_start': len(starts),
        'context_names': ','.join(names),
        'gravity': names.index('gravity'),
        'friction': names.index('friction_angle_deg'),
        'load': names.index('load'),
        'context_scale': np.where(spread > 0, spread, 1.0),
    }
    n_mode = 0
    result['bed_mean'] = field.rest
    if subspace is not None:
        n_mode = subspace.n_modes
        result |= {
            'bed_mean': subspace.decode(np.zeros((n_mode, 3))),
            'bed_components': subspace.components,
        }
    result['starts'] = [_start(field, starts, i, n_mode) for i in range(len(starts))]
    return result | {'n_mode': n_mode}


def _start(field, starts, i, n_mode):
    """`lts_field_start_data` of one start."""
    nodes = poses.placed(starts.body[i][starts.kept[i]], starts.pose[i])
    context = starts.context[i]
    size = field.tool.size(field.axes, starts.cases[i], nodes, field.context(context))
    return {
        'pose': starts.pose[i],
        'radius': size[wheel_path.RADIUS],
        'width': size[wheel_path.WIDTH],
        'context': context,
        'modes': starts.modes[i][:n_mode],
    }


def _inputs(sizes):
    own = _OWN + 3 * sizes['around'] + 5 * sizes['since']
    rates = 3 * (1 + len(wheel_path.TIME_SCALES))
    return own, _OF_DRIVE + 1, _OF_DRIVE + rates + 4 * sizes['edge'] + _OF_END


def _check(field):
    n_scale, c = len(wheel_path.TIME_SCALES), c_header.constants()
    rates = (f'{name}_{i}' for i in range(n_scale) for name in _RATES)
    scalars = ('tip', 'rolled', *_RATES, *rates, *_LAST_SCALARS)
    if field.tool.scalars != scalars or wheel_path.CHANNELS != 9:
        raise ValueError(
            f'the C form of a swept field does not know the scalars {field.tool.scalars}'
        )
    if n_scale > (limit := c['LTS_FIELD_SCALES']):
        raise ValueError(f'{n_scale} memories of the velocity, the C form has at most {limit}')
    if (n := len(field.scene.context_names)) > (limit := c['LTS_FIELD_CONTEXT']):
        raise ValueError(f'a context of {n} values, the C form has at most {limit}')


def _bit(name):
    if name in _CONTEXT:
        return 'LTS_OUTSIDE_CONTEXT'
    return 'LTS_OUTSIDE_SPEED' if name.split('_')[0] in _RATES else 'LTS_OUTSIDE_POSE'
