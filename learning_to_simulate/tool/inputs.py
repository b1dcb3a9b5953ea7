"""Inputs of a field's networks as tables: what TensorFlow and C both read.

One row gives one input, or one for each offset along the way:

    x = squash((operand - shift) / scale)

An operand is a short expression of names: scalars of a frame ('tip', 'lean', see `blade.SCALARS`);
of a particle at rest u, y, z (from the tool's first place, the level and the middle plane, m);
channels of the bins at that u ('cut', see `blade.CHANNELS`); and `at.cut`, a channel at each of the
row's offsets from the place that the table looks at. Scales make inputs of order one.
"""

import ast
import dataclasses
import functools
import operator
from collections.abc import Callable

# Squashes of t = (operand - shift) / scale; the constants LTS_<NAME> of lts_field_model.h.
SQUASHES = {
    'plain': 't',
    'tanh': 'tanh(t)',
    'relu': 'max(t, 0)',
    'relu2': 'max(t, 0)^2',
    'bell': 'exp(-t^2)',
    'fade': 'exp(-t)',
    'log': 'log(t)',
    'log1p': 'log(1 + t)',
}
FUNCTIONS = ('abs', 'relu', 'sqrt', 'log', 'log1p', 'max')
_OPERATORS: dict[type, str] = {
    ast.Add: 'add', ast.Sub: 'sub', ast.Mult: 'mul', ast.Div: 'div',
}  # fmt: skip
_OF_TWO: dict[str, Callable] = {
    'add': operator.add, 'sub': operator.sub, 'mul': operator.mul, 'div': operator.truediv,
}  # fmt: skip
_TAKE_TWO = (*_OF_TWO, 'max')


@dataclasses.dataclass(frozen=True)
class Row:
    """One row of a table: x = squash((operand - shift) / scale).

    Attributes:
      operand: an expression.
      scale, squash, shift: a squash is a name of `SQUASHES`.
      at: offsets of `at.` along the way, m or in the unit of the table; () without any.
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
    """Inputs that are computed together.

    Attributes:
      rows: in the order of the inputs.
      place: name of the place that offsets are counted from: 'u' of particles, 'tip' of the tool.
      unit: name of a scalar that offsets are multiplied by; '' where they are in m.
    """

    rows: tuple[Row, ...]
    place: str = 'tip'
    unit: str = ''

    def __len__(self):
        return sum(row.columns for row in self.rows)

    def offsets(self) -> dict[tuple[float, ...], list[str]]:
        """Offsets of rows -> the channels that are read there."""
        found: dict[tuple[float, ...], list[str]] = {}
        for row in self.rows:
            seen = found.setdefault(row.at, [])
            seen += [n[3:] for n in names(row.operand) if n.startswith('at.') and n[3:] not in seen]
        found.pop((), None)
        return found


@dataclasses.dataclass(frozen=True)
class Tables:
    """All inputs of the networks of a tool.

    Attributes:
      own: of a particle; the network sees these first.
      shared: of all particles of a frame; the network sees these behind them.
      force: of the load.
    """

    own: Table
    shared: Table
    force: Table


def names(expression: str) -> list[str]:
    """The names in an expression, in their order; each once."""
    return list(dict.fromkeys(str(v) for kind, v in program(expression) if kind == 'name'))


def evaluate(expression: str, values, functions: dict):
    """The value of an expression.

    Args:
      expression: an operand.
      values: name -> number, array or tensor.
      functions: name -> function, of `FUNCTIONS`.
    """
    known = _OF_TWO | {'square': lambda x: x**2} | functions
    stack: list = []
    for kind, value in program(expression):
        if kind in ('name', 'number'):
            stack.append(values[value] if kind == 'name' else value)
        else:
            count = 2 if kind in _TAKE_TWO else 1
            stack[-count:] = [known[kind](*stack[-count:])]
    return stack[0]


@functools.cache
def program(expression: str) -> list[tuple[str, str | float]]:
    """An expression for a machine with a stack: ('name', name), ('number', value) or (operation,
    ''), operands before their operation.

    Raises:
      ValueError: something else than names, numbers, + - * /, squares and `FUNCTIONS`.
    """

    def steps(node):
        kind = None
        if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
            kind, parts = _OPERATORS[type(node.op)], [node.left, node.right]
        elif isinstance(node, ast.BinOp) and ast.unparse(node).endswith('** 2'):
            kind, parts = 'square', [node.left]
        elif isinstance(node, ast.Call) and node.func.id in FUNCTIONS:
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
        now += 1 if kind in ('name', 'number') else -1 if kind in _TAKE_TWO else 0
        most = max(most, now)
    return most
