"""A trained swept field as the values of `struct lts_field_model`.

All constants come from the modules of the method, and the tables of inputs go along as data: what C
repeats is only the order of a frame's scalars.
"""

import numpy as np

from learning_to_simulate.live import starts as live_starts
from learning_to_simulate.native import c_values, field_blade, field_wheel, fold, library
from learning_to_simulate.swept_field import engine
from learning_to_simulate.swept_field import field as field_lib
from learning_to_simulate.swept_field.calibration import CONDITIONS, LEAST_SPEED
from learning_to_simulate.swept_field.network import ACROSS, LOAD_HIDDEN
from learning_to_simulate.tool import Wheel, blade, inputs


def read(model_path: str):
    """A field, and the `starts` and `subspace` that `values` takes, by name: of a wheel.

    Raises:
      FileNotFoundError, ValueError: as `field.load` and `live_starts.read`.
    """
    field = field_lib.load(model_path)
    if not isinstance(field.tool, Wheel):
        return field, {}
    starts, subspace = live_starts.read(model_path)
    return field, {'starts': starts, 'subspace': subspace}


def values(field, starts=None, subspace=None) -> dict:
    """The fields of `lts_field_model`.

    Args:
      field: `SweptField`.
      starts, subspace: of the model folder (`live_starts.read`); a wheel needs its starts.

    Raises:
      ValueError: inputs that the C code does not know; a wheel without starts.
    """
    is_wheel, tool = isinstance(field.tool, Wheel), field.tool
    of_tool = field_wheel.values(field, starts, subspace) if is_wheel else field_blade.values(field)
    known = field_wheel if is_wheel else field_blade
    _check(field, known)
    tables = tool.tables
    n_own = len(tables.own)
    c, names = library.constants(), tool.scalars
    axes, grid = field.axes, field.grid
    points = axes.points(field.rest)
    soil, load = (_numpy(net) for net in (field.network.soil, field.network.load))
    w, b = soil[0]
    own_weights, shared = w[:, :n_own], w[:, n_own:]
    reach = max(np.abs(row.at).max() for row in tables.own.rows if row.at)
    result = {
        'abi': c['LTS_ABI'],
        'n_soil': len(field.rest),
        'n_member': field.config.members,
        'n_scalar': len(names),
        'axis': axes.axis,
        'sign': axes.sign,
        'up': axes.up,
        'turn': int(axes.world_loads(np.array([0.0, 0.0, 1.0]))[1][axes.across]),
        'name': field.scene.name,
        'scalar_names': ','.join(field.limits.names),
        'middle': axes.middle,
        'dt': field.scene.dt,
        'start_height': float(points[:, 1].max() + field.spacing / 2),
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
        'soil_first': [fold.dense(part) for part in own_weights],
        'soil_hidden': _layers(soil[1:-1]),
        'soil_last': _layers(soil[-1:]),
        'soil_shared': fold.dense(*_together(shared, b)),
        'load_first': fold.dense(*_together(*load[0])),
        'load_hidden': _layers(load[1:-1]),
        'load_last': _layers(load[-1:]),
        'least_speed': LEAST_SPEED,
        'limits': field.limits.limits,
        'bits': np.array([c[_bit(name, known)] for name in field.limits.names]),
        'bound': np.array(field.calibration.get('force', ())),
        'n_seen': n_own,
        'n_shared': len(tables.shared),
        'n_force': len(tables.force),
        'own': _table(tables.own, tool),
        'shared': _table(tables.shared, tool),
        'force_inputs': _table(tables.force, tool),
        'below': tool.below,
        'below_ramp': tool.below_ramp,
        'beside': tool.beside,
        'beside_ramp': tool.beside_ramp,
        'displacement': tool.displacement,
        'across': ACROSS,
    }
    result |= of_tool
    return result | {'digest': c_values.digest(result)}


def _check(field, known):
    n_scale = sum(name.startswith(f'{known.RATES[0]}_') for name in known.SCALARS)
    limit = library.constants()['LTS_FIELD_SCALES']
    if field.tool.scalars != known.SCALARS:
        raise ValueError(
            f'the C form of a swept field does not know the scalars {field.tool.scalars}'
        )
    if n_scale > limit:
        raise ValueError(f'{n_scale} memories of the velocity, the C form has at most {limit}')
    if len(CONDITIONS) != library.constants()['LTS_FIELD_CONDITIONS']:
        raise ValueError(
            f'the C form of a swept field does not know the conditions {[*CONDITIONS]}'
        )
    if field.config.hidden_layers < 1:
        raise ValueError('a swept field without hidden layers has no C form')


def _bit(name, known):
    """The status of a scalar that is outside its range."""
    if name in known.CONTEXT:
        return 'LTS_OUTSIDE_CONTEXT'
    if name in ('bed_low', 'bed_high'):
        return 'LTS_OUTSIDE_START'
    if name in ('drift', 'frame_time'):
        return 'LTS_OUTSIDE_SPEED'
    return 'LTS_OUTSIDE_SPEED' if name.split('_')[0] in known.RATES else 'LTS_OUTSIDE_POSE'


def _table(table: inputs.Table, tool) -> dict:
    """`lts_field_table` of a table."""
    c, ops, rows = library.constants(), [], []
    for row in table.rows:
        if inputs.depth(row.operand) > (limit := c['LTS_FIELD_STACK']):
            raise ValueError(f'{row.operand!r} needs more than the {limit} values of the C form')
        for offset in row.at or (0.0,):
            program = [_op(*step, offset, tool) for step in inputs.program(row.operand)]
            squash = c[f'LTS_SQUASH_{row.squash.upper()}']
            rows.append(
                {'first': len(ops), 'count': len(program), 'squash': squash, 'shift': row.shift,
                 'scale': row.scale}
            )  # fmt: skip
            ops += program
    return {
        'n_row': len(rows),
        'place': -1 if table.place == 'u' else tool.scalars.index(table.place),
        'unit': tool.scalars.index(table.unit) if table.unit else -1,
        'rows': rows,
        'ops': ops,
    }


def _op(kind, value, offset, tool):
    """`lts_field_op` of one step of `inputs.program`."""
    if kind != 'name':
        number = value if kind == 'number' else 0.0
        return _coded(kind, 0, number)
    if value.startswith('at.'):
        return _coded('at', library.constants()[f'LTS_{value[3:].upper()}'], offset)
    if value in tool.channels:
        return _coded('here', library.constants()[f'LTS_{value.upper()}'])
    if value in tool.scalars:
        return _coded('scalar', tool.scalars.index(value))
    return _coded('rest', 'uyz'.index(value))


def _coded(code, index=0, value=0.0):
    return {'code': library.constants()[f'LTS_OP_{code.upper()}'], 'index': index, 'value': value}


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
