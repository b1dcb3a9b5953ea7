"""A trained swept field as the values of `struct lts_field_model`.

All constants come from the modules of the method, and the tables of inputs go along as data: what C
repeats is only the order of a frame's scalars.
"""

import numpy as np

from learning_to_simulate.live import poses
from learning_to_simulate.native import c_values, fold, library, tables
from learning_to_simulate.swept_field import engine
from learning_to_simulate.swept_field.calibration import LEAST_SPEED
from learning_to_simulate.swept_field.network import ACROSS, LOAD_HIDDEN
from learning_to_simulate.tool import Wheel, blade, wheel

# Status of what leaves its range, by its name; of all other numbers it is LTS_OUTSIDE_POSE.
_BITS = {
    'LTS_OUTSIDE_CONTEXT': (
        'half_width', 'load', 'frame_load', 'peak_load', 'first_load', 'radius', 'gravity',
        'friction',
    ),
    'LTS_OUTSIDE_START': ('bed_low', 'bed_high'),
    'LTS_OUTSIDE_SPEED': ('speed', 'rise', 'turn', 'rim', 'drift', 'frame_time'),
}  # fmt: skip


def values(field, starts=None, subspace=None) -> dict:
    """The fields of `lts_field_model`.

    Args:
      field: `SweptField`.
      starts, subspace: of the model folder (`live.starts.read`); a wheel needs its starts.

    Raises:
      ValueError: a network or inputs that the C code cannot run; a wheel without starts.
    """
    if field.config.hidden_layers < 1:
        raise ValueError('a swept field without hidden layers has no C form')
    tool = field.tool
    of_tool, c, limits = tool.tables, library.constants(), field.limits
    axes, grid = field.axes, field.grid
    soil, load = (_numpy(net) for net in (field.network.soil, field.network.load))
    w, b = soil[0]
    n_own = len(of_tool.own)
    reach = max(np.abs(row.at).max() for row in of_tool.own.rows if row.at)
    result = {
        'abi': c['LTS_ABI'],
        'n_soil': len(field.rest),
        'n_member': field.config.members,
        'n_scalar': len(tool.scalars),
        'axis': axes.axis,
        'sign': axes.sign,
        'up': axes.up,
        'turn': int(axes.world_loads(np.array([0.0, 0.0, 1.0]))[1][axes.across]),
        'name': field.scene.name,
        'scalar_names': ','.join(limits.names),
        'middle': axes.middle,
        'dt': field.scene.dt,
        'n_bin': len(grid.offsets),
        'n_pad': 2 + int(reach / grid.spacing),
        'n_behind': int(np.flatnonzero(grid.offsets == 0)[0]),
        'first': grid.offsets[0],
        'bin': grid.spacing,
        'radius': grid.radius,
        'forget': grid.forget,
        'touch': blade.TOUCH,
        'kept_spacing': field.kept_spacing,
        'spacing': field.spacing,
        'fastest': engine.FASTEST,
        'fastest_turn': engine.FASTEST_TURN,
        'rest': field.rest,
        'first_bin': grid.offsets[0],
        'bin_width': grid.spacing,
        'n_soil_hidden': len(soil) - 2,
        'n_load_hidden': len(load) - 2,
        'latent': field.config.latent_size,
        'load_latent': LOAD_HIDDEN[0],
        'soil_first': [fold.dense(part) for part in w[:, :n_own]],
        'soil_hidden': _layers(soil[1:-1]),
        'soil_last': _layers(soil[-1:]),
        'soil_shared': fold.dense(*_together(w[:, n_own:], b)),
        'load_first': fold.dense(*_together(*load[0])),
        'load_hidden': _layers(load[1:-1]),
        'load_last': _layers(load[-1:]),
        'least_speed': LEAST_SPEED,
        'limits': np.stack([*limits.limits, limits.low, limits.high]),
        'bits': np.array([c[_bit(name)] for name in limits.names]),
        'bound': np.array(field.calibration.get('force', ())),
        'n_seen': n_own,
        'n_shared': len(of_tool.shared),
        'n_force': len(of_tool.force),
        'own': _table(of_tool.own, tool),
        'shared': _table(of_tool.shared, tool),
        'force_inputs': _table(of_tool.force, tool),
        'below': tool.below,
        'below_ramp': tool.below_ramp,
        'beside': tool.beside,
        'beside_ramp': tool.beside_ramp,
        'displacement': tool.displacement,
        'across': ACROSS,
    }
    result |= _of_wheel(field, starts, subspace) if isinstance(tool, Wheel) else _of_blade(field)
    return result | {'digest': c_values.digest(result)}


