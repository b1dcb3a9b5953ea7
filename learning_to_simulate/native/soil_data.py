"""A trained soil field as the values of `struct lts_soil_model`.

All constants come from the modules of the method, and the tables of inputs go along as data: what C
repeats is the order of a frame's scalars.
"""

import numpy as np

from learning_to_simulate import swept
from learning_to_simulate.native import c_values, fold, library
from learning_to_simulate.soil_field import (
    engine,
    inputs,
    network,
    passage,
    payload,
    place,
    sweep,
    terrain,
    tools,
)
from learning_to_simulate.soil_field import field as soil_field

# Status of what leaves its range, by its name; of all other numbers it is LTS_OUTSIDE_POSE.
_BITS = {
    'LTS_OUTSIDE_CONTEXT': (
        'half_width', 'friction', 'radius', 'length', 'bucket', 'plates', 'floor',
        'floor_share', 'edge', 'lugs', 'lug_height', 'stress',
    ),
    'LTS_OUTSIDE_START': (
        'bed_low', 'bed_high', 'uneven', 'wall', 'wall_behind', 'beyond_map', 'thin_soil',
        'other_tool', 'cell', 'crossfall', 'slope', 'wall_beside',
    ),
    'LTS_OUTSIDE_SPEED': ('speed', 'along', 'turning'),
}  # fmt: skip

# Constants of the method that are fields of the same name in small letters.
_CONSTANTS = {
    engine: ('FASTEST', 'FASTEST_TURN', 'TURNED', 'MOVED'),
    network: (
        'HEAP', 'ABOVE', 'RAMP', 'UNDER_ALONG', 'UNDER_ACROSS', 'FORCE', 'TORQUE', 'GAIN_LIMIT',
        'STIR', 'BESIDE_RAMP', 'BELOW', 'BELOW_RAMP', 'LENGTH', 'NEIGHBOUR',
    ),
    passage: (
        'AHEAD', 'EVEN', 'MAX_STEP', 'SET_DOWN', 'FACTOR', 'FLAT', 'STEEP', 'RELAID',
        'EVEN_SLOPE', 'UNDER', 'CROSSED',
    ),
    payload: (
        'SHELL', 'ARC', 'SLIPS', 'SLIPS_OUT', 'TAKEN', 'CURLED', 'TAKEN_ALONG', 'TAKEN_ACROSS',
        'FALLS_AHEAD', 'FALLS_APART',
    ),
    place: ('N_BESIDE', 'BESIDE_WIDTH', 'ACROSS', 'BESIDE'),
    sweep: (
        'SPACING', 'BACK', 'ON', 'CHUNK', 'WINDOW', 'FORGET', 'MEMORIES', 'TOUCH', 'REACH', 'RISE',
    ),
    swept: ('GRAZE',),
    terrain: ('SLIDES', 'SLOPE_TOLERANCE'),
    tools: (
        'BUCKET_EDGE', 'FLOOR_DEG', 'FLOOR_SHARE', 'FLOOR_FALLS', 'CURL', 'STANDARD_DENSITY',
        'STANDARD_GRAVITY',
    ),
}  # fmt: skip


def values(field) -> dict:
    """The fields of `lts_soil_model` of a `SoilField`; ValueError for one that the C code cannot
    run."""
    networks, c = field.networks, library.constants()
    tool, limits, tabled = networks.tool, field.limits, networks.inputs.tables
    if not all(networks.hidden.values()):
        raise ValueError('a soil field whose networks have no hidden layers has no C form')
    scalars = network.names_of(tool)
    kind = c['LTS_SOIL_WHEEL'] if tool.bears else c['LTS_SOIL_BLADE']
    layers = {name: _numpy(getattr(networks, name)) for name in network.NETWORKS}
    w, b = layers['load'][0]
    n_own = len(tabled.load)
    result: dict = {
        name.lower(): getattr(module, name)
        for module, names in _CONSTANTS.items()
        for name in names
    }
    result |= {
        'abi': c['LTS_ABI'],
        'kind': kind,
        'n_member': networks.members,
        'judged_names': ','.join(limits.names),
        'n_bin': len(sweep.OFFSETS),
        'n_behind': int(np.argmin(np.abs(sweep.OFFSETS))),
        'n_column': tool.columns,
        'taught_widths': tools.Blade.taught_widths,
        'rim': tools.Wheel.RIM,
        'lean_length': tools.LEAN,
        'below_tool': passage.BELOW,
        'lifted': tool.lifted,
        'turned_back': passage.BACK,
        'strikes': tool.strikes,
        'backs': tool.backs,
        'renewed_after': min(tool.renewed_after, 1e30),
        'slide_shares': [share for share, *_ in terrain.SLIDE_WAYS],
        'n_scalar': len(scalars),
        'n_own': len(tool.scalars),
        'radius': scalars.index('radius'),
        'n_around': len(network.AROUND_TOOL),
        'see_reach': max(soil_field.NEAR, _farthest(tabled.load, tabled.side), *network.AROUND_TOOL)
        + 2 * sweep.SPACING,
        'around': np.pad(network.AROUND_TOOL, (0, c['LTS_SOIL_AROUND'] - len(network.AROUND_TOOL))),
        'full_width': network.WIDTH[tool.name],
        'across_ramp': network.ACROSS,
        'load_own': fold.dense(*fold.side_by_side(list(zip(w[:, :n_own], b, strict=True)))),
        'load_side': fold.dense(*fold.side_by_side([(x, 0 * b[0]) for x in w[:, n_own:]])),
        'after': _network(layers['load'][1:]),
        'surface': _network(layers['surface']),
        'soil': _network(layers['soil']),
        'n_judged': len(limits.names),
        'n_named': soil_field.named(tool),
        'limits': np.stack([*limits.limits, limits.low, limits.high]),
        'middle': field.middle,
        'bits': np.array([c[_bit(name)] for name in limits.names]),
        'judged_here': soil_field.HERE,
        'judged_near': soil_field.NEAR,
        'least_soil': tool.least_soil,
        'wall_beside': tool.wall_beside,
        'apart': soil_field.APART,
        'bound': field.bounds.get('force', (-1.0,) * 3),
    }
    channels = {n: c[f'LTS_SOIL_{n.upper()}'] for n in (*sweep.CHANNELS, 'beside')}
    for name, table in tabled._asdict().items():
        result[name] = table_of(table, scalars, channels)
    _check(result, c)
    return result | {'digest': c_values.digest(result)}


