"""What a user of an exported swept field must know: `export.json`."""

from learning_to_simulate.export import field_state
from learning_to_simulate.methods.swept_field import live

_MEANING = {
    'position_low': 'what float32 cuts off the position, m: float64 minus float32; zeros cost '
    'digits of the velocity where frames are short',
    'velocity': 'of the tool at the start, linear (m/s) and angular (rad/s)',
    'surface': 'height of the bed at bin_offsets ahead of (+) and behind (-) the tool at its '
    'start, along the way, m',
    'level': 'median height of the bed, m',
    'end': 'from the tool at its start to the end of the bed along the way, m',
    'floor': 'height of the floor, m; the tool may not go below',
    'dt': 'time since the last pose, s; any, from frame to frame',
    'bins': 'state, a row each: see state_bins',
    'tool': 'state: see state_tool',
    'rest': 'where particles were at the start, m; any P of them',
    'next_bins': 'state after the step',
    'next_tool': 'state after the step',
    'force': 'of the soil on the tool, N',
    'torque': 'of the soil on the tool about the point of its pose, N m',
    'bound': 'what the root mean square error of the force per component keeps in 95 % of frames '
    'like those of valid, N',
    'status': 'of this frame alone: see status',
    'outside': 'by how much each of scalars leaves its training range; 0 within',
    'particles': 'where they are now, m; none that moved is inside the tool',
}  # fmt: skip


def describe(functions, kind: str) -> dict:
    """The description of `FieldFunctions` in a format; JSON-able."""
    field = functions.field
    axes, form, concrete = field.axes, functions.form, functions.concrete(kind)
    meaning = _MEANING | form.meaning
    signatures = {
        name: {
            'inputs': {k: _row(spec, meaning[k]) for k, spec in rows.items()},
            'outputs': {
                k: _row(x, meaning[k]) for k, x in concrete[name].structured_outputs.items()
            },
        }
        for name, rows in functions.signatures().items()
    }
    return {
        'format': kind,
        'signatures': signatures,
        'scene': field.scene.to_json(),
        'axes': 'world, metres: positions and heights are all counted from one point, which may '
        'be any along the way and upwards; float32 resolves 1e-7 of the distance from it',
        'axis': axes.axis,
        'sign': axes.sign,
        'up': axes.up,
        'middle': axes.middle,
        'bin_offsets': [round(float(x), 9) for x in field.grid.offsets],
        'state_bins': list(form.bins),
        'state_tool': list(form.tool),
        'scalars': list(field.tool.scalars),
        'status': field_state.STATUS,
        'refused': f'a pose that is not finite, no unit quaternion, faster than {live.FASTEST} m/s '
        f'or {live.FASTEST_TURN} rad/s, beyond the bins or under the floor, a dt that is not '
        f'positive, {form.refused}a state that start did not make: the state stays, the loads are '
        'those of the frame before (0 of such a state)',
        'members': functions.members,
        'seconds_per_frame': field.scene.dt,
        'left_out': 'reading beds from particles or height maps (bed.npz has the flat bed of the '
        'training), height maps of the soil, modes',
    }


def _row(tensor, meaning):
    return [list(tensor.shape), tensor.dtype.name, meaning]
