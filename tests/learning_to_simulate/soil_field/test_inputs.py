"""Tables and their expressions, against numpy and Python's own."""

import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate.soil_field import inputs, network, sweep
from learning_to_simulate.soil_field.inputs import Row
from learning_to_simulate.soil_field.tools import TOOLS

FUNCTIONS = {'abs': np.abs, 'relu': lambda x: np.maximum(x, 0), 'sqrt': np.sqrt}


@pytest.mark.parametrize('tool', TOOLS.values(), ids=TOOLS)
def test_every_operand_is_what_python_makes_of_it_and_knows_its_names(tool):
    rng = np.random.default_rng(0)
    for table in inputs.TABLES[tool.name]:
        channels = [*sweep.CHANNELS, 'beside']
        names = [*network.names_of(tool), *channels, *'uyz', *(f'at.{name}' for name in channels)]
        values = {name: rng.uniform(0.1, 1.0, 5) for name in names}
        for row in table.rows:
            expected = eval(
                row.operand.replace('at.', 'at_'),
                FUNCTIONS | {name.replace('.', '_'): value for name, value in values.items()},
            )
            value = inputs.evaluate(row.operand, values, FUNCTIONS)
            np.testing.assert_allclose(value, expected, rtol=1e-12)
            assert row.squash in inputs.SQUASHES
            assert bool(row.at) == any(n.startswith('at.') for n in inputs.names(row.operand))
        assert len(table) == sum(len(row.at) or 1 for row in table.rows)


@pytest.mark.parametrize('text', ['tip * 3', 'exp(tip)', 'tip if u else y', '-tip', 'tip[0]'])
def test_other_expressions_are_refused(text):
    with pytest.raises(ValueError, match='has no place in an operand'):
        inputs.program(text)


@pytest.mark.parametrize(
    'row, wanted',
    [
        (Row('a'), lambda a, b: a),
        (Row('a - b', 2.0, shift=0.5), lambda a, b: (a - b - 0.5) / 2),
        (Row('abs(b)', 0.1, 'tanh'), lambda a, b: np.tanh(abs(b) / 0.1)),
        (Row('sqrt(relu(a) + 1e-6)', 1.0, 'bell'), lambda a, b: np.exp(-(np.maximum(a, 0) + 1e-6))),
        (Row('b', 0.5, 'relu2'), lambda a, b: np.maximum(b / 0.5, 0) ** 2),
        (Row('b + a', 2.0, 'fade'), lambda a, b: np.exp(-(a + b) / 2)),
    ],
)  # fmt: skip
def test_a_row_is_its_formula(row, wanted):
    a, b = np.random.default_rng(1).normal(size=(2, 9))
    values = {name: tf.constant(v, tf.float32) for name, v in (('a', a), ('b', b))}
    np.testing.assert_allclose(inputs.column(row, values), wanted(a, b), atol=1e-5)
