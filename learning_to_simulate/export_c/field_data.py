"""A trained swept field as the values of `struct lts_field_model`.

All constants come from the modules of the method; what C repeats of them is only their order.
"""

import dataclasses

import numpy as np

from learning_to_simulate.export_c import c_header, c_values, fold
from learning_to_simulate.methods.swept_field import inputs as inputs_lib
from learning_to_simulate.methods.swept_field import live, quality, tool_path

# Fields of lts_field_model.h -> places in `inputs.py`.
_PLACES = {
    'around': inputs_lib.AROUND,
    'since': inputs_lib.SINCE_AROUND,
    'edge': inputs_lib.AT_EDGE,
    'contact': inputs_lib.CONTACT_AROUND,
    'bumps': inputs_lib.BUMPS,
}
# What the C code was written for; another table of inputs needs another twin.
_SCALARS = ('tip', 'height', 'lean', 'speed', 'rise', 'turn')
_LAST_SCALARS = ('area', 'foremost', 'half_width', 'end')
_OWN, _OF_TOOL, _OF_EDGE = (
    15,
    8,
    7,
)  # inputs of a particle and of the force that no list of places counts
_RATES = ('speed', 'rise', 'turn')


def values(field) -> dict:
    """The fields of `lts_field_model`.

    Args:
      field: `SweptField`.

    Raises:
      ValueError: inputs, or a tool, that the C code does not know.
    """
    blade = field.blade
    sizes = {name: len(places) for name, places in _PLACES.items()}
    n_motion = 2 + 3 * (1 + len(tool_path.TIME_SCALES))
    counts = {
        'n_seen': _OWN + sizes['bumps'] + 2 * sizes['around'] + sizes['since'],
        'n_shared': _OF_TOOL,
        'n_force': _OF_TOOL + n_motion + 4 * sizes['edge'] + _OF_EDGE,
    }
    _check(field, counts)
    c, n_member = c_header.constants(), field.config.members
    axes, grid = field.axes, field.grid
    points = axes.points(field.rest)
    level = float(points[:, 1].max() + field.spacing / 2)
    soil, load = (_numpy(net) for net in (field.network.soil, field.network.load))
    w, b = soil[0]
    own, shared = w[:, : counts['n_seen']], w[:, counts['n_seen'] :]
    low, high = np.array([field.ranges[name] for name in tool_path.SCALARS]).T
    margin = quality.MARGIN * (high - low) + 1e-6
    result = {
        'abi': c['LTS_ABI'],
        'n_soil': len(field.rest),
        'n_member': n_member,
        'n_scalar': len(tool_path.SCALARS),
        'axis': axes.axis,
        'sign': axes.sign,
        'up': axes.up,
        'turn': int(axes.world_loads(np.array([0.0, 0.0, 1.0]))[1][axes.across]),
        'name': field.scene.name,
        'scalar_names': ','.join(tool_path.SCALARS),
        'middle': axes.middle,
        'dt': field.scene.dt,
        'start_u': float(points[:, 0].max() + field.spacing / 2 - _from_end(field)),
        'start_height': level,
        'n_bin': len(grid.offsets),
        'n_pad': 2
        + int(np.abs([*inputs_lib.AROUND, *inputs_lib.SINCE_AROUND]).max() / grid.spacing),
        'n_scale': len(tool_path.TIME_SCALES),
        'first': grid.offsets[0],
        'bin': grid.spacing,
        'radius': grid.radius,
        'forget': grid.forget,
        'time_scales': np.array(tool_path.TIME_SCALES),
        'touch': tool_path.TOUCH,
        'reach': tool_path.REACH,
        'rise': tool_path.RISE,
        'width': blade.width,
        'blade_radius': blade.radius,
        'length': blade.length,
        'kept_spacing': field.kept_spacing,
        'spacing': field.spacing,
        'fastest': live.FASTEST,
        'fastest_turn': live.FASTEST_TURN,
        'rest': field.rest,
        'bump_width': inputs_lib.BUMP_WIDTH,
        'recent': inputs_lib.RECENT,
        'below': inputs_lib.BELOW,
        'below_ramp': inputs_lib.BELOW_RAMP,
        'beside': inputs_lib.BESIDE,
        'beside_ramp': inputs_lib.BESIDE_RAMP,
        'heap_height': inputs_lib.HEAP_HEIGHT,
        'contact_above': inputs_lib.CONTACT_ABOVE,
        'contact_ramp': inputs_lib.CONTACT_RAMP,
        'first_bin': grid.offsets[0],
        'bin_width': grid.spacing,
        'n_soil_hidden': len(soil) - 2,
        'n_load_hidden': len(load) - 2,
        'latent': field.config.latent_size,
        'load_latent': field.config.force_latent_size,
        'soil_first': [fold.dense(part) for part in own],
        'soil_hidden': _layers(soil[1:-1]),
        'soil_last': _layers(soil[-1:]),
        'soil_shared': fold.dense(*_together(shared, b)),
        'load_first': fold.dense(*_together(*load[0])),
        'load_hidden': _layers(load[1:-1]),
        'load_last': _layers(load[-1:]),
        'displacement': inputs_lib.DISPLACEMENT,
        'force': inputs_lib.FORCE,
        'torque': inputs_lib.TORQUE,
        'full_width': inputs_lib.WIDTH,
        'limits': np.stack([low - margin, high + margin]),
        'bits': np.array([c[_bit(name)] for name in tool_path.SCALARS]),
        'gain_limit': inputs_lib.GAIN_LIMIT,
        'bound': np.array(field.calibration.get('force', ())),
        **counts,
        **{name: places for name, places in _PLACES.items()},
        **{f'n_{name.rstrip("s")}': size for name, size in sizes.items()},
    }
    return result | {'digest': c_values.digest(result)}


