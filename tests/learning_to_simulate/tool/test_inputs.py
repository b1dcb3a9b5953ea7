"""Expressions of tables: as Python evaluates them, as a machine with a stack does."""

import numpy as np
import pytest

from learning_to_simulate.tool import TOOLS, inputs

FUNCTIONS = {
    'abs': np.abs, 'relu': lambda x: np.maximum(x, 0), 'sqrt': np.sqrt, 'log': np.log,
    'log1p': np.log1p, 'max': np.maximum,
}  # fmt: skip
TWO = {'add': np.add, 'sub': np.subtract, 'mul': np.multiply, 'div': np.divide, 'max': np.maximum}


def run(program, values):
    """What a stack holds after a program."""
    stack = []
    for kind, value in program:
        if kind == 'name':
            stack.append(values[value])
        elif kind == 'number':
            stack.append(value)
        elif kind in TWO:
            right = stack.pop()
            stack.append(TWO[kind](stack.pop(), right))
        else:
            stack.append((FUNCTIONS | {'square': np.square})[kind](stack.pop()))
    (found,) = stack
    return found


@pytest.mark.parametrize('tool', TOOLS.values(), ids=TOOLS)
def test_every_operand_is_its_program_and_knows_its_names(tool):
    rng = np.random.default_rng(0)
    tables = tool.tables
    for table in (tables.own, tables.shared, tables.force):
        names = [*tool.scalars, *(f'at.{name}' for name in tool.channels)]
        if table.place == 'u':
            names += [*tool.channels, *'uyz']
        values = {name: rng.uniform(0.1, 1.0, 5) for name in names}
        for row in table.rows:
            value = inputs.evaluate(row.operand, values, FUNCTIONS)
            np.testing.assert_allclose(run(inputs.program(row.operand), values), value)
            assert row.squash in inputs.SQUASHES
            assert bool(row.at) == any(n.startswith('at.') for n in inputs.names(row.operand))
        assert len(table) == sum(len(row.at) or 1 for row in table.rows)


@pytest.mark.parametrize('text', ['tip ** 3', 'exp(tip)', 'tip if u else y', '-tip', 'tip[0]'])
def test_other_expressions_are_refused(text):
    with pytest.raises(ValueError, match='has no place in an operand'):
        inputs.program(text)
