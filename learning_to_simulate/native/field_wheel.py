"""What the C form knows of a wheel: its part of `struct lts_field_model`, see `field_data`."""

import numpy as np

from learning_to_simulate.live import poses
from learning_to_simulate.native import library
from learning_to_simulate.tool import wheel

RATES = ('speed', 'rim')
CONTEXT = ('load', 'frame_load', 'peak_load', 'first_load', 'radius', 'half_width', 'gravity',
           'friction')  # fmt: skip
# The order in which lts_field_wheel_path.c fills in the scalars of a frame.
SCALARS = (
    'tip', 'rolled', *RATES,
    *(f'{name}_{i}' for i in range(len(wheel.TIME_SCALES)) for name in RATES),
    'travelled', 'slipped', 'foremost', 'rearmost', 'load', 'frame_load', 'peak_load', 'first_load',
    'radius', 'half_width', 'gravity', 'friction', 'sunk', 'contact', 'end', 'room',
    'stirred', 'height', 'area',
)  # fmt: skip


def values(field, starts, subspace) -> dict:
    """The fields that are a wheel's.

    Args:
      field: `SweptField`.
      starts, subspace: of the model folder (`live_starts.read`).

    Raises:
      ValueError: no starts; too long a context.
    """
    if starts is None or starts.context is None:
        raise ValueError('the C form of a wheel needs its recorded starts and their contexts')
    names = field.scene.context_names
    if len(names) > (limit := library.constants()['LTS_FIELD_CONTEXT']):
        raise ValueError(f'a context of {len(names)} values, the C form has at most {limit}')
    spread = starts.context.std(axis=0)
    result = {
        'tool': library.constants()['LTS_FIELD_WHEEL'],
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
        'radius': size[wheel.RADIUS],
        'width': size[wheel.WIDTH],
        'context': context,
        'modes': starts.modes[i][:n_mode],
    }