def _check(field, counts):
    scales = tool_path.TIME_SCALES
    scalars = [*_SCALARS, *(f'{n}_{i}' for i in range(len(scales)) for n in _RATES), *_LAST_SCALARS]
    n_soil, n_force = field.network.sizes
    if list(tool_path.SCALARS) != scalars or tool_path.CHANNELS != 6:
        raise ValueError(f'the C form of a swept field does not know the scalars {scalars}')
    if (counts['n_seen'] + counts['n_shared'], counts['n_force']) != (n_soil, n_force):
        raise ValueError(
            f'the networks take {n_soil} and {n_force} inputs, the C form of a swept field has '
            f'{counts["n_seen"] + counts["n_shared"]} and {counts["n_force"]}'
        )
    limit = c_header.constants()['LTS_FIELD_SCALES']
    if len(scales) > limit:
        raise ValueError(f'{len(scales)} memories of the velocity, the C form has at most {limit}')
    if max(map(len, _PLACES.values())) > 32:
        raise ValueError('the C form of a swept field looks at no more than 32 places')
    if field.config.hidden_layers < 1:
        raise ValueError('a swept field without hidden layers has no C form')
    expected = {'width', 'radius', 'length'}
    if {f.name for f in dataclasses.fields(field.blade)} != expected:
        raise ValueError(f'the C form knows of a blade {sorted(expected)} only')


def _from_end(field):
    """Distance of a usual first place from the end of the bed, m."""
    return float(np.mean(field.ranges['end']))


def _bit(name):
    if name == 'half_width':
        return 'LTS_OUTSIDE_CONTEXT'
    return 'LTS_OUTSIDE_SPEED' if name.split('_')[0] in _RATES else 'LTS_OUTSIDE_POSE'


def _numpy(net):
    """[(w [M, in, out], b [M, out])] of all layers, float64."""
    return [tuple(np.asarray(v, np.float64) for v in (w, b[:, 0])) for w, b in net.layers]


def _layers(layers):
    """`lts_dense` of some layers, member by member."""
    n_member = len(layers[0][0]) if layers else 0
    return [fold.dense(w[m], b[m]) for m in range(n_member) for w, b in layers]


def _together(w, b):
    """One layer of all members' w [M, in, out] and b [M, out], each padded to whole panels."""
    return fold.side_by_side(list(zip(w, b)))