def _check(result, c):
    """Refuses what does not fit into the arrays of the C form."""
    strips_of_all = result['n_column'] + 2 * result['n_beside']
    if result['n_scalar'] > c['LTS_SOIL_SCALARS'] or result['n_judged'] > c['LTS_SOIL_SCALARS']:
        raise ValueError(f'{result["n_scalar"]} scalars, the C form has {c["LTS_SOIL_SCALARS"]}')
    if len(soil_field.CONDITIONS) != c['LTS_SOIL_CONDITIONS']:
        raise ValueError(f'the C form judges {c["LTS_SOIL_CONDITIONS"]} conditions')
    if strips_of_all > c['LTS_SOIL_STRIPS']:
        raise ValueError(f'{strips_of_all} strips, the C form has {c["LTS_SOIL_STRIPS"]}')


def _farthest(*tables_of_load):
    return max(np.abs(row.at).max() for table in tables_of_load for row in table.rows if row.at)


def _bit(name):
    return next((bit for bit, names in _BITS.items() if name in names), 'LTS_OUTSIDE_POSE')


def _numpy(net):
    """[(w [M, in, out], b [M, out])] of all layers, float64."""
    return [tuple(np.asarray(v, np.float64) for v in (w, b[:, 0])) for w, b in net.layers]


def _network(layers):
    """`lts_soil_network` of some layers, member by member."""
    found = [fold.dense(w[m], b[m]) for m in range(len(layers[0][0])) for w, b in layers]
    return {'n_layer': len(layers), 'layers': found}


def table_of(table: inputs.Table, scalars, channels: dict[str, int]) -> dict:
    """`lts_table` of a table of inputs; names of a frame's scalars in their order, and name of a
    channel of the bins -> its number in C. ValueError for an operand that needs more values at once
    than C has."""
    c, ops, rows = library.constants(), [], []
    for row in table.rows:
        if inputs.depth(row.operand) > (limit := c['LTS_STACK']):
            raise ValueError(f'{row.operand!r} needs more than the {limit} values of the C form')
        for offset in row.at or (0.0,):
            program = [
                _op(*step, offset, scalars, channels) for step in inputs.program(row.operand)
            ]
            squash = c[f'LTS_SQUASH_{row.squash.upper()}']
            rows.append(
                {'first': len(ops), 'count': len(program), 'squash': squash, 'shift': row.shift,
                 'scale': row.scale}
            )  # fmt: skip
            ops += program
    return {'n_row': len(rows), 'rows': rows, 'ops': ops}


def _op(kind, value, offset, scalars, channels):
    """`lts_op` of one step of `inputs.program`."""
    if kind != 'name':
        return _coded(kind, 0, value if kind == 'number' else 0.0)
    if value.startswith('at.'):
        return _coded('at', channels[value[3:]], offset)
    if value in channels:
        return _coded('here', channels[value])
    if value in scalars:
        return _coded('scalar', scalars.index(value))
    return _coded('rest', 'uyz'.index(value))


def _coded(code, index=0, value=0.0):
    return {'code': library.constants()[f'LTS_OP_{code.upper()}'], 'index': index, 'value': value}
