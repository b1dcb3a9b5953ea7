"""What the C form knows of a blade: its part of `struct lts_field_model`, see `field_data`."""

import dataclasses

import numpy as np

from learning_to_simulate.export_c import c_header
from learning_to_simulate.methods.swept_field import inputs as inputs_lib
from learning_to_simulate.methods.swept_field import tool_path

# Fields of lts_field_model.h -> places in `inputs.py`.
_PLACES = {
    'around': inputs_lib.AROUND,
    'since': inputs_lib.SINCE_AROUND,
    'edge': inputs_lib.AT_EDGE,
    'contact': inputs_lib.CONTACT_AROUND,
    'bumps': inputs_lib.BUMPS,
}
# What the C code was written for; another table of inputs needs another twin.
_RATES = ('speed', 'rise', 'turn')
_SCALARS = ('tip', 'height', 'lean', *_RATES)
_LAST_SCALARS = ('area', 'foremost', 'half_width', 'end', 'room')
# Inputs of a particle and of the force that no list of places counts.
_OWN, _OF_TOOL, _OF_EDGE = 19, 8, 7


def values(field) -> dict:
    """The fields that are a blade's; `places`, `inputs` (sizes of the places -> own, shared and
    force inputs) and `bit` (name of a scalar -> status bit) are for `field_data`.

    Raises:
      ValueError: scalars or a blade that the C code does not know.
    """
    blade = field.tool
    _check(blade)
    along = field.axes.points(field.rest)[:, 0]
    # A usual first place is so far from the end of the bed, m.
    from_end = float(np.mean(field.ranges['end']))
    return {
        'places': _PLACES,
        'inputs': _inputs,
        'bit': _bit,
        'tool': c_header.constants()['LTS_FIELD_BLADE'],
        'start_u': float(along.max() + field.spacing / 2 - from_end),
        'n_scale': len(tool_path.TIME_SCALES),
        'time_scales': np.array(tool_path.TIME_SCALES),
        'reach': tool_path.REACH,
        'rise': tool_path.RISE,
        'width': blade.width,
        'blade_radius': blade.radius,
        'length': blade.length,
        'bump_width': inputs_lib.BUMP_WIDTH,
        'recent': inputs_lib.RECENT,
        'below': inputs_lib.BELOW,
        'below_ramp': inputs_lib.BELOW_RAMP,
        'beside': inputs_lib.BESIDE,
        'beside_ramp': inputs_lib.BESIDE_RAMP,
        'heap_height': inputs_lib.HEAP_HEIGHT,
        'contact_above': inputs_lib.CONTACT_ABOVE,
        'contact_ramp': inputs_lib.CONTACT_RAMP,
        'displacement': inputs_lib.DISPLACEMENT,
        'force': inputs_lib.FORCE,
        'torque': inputs_lib.TORQUE,
        'full_width': inputs_lib.WIDTH,
        'gain_limit': inputs_lib.GAIN_LIMIT,
        'context_names': '',
    }


def _inputs(sizes):
    n_motion = 2 + len(_RATES) * (1 + len(tool_path.TIME_SCALES))
    own = _OWN + sizes['bumps'] + 2 * sizes['around'] + sizes['since']
    return own, _OF_TOOL, _OF_TOOL + n_motion + 4 * sizes['edge'] + _OF_EDGE


def _check(blade):
    n_scale, limit = len(tool_path.TIME_SCALES), c_header.constants()['LTS_FIELD_SCALES']
    scalars = (*_SCALARS, *(f'{n}_{i}' for i in range(n_scale) for n in _RATES), *_LAST_SCALARS)
    if blade.scalars != scalars or tool_path.CHANNELS != 6:
        raise ValueError(f'the C form of a swept field does not know the scalars {blade.scalars}')
    if n_scale > limit:
        raise ValueError(f'{n_scale} memories of the velocity, the C form has at most {limit}')
    expected = {'width', 'radius', 'length'}
    if {f.name for f in dataclasses.fields(blade)} != expected:
        raise ValueError(f'the C form knows of a blade {sorted(expected)} only')


def _bit(name):
    if name == 'half_width':
        return 'LTS_OUTSIDE_CONTEXT'
    return 'LTS_OUTSIDE_SPEED' if name.split('_')[0] in _RATES else 'LTS_OUTSIDE_POSE'
