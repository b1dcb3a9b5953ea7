"""Inputs of the networks of a soil field, as tables: what TensorFlow and C both read.

Three networks see a tool's sweep: that of the load, for each strip under the tool and each of its
two neighbours; that of the surface, for places seen from above; that of the soil, for particles.
Heights count from the tool or from the terrain at a place, never from a level: a scene may lie
anywhere.

One row gives one input, or one for each offset along the way:

    x = squash((operand - shift) / scale)

An operand is a short expression of names: scalars of a frame ('tip', 'lean', see `sweep.SCALARS`);
of a place or particle u, y, z (from the origin of the bins, the level and the middle, m of the
field); channels of the bins at that u ('cut', see `sweep.CHANNELS`); and `at.cut`, a channel at
each of the row's offsets from the place that the table looks at. Scales make inputs of order one.
"""

import ast
import dataclasses
import functools
import operator
from collections.abc import Callable
from typing import NamedTuple

import tensorflow as tf

from learning_to_simulate.soil_field import sweep

# Squashes of t = (operand - shift) / scale; the constants LTS_SQUASH_<NAME> of lts_soil_model.h.
SQUASHES: dict[str, Callable] = {
    'plain': lambda t: t,
    'tanh': tf.tanh,
    'relu': tf.nn.relu,
    'relu2': lambda t: tf.nn.relu(t) ** 2,
    'bell': lambda t: tf.exp(-(t**2)),
    'fade': lambda t: tf.exp(-t),
}
_FUNCTIONS = {'abs': tf.abs, 'relu': tf.nn.relu, 'sqrt': tf.sqrt}
_OF_TWO: dict[str, Callable] = {'add': operator.add, 'sub': operator.sub}
_OPERATORS: dict[type, str] = {ast.Add: 'add', ast.Sub: 'sub'}


@dataclasses.dataclass(frozen=True)
class Row:
    """One row of a table: x = squash((operand - shift) / scale).

    Attributes:
      operand: an expression.
      squash: a name of `SQUASHES`.
      at: offsets of `at.` along the way, m; () without any.
    """

    operand: str
    scale: float = 1.0
    squash: str = 'plain'
    shift: float = 0.0
    at: tuple[float, ...] = ()

    @property
    def columns(self) -> int:
        """Number of inputs."""
        return len(self.at) or 1


@dataclasses.dataclass(frozen=True)
class Table:
    """Inputs that are computed together; rows in their order."""

    rows: tuple[Row, ...]

    def __len__(self):
        return sum(row.columns for row in self.rows)

    def names(self) -> set[str]:
        """The names in all operands."""
        return {name for row in self.rows for name in names(row.operand)}

    def offsets(self) -> dict[tuple[float, ...], list[str]]:
        """Offsets of rows -> the channels that are read there."""
        found: dict[tuple[float, ...], list[str]] = {}
        for row in self.rows:
            seen = found.setdefault(row.at, [])
            seen += [n[3:] for n in names(row.operand) if n.startswith('at.') and n[3:] not in seen]
        found.pop((), None)
        return found


def names(expression: str) -> list[str]:
    """The names in an expression, in their order; each once."""
    return list(dict.fromkeys(str(v) for kind, v in program(expression) if kind == 'name'))


def evaluate(expression: str, values):
    """The value of an expression, of name -> number, array or tensor."""
    known, stack = _OF_TWO | _FUNCTIONS, []
    for kind, value in program(expression):
        if kind in ('name', 'number'):
            stack.append(values[value] if kind == 'name' else value)
        else:
            count = 2 if kind in _OF_TWO else 1
            stack[-count:] = [known[kind](*stack[-count:])]
    return stack[0]


def column(row, values):
    """The input of a row of a table (`Row`), of values by their names."""
    value = evaluate(row.operand, values)
    value = value - row.shift if row.shift else value
    return SQUASHES[row.squash](value / row.scale if row.scale != 1.0 else value)


