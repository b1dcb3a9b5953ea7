"""What the C form knows of a blade: its part of `struct lts_field_model`, see `field_data`."""

import numpy as np

from learning_to_simulate.native import library
from learning_to_simulate.tool import blade

RATES = ('speed', 'rise', 'turn')
CONTEXT = ('half_width',)
# The order in which lts_field_path.c fills in the scalars of a frame.
SCALARS = (
    'tip', 'height', 'lean', *RATES,
    *(f'{name}_{i}' for i in range(len(blade.TIME_SCALES)) for name in RATES),
    'area', 'foremost', 'half_width', 'end', 'room', 'pressed',
)  # fmt: skip


def values(field) -> dict:
    """The fields that are a blade's."""
    tool = field.tool
    along = field.axes.points(field.rest)[:, 0]
    # A usual first place is so far from the end of the bed, m.
    from_end = float(np.mean(field.ranges['end']))
    return {
        'tool': library.constants()['LTS_FIELD_BLADE'],
        'start_u': float(along.max() + field.spacing / 2 - from_end),
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