def _of_blade(field):
    """The fields that are a blade's."""
    tool, (u, height, _) = field.tool, field.axes.points(field.rest).max(axis=0)
    end, level = u + field.spacing / 2, height + field.spacing / 2
    # Where a blade may begin: as far from the end of the bed as usual, 1 cm over it, m.
    from_end = float(np.mean(field.ranges['end']))
    start = field.axes.world([end - from_end, level + tool.radius + 0.01, 0.0])
    start[field.axes.across] = field.axes.middle
    return {
        'tool': library.constants()['LTS_FIELD_BLADE'],
        'level': level,
        'start': start,
        'n_scale': len(blade.TIME_SCALES),
        'time_scales': np.array(blade.TIME_SCALES),
        'reach': blade.REACH,
        'rise': blade.RISE,
        'steep': blade.STEEP,
        'width': tool.width,
        'blade_radius': tool.radius,
        'length': tool.length,
        'n_contact': len(blade.CONTACT_AROUND),
        'contact': np.array(blade.CONTACT_AROUND),
        'heap_height': blade.HEAP_HEIGHT,
        'contact_above': blade.CONTACT_ABOVE,
        'contact_ramp': blade.CONTACT_RAMP,
        'force': blade.FORCE,
        'torque': blade.TORQUE,
        'full_width': blade.WIDTH,
        'gain_limit': blade.GAIN_LIMIT,
        'context_names': '',
    }


def _of_wheel(field, starts, subspace):
    """The fields that are a wheel's."""
    c, names = library.constants(), field.scene.context_names
    if starts is None or starts.context is None:
        raise ValueError('the C form of a wheel needs its recorded starts and their contexts')
    if len(names) > (limit := c['LTS_FIELD_CONTEXT']):
        raise ValueError(f'a context of {len(names)} values, the C form has at most {limit}')
    spread = starts.context.std(axis=0)
    result = {
        'tool': c['LTS_FIELD_WHEEL'],
        'n_scale': len(wheel.TIME_SCALES),
        'time_scales': np.array(wheel.TIME_SCALES),
        'reach': wheel.REACH,
        'rise': wheel.RISE,
        'vertical': wheel.VERTICAL,
        'least_sunk': wheel.LEAST_SUNK,
        'stir': wheel.STIR,
        'stir_load': wheel.STIR_LOAD,
        'borne': wheel.BORNE,
        'n_context': len(names),
        'n_start': len(starts),
        'context_names': ','.join(names),
        'gravity': names.index('gravity'),
        'friction': names.index('friction_angle_deg'),
        'load': names.index('load'),
        'context_scale': np.where(spread > 0, spread, 1.0),
        'bed_mean': field.rest,
        'level': field.axes.points(field.rest)[:, 1].max() + field.spacing / 2,
        'start': starts.pose[0, :3],
        'n_mode': 0 if subspace is None else subspace.n_modes,
    }
    if subspace is not None:
        result |= {
            'bed_mean': subspace.decode(np.zeros((subspace.n_modes, 3))),
            'bed_components': subspace.components,
        }
    result['starts'] = [_start(field, starts, i, result['n_mode']) for i in range(len(starts))]
    return result


def _start(field, starts, i, n_mode):
    """`lts_field_start_data` of one start."""
    nodes = poses.placed(starts.body[i][starts.kept[i]], starts.pose[i])
    context = starts.context[i]
    size = field.tool.size(field.axes, starts.cases[i], nodes, field.context(context))
    return {
        'pose': starts.pose[i],
        'radius': size[wheel.RADIUS],
        'width': size[wheel.WIDTH],
        'context': context,
        'modes': starts.modes[i][:n_mode],
    }


def _bit(name):
    """The status of a number that is outside its range; memories end with theirs."""
    plain = name.rstrip('_0123456789')
    return next((bit for bit, names in _BITS.items() if plain in names), 'LTS_OUTSIDE_POSE')


def _table(table, tool):
    """`lts_table` of a table."""
    channels = {name: library.constants()[f'LTS_{name.upper()}'] for name in tool.channels}
    return tables.values(table, tool.scalars, channels)


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