@functools.cache
def program(expression: str) -> list[tuple[str, str | float]]:
    """An expression for a machine with a stack: ('name', name), ('number', value) or (operation,
    ''), operands before their operation.

    Raises:
      ValueError: something else than names, numbers, + and -, abs, relu and sqrt.
    """

    def steps(node):
        kind = None
        if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
            kind, parts = _OPERATORS[type(node.op)], [node.left, node.right]
        elif isinstance(node, ast.Call) and node.func.id in _FUNCTIONS:
            kind, parts = node.func.id, node.args
        elif isinstance(node, ast.Constant):
            yield 'number', float(node.value)
        elif isinstance(node, ast.Name):
            yield 'name', node.id
        elif isinstance(node, ast.Attribute):
            yield 'name', f'{node.value.id}.{node.attr}'
        else:
            raise ValueError(f'{expression!r}: {ast.unparse(node)!r} has no place in an operand')
        if kind:
            for part in parts:
                yield from steps(part)
            yield kind, ''

    return list(steps(ast.parse(expression, mode='eval').body))


def depth(expression: str) -> int:
    """Values that a stack holds at once while it runs a `program`."""
    most = now = 0
    for kind, _ in program(expression):
        now += 1 if kind in ('name', 'number') else -1 if kind in _OF_TWO else 0
        most = max(most, now)
    return most


# Offsets along the way at which the bins are seen, m of the field: about a place, and about the
# tool.
AROUND = (-0.2, -0.13, -0.085, -0.055, -0.035, -0.017, 0.0, 0.017, 0.035, 0.055, 0.085, 0.13,
          0.2)  # fmt: skip
AT_TOOL = (-0.16, -0.1, -0.06, -0.04, -0.02, -0.01, 0.0, 0.01, 0.02, 0.04, 0.07, 0.11, 0.16)
# A blade's load is as good without the cut at the others.
CUT_AT_BLADE = (-0.1, -0.06, -0.04, -0.02, 0.0, 0.02, 0.04, 0.07, 0.11)
# The last passage fades over so much travel, m.
RECENT = 0.15

