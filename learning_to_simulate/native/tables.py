"""Tables of inputs (`soil_field.inputs`) as the values of `lts_table`."""

from learning_to_simulate.native import library
from learning_to_simulate.soil_field import inputs


def values(table: inputs.Table, scalars, channels: dict[str, int]) -> dict:
    """`lts_table` of a table of inputs.

    Args:
      scalars: names of a frame's, in their order.
      channels: name of a channel of the bins -> its number in C.

    Raises:
      ValueError: an operand that needs more values at once than C has room for.
    """
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
    return {
        'n_row': len(rows),
        'rows': rows,
        'ops': ops,
    }


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
