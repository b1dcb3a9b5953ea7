"""Expressions of tables, against Python's own; rows: against C in `native/test_soil_engine`."""

import numpy as np
import pytest

from learning_to_simulate.soil_field import inputs, network, sweep
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
            value = inputs.evaluate(row.operand, values)
            np.testing.assert_allclose(value, expected, rtol=1e-12)
            assert row.squash in inputs.SQUASHES
            assert bool(row.at) == any(n.startswith('at.') for n in inputs.names(row.operand))
        assert len(table) == sum(len(row.at) or 1 for row in table.rows)


@pytest.mark.parametrize('text', ['tip * 3', 'exp(tip)', 'tip if u else y', '-tip', 'tip[0]'])
def test_other_expressions_are_refused(text):
    with pytest.raises(ValueError, match='has no place in an operand'):
        inputs.program(text)