_AREA = (
    Row('area', 0.01), Row('sqrt(relu(area) + 1e-6)', 0.1),
    Row('carried', 0.03, 'tanh'), Row('carried', 0.1, 'tanh'),
)  # fmt: skip
_GAP = 'height - radius - at.surface + at.cut'  # between the tool and what it has cut
_MEMORIES = range(len(sweep.MEMORIES))
_MEMORY = tuple(Row(f'{name}_{i}') for i in _MEMORIES for name in ('along', 'up', 'turn'))
# How fast the tool came to where it is: soil that slides on takes its load off a blade that halts.
# The networks of a wheel err more with it.
_PACE = tuple(Row(f'pace_{i}', 0.1) for i in (0, 2, 3))
_AHEAD = Row('ahead', 0.1, 'tanh')
# Of a blade's load: most runs begin 80 mm before a wall, which resists as well; a back that comes
# down on soil bears many times what an edge does. Grains are stiff against their weight.
_BACK = (
    Row('behind', 0.1, 'tanh'), Row('pressed', 0.003), Row('sqrt(pressed + 1e-6)', 0.05),
    Row('pressed', 0.001, 'tanh'), Row('stress'), Row('floor', 0.2, shift=0.12),
    Row('floor_share', 0.3, shift=0.6),
)  # fmt: skip
_BLADE = (
    Row('lean'), Row('half_width', 0.2), Row('friction', 0.15, shift=0.76),
    Row('radius', 0.01, shift=0.014), Row('length', 0.1, shift=0.277), Row('bucket'),
    Row('plates'),
)  # fmt: skip
_WHEEL = (
    Row('half_width', 0.05, shift=0.06), Row('friction', 0.15, shift=0.76), Row('lugs', 16.0),
    Row('lug_height', 0.01),
)  # fmt: skip
# Of the load alone: with them the networks of soil learn runs by heart.
_BEARS = (
    Row('stress'), Row('below', 0.1, 'tanh'), Row('below', 0.03, 'tanh'),
    Row('below', 0.01, 'fade'),
)  # fmt: skip
_MOVES = (
    Row('foremost - tip', 0.002, 'tanh'), *_MEMORY, Row('speed', 0.1), _AHEAD,
)  # fmt: skip
_SEES = (
    Row('at.surface - height', 0.05, at=AT_TOOL),
    Row('at.surface - at.cut - height', 0.02, 'tanh', at=AT_TOOL),
    *(Row('at.surface - height', 0.05, squash, at=(0.0,)) for squash in ('relu', 'relu2')),
    Row(_GAP, 0.002, 'tanh', at=(0.0,)), Row(_GAP, 0.0005, 'tanh', at=(0.0,)),
)  # fmt: skip
# How a neighbour differs from a strip.
_SIDE = (Row('at.beside - at.surface + at.cut', 0.03, at=AT_TOOL),)
_STANDS = (
    Row('at.surface - height', 0.05, at=(0.0,)),
    Row('height - at.surface', 0.03, 'relu', at=(0.0,)),
    *_AREA,
)  # fmt: skip
# What a blade strikes off that goes on over the terrain, and what it then has left.
_LEFT = (Row('layer', 0.01), Row('carried - layer', 0.01), Row('carried - layer', 0.003, 'tanh'))
_STRUCK = (
    Row('struck', 0.02), Row('at.struck', 0.02, at=AROUND), Row('area_before', 0.003, 'tanh'),
)  # fmt: skip
_BEHIND_TIP, _BEHIND_FOREMOST = (
    f'{x} - u - relu({x} - u - {sweep.FAR})' for x in ('tip', 'foremost')
)
_PAST_END, _ABOVE_CUT = 'abs(z) - half_width', 'y - surface + cut'
_HERE = (
    Row('tip - u', 0.03, 'tanh'),
    *(Row('tip - u', 0.05, 'bell', shift) for shift in (-0.08, 0.0, 0.08)),
    Row('abs(z)', 0.15), Row(_PAST_END, 0.03, 'tanh'), Row(_PAST_END, 0.1, 'tanh'),
    Row(_PAST_END, 0.008, 'tanh'), Row(_PAST_END, 0.02, 'bell'),
    Row(_BEHIND_FOREMOST, 0.15), Row('foremost - u', 0.03, 'tanh'),
    Row('area_before', 0.01), Row('sqrt(area_before + 1e-6)', 0.1),
    Row('surface - height', 0.05),
    Row('at.cut', 0.03, at=AROUND), Row('at.surface - surface', 0.03, at=AROUND),
    Row('since', RECENT, 'fade'),
)  # fmt: skip
_OF_PARTICLE = (
    Row('y - surface', 0.05), Row('y - height', 0.05), Row('y - height', 0.02, 'tanh'),
    Row(_ABOVE_CUT, 0.05), Row(_ABOVE_CUT, 0.01, 'tanh'),
    # Sharper where a particle is carried along or left.
    Row(_ABOVE_CUT, 0.004, 'tanh'), Row(_ABOVE_CUT, 0.012, 'bell'),
)  # fmt: skip


class Tables(NamedTuple):
    """All inputs of the networks of a tool.

    Attributes:
      load, side: of a strip, and of a strip with a neighbour.
      here: of a place, for surface and soil.
      particle: of a particle, behind `here`.
      tool: of all places of a frame, behind these.
    """

    load: Table
    side: Table
    here: Table
    particle: Table
    tool: Table


def _tables(own, of_load=(), here=(), stands=(), cut_at=AT_TOOL, about=_BEHIND_TIP,
            backed='foremost - tip'):  # fmt: skip
    back = Row(backed, 0.1)
    load = *own, *of_load, *_AREA, back, *_MOVES, Row('at.cut', 0.03, at=cut_at), *_SEES
    return Tables(
        Table(load), Table(_SIDE), Table((Row(about, 0.15), *_HERE, *here)), Table(_OF_PARTICLE),
        Table((*own, *_STANDS, back, _AHEAD, *stands)),
    )  # fmt: skip


TABLES = {
    'blade': _tables(_BLADE, (*_PACE, *_BACK), _STRUCK, _LEFT, CUT_AT_BLADE),
    'wheel': _tables(
        _WHEEL,
        _BEARS,
        about=f'{_BEHIND_TIP} + relu(u - tip - {sweep.FAR})',
        backed=f'foremost - tip - relu(foremost - tip - {sweep.FAR})',
    ),
}
