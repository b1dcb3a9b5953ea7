"""A trained swept field as the values of `struct lts_field_model`.

All constants come from the modules of the method; what C repeats of them is only their order.
"""

import numpy as np

from learning_to_simulate.export_c import c_header, c_values, field_blade, field_wheel, fold
from learning_to_simulate.live import resting_start
from learning_to_simulate.methods.swept_field import live, model_files, quality, tool_path
from learning_to_simulate.methods.swept_field.tools import Wheel

_MOST_PLACES = 32


def read(model_path: str):
    """A field, and the `starts` and `subspace` that `values` takes, by name: of a wheel.

    Raises:
      FileNotFoundError, ValueError: as `model_files.load` and `resting_start.read`.
    """
    field = model_files.load(model_path)
    if not isinstance(field.tool, Wheel):
        return field, {}
    starts, subspace = resting_start.read(model_path)
    return field, {'starts': starts, 'subspace': subspace}


def values(field, starts=None, subspace=None) -> dict:
    """The fields of `lts_field_model`.

    Args:
      field: `SweptField`.
      starts, subspace: of the model folder (`resting_start.read`); a wheel needs its starts.

    Raises:
      ValueError: inputs that the C code does not know; a wheel without starts.
    """
    is_wheel = isinstance(field.tool, Wheel)
    of_tool = field_wheel.values(field, starts, subspace) if is_wheel else field_blade.values(field)
    places, own = of_tool.pop('places'), of_tool.pop('inputs')
    sizes = {name: len(row) for name, row in places.items()}
    counts = dict(zip(('n_seen', 'n_shared', 'n_force'), own(sizes)))
    _check(field, counts, sizes)
    c, names = c_header.constants(), field.tool.scalars
    axes, grid = field.axes, field.grid
    points = axes.points(field.rest)
    soil, load = (_numpy(net) for net in (field.network.soil, field.network.load))
    w, b = soil[0]
    own_weights, shared = w[:, : counts['n_seen']], w[:, counts['n_seen'] :]
    reach = max(np.abs(places[name]).max() for name in ('around', 'since'))
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
        'scalar_names': ','.join(names),
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
        'touch': tool_path.TOUCH,
        'kept_spacing': field.kept_spacing,
        'spacing': field.spacing,
        'fastest': live.FASTEST,
        'fastest_turn': live.FASTEST_TURN,
        'rest': field.rest,
        'first_bin': grid.offsets[0],
        'bin_width': grid.spacing,
        'n_soil_hidden': len(soil) - 2,
        'n_load_hidden': len(load) - 2,
        'latent': field.config.latent_size,
        'load_latent': field.config.force_latent_size,
        'soil_first': [fold.dense(part) for part in own_weights],
        'soil_hidden': _layers(soil[1:-1]),
        'soil_last': _layers(soil[-1:]),
        'soil_shared': fold.dense(*_together(shared, b)),
        'load_first': fold.dense(*_together(*load[0])),
        'load_hidden': _layers(load[1:-1]),
        'load_last': _layers(load[-1:]),
        'limits': quality.limits(field.ranges, names),
        'bits': np.array([c[of_tool['bit'](name)] for name in names]),
        'bound': np.array(field.calibration.get('force', ())),
        **counts,
        **places,
        **{f'n_{name.rstrip("s")}': size for name, size in sizes.items()},
    }
    del of_tool['bit']
    result |= of_tool
    return result | {'digest': c_values.digest(result)}


def _check(field, counts, sizes):
    n_soil, n_force = field.network.sizes
    if (counts['n_seen'] + counts['n_shared'], counts['n_force']) != (n_soil, n_force):
        raise ValueError(
            f'the networks take {n_soil} and {n_force} inputs, the C form of a swept field has '
            f'{counts["n_seen"] + counts["n_shared"]} and {counts["n_force"]}'
        )
    if max(sizes.values()) > _MOST_PLACES:
        raise ValueError(f'the C form of a swept field looks at no more than {_MOST_PLACES} places')
    if field.config.hidden_layers < 1:
        raise ValueError('a swept field without hidden layers has no C form')


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
